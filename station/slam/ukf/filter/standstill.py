"""Since when the robot stands still: its pose then is its pose now (docs/slam.md, sec. 9)."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.slam.ukf.filter.constraints import SamePlace, WheelConfig, turn_between
from station.slam.ukf.filter.state import FilterState
from station.vision.klt import TrackedFrame


class Standstill:
    """Remembers the frame with which standing still began."""

    def __init__(self) -> None:
        self.since: int | None = None  # that frame's ImageFrame.index; None while the robot moves
        self._newest = -1

    def reset(self) -> None:
        self.since, self._newest = None, -1

    @property
    def began_with_previous(self) -> bool:
        """Whether the newest frame is the one that the following ones refer to, so that it must stay in the window."""
        return self.since == self._newest

    def update(self, frame_index: int, is_still: bool) -> None:
        if not is_still:
            self.since = None
        elif self.since is None:
            self.since = frame_index
        self._newest = frame_index

    def same_place(
        self,
        then: TrackedFrame | None,
        now: TrackedFrame,
        state: FilterState,
        R_body_cam: FloatArray,
        config: WheelConfig,
    ) -> SamePlace | None:
        """The pose of the frame with which standing still began, and the turn since then by the image.

        Args:
            then: what the frame `since` saw; None where it is known no more.
        """
        since = self.since
        if since is None or then is None or since not in state.clone_frame:
            self.since = None
            return None
        _, i, j = np.intersect1d(then.ids, now.ids, assume_unique=True, return_indices=True)
        turn = turn_between(then.xy[i], now.xy[j], R_body_cam)
        return None if turn is None else SamePlace(since, turn, config.sigma_still_rad, config.sigma_still_m)
