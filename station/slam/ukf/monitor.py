"""Is tracking still sound? The reasons to give it up, in words (docs/slam.md, sec. 8)."""

from __future__ import annotations

from collections import deque

import numpy as np

from station.slam.ukf.config import UkfConfig
from station.slam.ukf.filter.filter import FrameResult
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.filter.update import is_finite
from station.vision.klt import TrackedFrame

MIN_JUDGED = 6  # landmarks; fewer cannot outvote the IMU
FEW_PASSED = 0.3  # share of the landmarks that pass their gate
FEW_FIT = 0.4  # of landmarks and tracks over a second; 0.98 on a real flight
MEMORY = 0.95  # per frame: about a second of measurements
MIN_REMEMBERED = 25  # landmarks and tracks
LIFTED = "the robot is being lifted"
CONTRADICTION = "image and IMU contradict each other"
LIFTED_FRAMES = 3  # consecutive
# What covers a lens keeps the light out all at once, a wall does not.
COVERED = 1 / 3  # of the brightness that images had in which there was something to follow
BRIGHTNESS_FRAMES = 12


class TrackingMonitor:
    def __init__(self, config: UkfConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        self.outage_since: int | None = None  # IMU time since when nothing is known of the motion but by the IMU
        self._brightness: deque[float] = deque(maxlen=BRIGHTNESS_FRAMES)  # of the last images with something to follow
        self._disagreements = 0
        self._lifted = 0
        self._tried = self._passed = 0.0

    def why_lost(
        self, state: FilterState, frame: TrackedFrame, t_imu_ns: int, has_wheels: bool, result: FrameResult
    ) -> str | None:
        """The reason to give up tracking; None while it is sound."""
        config = self._config
        if not is_finite(state):
            return "the estimate stopped making sense"
        if self._blind_for_s(frame, t_imu_ns, has_wheels) > (
            config.max_covered_s if has_wheels else config.max_outage_s
        ):
            return "the image shows nothing to follow"
        if has_wheels:
            climbs = abs(float(state.v[2])) > config.max_climb_m_s
            tilts = float(state.R[2, 2]) < config.min_upright
            self._lifted = self._lifted + 1 if climbs or tilts else 0
            if self._lifted >= LIFTED_FRAMES:
                return LIFTED
        speed = float(np.linalg.norm(state.v))
        if speed > config.max_speed_m_s:
            return f"the estimated speed of {speed:.0f} m/s is impossible"
        tried = result.num_landmarks_observed
        disagrees = tried >= MIN_JUDGED and result.num_landmarks_passed < FEW_PASSED * tried
        self._disagreements = self._disagreements + 1 if disagrees else 0
        if self._disagreements >= config.max_disagreements or self._seldom_fits(result):
            return CONTRADICTION
        return None

    def _blind_for_s(self, frame: TrackedFrame, t_imu_ns: int, has_wheels: bool) -> float:
        """For how long the images have shown too little; 0 while they show enough.

        A robot on wheels is not blind before a blank wall, where its wheels and IMU go on, but under a cover: what
        covers its lens may carry it away.
        """
        if frame.num_tracked >= self._config.min_features:
            self.outage_since = None
            self._brightness.append(frame.brightness)
            return 0.0
        is_wall = has_wheels and frame.brightness > COVERED * max(self._brightness, default=0.0)
        if self.outage_since is None and not is_wall:
            self.outage_since = t_imu_ns  # until there is something to follow: exposure makes up for a cover in seconds
        return 0.0 if self.outage_since is None else (t_imu_ns - self.outage_since) * 1e-9

    def _seldom_fits(self, result: FrameResult) -> bool:
        """Over the last second most of what the camera saw was refused, as with a calibration that is wrong."""
        tried = result.num_landmarks_observed + result.num_window_tried + result.num_window_misfits
        passed = result.num_landmarks_passed + result.num_window_used
        self._tried = MEMORY * self._tried + tried
        self._passed = MEMORY * self._passed + passed
        return self._tried > MIN_REMEMBERED and self._passed < FEW_FIT * self._tried
