"""The odds of images are fitted to the figures that the estimator asks, and to nothing else."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.places.tracking.fitted import FailureOdds
from station.places.tracking.image_evidence import MatchFigures, failure_probability, log_odds, terms
from tests.support import likelihood_fit
from tests.support.likelihood_fit import (
    failing,
    fitted_failing,
    fitted_right,
    numbers,
    weights,
    with_previous,
)
from tests.support.places import ODDS

RIGHT = ODDS.right
TRUE = np.array(msgspec.structs.astuple(RIGHT))


def figures_of(rng: np.random.Generator, features: int) -> MatchFigures:
    return MatchFigures(
        extent_m=rng.uniform(0.03, 0.5),
        inliers=int(rng.integers(16, 300)),
        support=rng.uniform(0.05, 0.8),
        features=features,
        off_floor=rng.exponential(5.0),
        is_free=bool(rng.random() < 0.7),
    )


def row(**otherwise: Any) -> dict[str, Any]:
    return {"kind": "flat", "world": "101", "drive": 1, "after": False, "p": [0.0, 0.0, 0.0], "heading": 0.0,
            "features": 500, "in_view": 1.0, "failed_before": 0.0, "moved": 1.0, "mapped": True, "doorway": False,
            "poses": [], **otherwise}  # fmt: skip


@given(
    features=st.integers(60, 800),
    failed_before=st.sampled_from([0.0, 1.0]),
    in_view=st.floats(0.0, 900.0),
)
def test_what_is_fitted_is_what_the_estimator_computes(features: int, failed_before: float, in_view: float) -> None:
    f = ODDS.fails_at_pose
    [X] = failing([row(features=features, failed_before=failed_before, in_view=in_view)], with_view=True)
    p = failure_probability(f, features, failed_before, in_view)
    assert np.dot(X, [f.constant, f.features, f.again, f.in_view]) == pytest.approx(np.log(p / (1 - p)), abs=1e-6)


def test_the_odds_that_made_images_up_are_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(likelihood_fit, "RIDGE", 0.0)
    rng = np.random.default_rng(0)
    f = FailureOdds(8.5, features=-1.0, again=2.0, in_view=-0.8)
    rows, tried = [], []
    for k in range(6000):
        features = int(rng.integers(80, 800))
        poses: list[dict[str, Any]] = [{"figures": figures_of(rng, features)} for _ in range(rng.integers(1, 4))]
        odds = np.exp([*(log_odds(RIGHT, pose["figures"]) for pose in poses), 0.0])
        right = rng.choice(len(odds), p=odds / odds.sum())
        for j, pose in enumerate(poses):
            pose["error_m"] = 0.1 if j == right else 2.0
        kind = ("flat", "hall")[k % 2]
        rows.append(row(kind=kind, features=features, poses=poses))
        before, in_view = float(rng.random() < 0.4), float(rng.exponential(100.0))
        failed = rng.random() < failure_probability(f, features, before, in_view)
        seen = [] if failed else poses
        tried.append(row(kind=kind, features=features, poses=seen, failed_before=before, in_view=in_view))
    found = fitted_right(rows)
    figures = terms(rows[0]["poses"][0]["figures"])
    np.testing.assert_allclose(found.w[1:], TRUE[1:], atol=0.25)
    np.testing.assert_allclose(figures @ found.w, figures @ TRUE, atol=0.3)
    assert set(found.losses) == {"flat", "hall"} and all(0.0 < loss < 1.0 for loss in found.losses.values())
    fails = fitted_failing(tried, mapped=True, with_view=True)
    np.testing.assert_allclose(fails.w[1:], [f.features, f.again, f.in_view], atol=0.2)


def test_every_kind_of_world_counts_the_same() -> None:
    rows = [row(kind="flat"), row(kind="flat"), row(kind="flat"), row(kind="hall")]
    assert weights(rows).tolist() == pytest.approx([1 / 6, 1 / 6, 1 / 6, 1 / 2])


def test_an_image_follows_the_informative_one_before_it_in_the_same_drive() -> None:
    rows = [
        row(),
        row(features=59, poses=[{}]),  # says nothing
        row(p=[0.3, 0.0, 0.0], heading=0.2, poses=[{}]),
        row(p=[0.3, 0.0, 0.0], heading=0.2 - 2 * np.pi),
        row(after=True),  # put down elsewhere
        row(drive=3, after=True),
    ]
    for r in rows:
        del r["failed_before"], r["moved"]
    first, second, third, *others = with_previous(rows)
    assert "moved" not in first and not any("moved" in r or "failed_before" in r for r in others) and len(others) == 2
    assert (second["failed_before"], second["moved"]) == (1.0, pytest.approx(1.75))
    assert (third["failed_before"], third["moved"]) == (0.0, pytest.approx(0.0))


def test_ranges_of_numbers() -> None:
    assert numbers("101-103,200") == [101, 102, 103, 200]
