"""The newest keyframe in the filter's world, and how the robot has moved since by the filter."""

from __future__ import annotations

from shared.geometry import FloatArray, inverse, se3
from station.slam.ukf.filter.state import FilterState


class NewestInFilter:
    """Follows the newest keyframe through what the filter corrects: that is no motion of the robot."""

    def __init__(self, T_filter: FloatArray) -> None:
        self.T_filter = T_filter  # (4, 4) of the keyframe, in the filter's world
        self._T_clones: dict[int, FloatArray] = {}  # by frame, in the filter's world, when it was asked last

    def moved(self, frame_index: int, state: FilterState) -> FloatArray:
        """T_keyframe_now (4, 4) by the filter, both poses as it has them now; `frame_index`: of the newest keyframe.

        A keyframe whose clone has left its window moves with the newest clone that was there beside it.
        """
        now = {int(f): se3(R, x) for f, R, x in zip(state.clone_frame, state.clone_R, state.clone_x, strict=True)}
        if frame_index in now:
            self.T_filter = now[frame_index]
        elif (beside := max(now.keys() & self._T_clones.keys(), default=None)) is not None:
            self.T_filter = now[beside] @ inverse(self._T_clones[beside]) @ self.T_filter
        self._T_clones = now
        return inverse(self.T_filter) @ state.T_world_body
