"""Comparisons of two navigations."""

from __future__ import annotations

from pydantic import Field

from station.api.schema.base import Model, Question
from station.library.comparisons import Comparison


class ComparisonOrder(Question):
    """Which navigations to compare: places are made of the first one and looked for in the second."""

    first: str = Field(examples=["nav-20260105-101500"])
    second: str = Field(examples=["nav-20260106-090000"])


class ComparisonModel(Model):
    """Two navigations compared; the report has the pictures."""

    id: str = Field(examples=["cmp-20260106-091200"])
    name: str
    first: str
    second: str
    made_unix_s: float
    places: int = Field(description="of the first navigation")
    locations: int = Field(description="of the second one")
    matches: int
    accepted: bool = Field(description="the registration")
    reasons: list[str] = Field(description="why it was refused")
    T_first_second: list[float] | None = Field(description="row-major 4x4, may carry a scale")
    report: str = Field(examples=["/comparisons/cmp-20260106-091200/report.html"])


def comparison_model(comparison: Comparison) -> ComparisonModel:
    T = comparison.T_first_second
    return ComparisonModel.of(
        comparison,
        made_unix_s=comparison.made_wall_s,
        T_first_second=None if T is None else [x for row in T for x in row],
        report=f"/comparisons/{comparison.id}/report.html",
    )
