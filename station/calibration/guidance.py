"""What a guide says after each look at the target, whatever is calibrated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from station.calibration.target import BoardView

GuidedKind = Literal["camera", "camera-imu", "wheels", "imu", "check"]
WITHOUT_BOARD: tuple[GuidedKind, ...] = ("imu", "check")  # followed by the inertial unit alone
MAX_BLUR_PX = 2.0
MIN_CORNERS = 12


@dataclass(frozen=True, slots=True)
class Guidance:
    """What one look at the board came to."""

    instruction: str  # what to do next
    is_taken: bool  # this view counts
    num_views: int  # that count
    cells: tuple[float, ...]  # how full each cell of the picture is, 0..1, by rows from the upper left; or none matters
    poses: dict[str, float]  # how much of each wanted pose or motion there is, 0..1
    may_finish: bool  # there may be enough to estimate from
    is_enough: bool  # everything is full


class TargetGuide(Protocol):
    """Says what to show next."""

    @property
    def views(self) -> list[BoardView]:
        """Those that count."""

    def look(self, view: BoardView | None) -> Guidance:
        """Take in what a picture shows of the target; None: nothing."""
