"""Chooses keyframes online by how far tracked corners have moved."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from station.model.frames import ImageArray
from station.slam.sfm.config import KeyframeConfig

MIN_CORNERS = 12  # fewer cannot say how far the picture moved
LK_WINDOW = (15, 15)
LK_LEVELS = 3
FORWARD_BACKWARD_PX = 1.0  # a track must come back to where it started


class KeyframeSelector:
    """Tracks corners of the last keyframe from frame to frame (Lucas-Kanade, pyramidal)."""

    def __init__(self, config: KeyframeConfig) -> None:
        self._config = config
        self._previous: ImageArray | None = None
        self._start: npt.NDArray[np.float32] = np.empty((0, 2), np.float32)  # corners in the last keyframe
        self._now: npt.NDArray[np.float32] = np.empty((0, 2), np.float32)  # where they are in the last frame
        self._t_keyframe_ns = 0
        self.flow = 0.0  # fraction of the image width since the last keyframe

    def is_keyframe(self, grey: ImageArray, t_ns: int, has_odometry: bool = False) -> bool:
        """Take one frame in; True when it should become a keyframe."""
        config = self._config
        min_flow = config.min_flow_with_odometry if has_odometry else config.min_flow
        width = config.track_width_px
        small = grey
        if grey.shape[1] > width:
            height = round(grey.shape[0] * width / grey.shape[1])
            small = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if self._previous is None:
            self._restart(small, t_ns)
            return True
        self._track(small)
        self._previous = small
        left = len(self._now)
        self.flow = float(np.median(np.linalg.norm(self._now - self._start, axis=1))) / small.shape[1] if left else 1.0
        lost_many = left < max(MIN_CORNERS, self._config.min_tracked * self._num_started)
        # A blank wall has no corners to lose: wait for corners or for time.
        blank = self._num_started < MIN_CORNERS
        waited = t_ns - self._t_keyframe_ns >= self._config.max_interval_s * 1e9
        moved = self.flow >= min_flow
        if blank:
            take = waited or self._has_corners(small)
        else:
            take = moved or lost_many or (waited and self.flow >= 0.2 * min_flow)
        if take:
            self._restart(small, t_ns)
        return take

    def _has_corners(self, small: ImageArray) -> bool:
        return len(self._corners(small)) >= MIN_CORNERS

    def _corners(self, small: ImageArray) -> npt.NDArray[np.float32]:
        found = cv2.goodFeaturesToTrack(small, self._config.num_corners, 0.01, 7)
        return np.empty((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)

    def _restart(self, small: ImageArray, t_ns: int) -> None:
        self._previous = small
        self._start = self._now = self._corners(small)
        self._num_started = len(self._start)
        self._t_keyframe_ns = t_ns
        self.flow = 0.0

    def _track(self, small: ImageArray) -> None:
        if not len(self._now) or self._previous is None:
            return
        points = self._now.reshape(-1, 1, 2)
        moved, found, _ = cv2.calcOpticalFlowPyrLK(
            self._previous, small, points, np.empty_like(points), winSize=LK_WINDOW, maxLevel=LK_LEVELS
        )
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(
            small, self._previous, moved, np.empty_like(points), winSize=LK_WINDOW, maxLevel=LK_LEVELS
        )
        error = np.linalg.norm((back - points).reshape(-1, 2), axis=1)
        good = (found.ravel() == 1) & (found_back.ravel() == 1) & (error < FORWARD_BACKWARD_PX)
        self._start, self._now = self._start[good], moved.reshape(-1, 2)[good]
