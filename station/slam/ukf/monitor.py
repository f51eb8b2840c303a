"""Is tracking still sound? The reasons to give it up, in words (docs/slam.md, sec. 8)."""

from __future__ import annotations

from collections import deque

import numpy as np

from station.slam.ukf.config import UkfConfig
from station.slam.ukf.filter.constraints import BodyVelocity
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
# What covers a lens keeps the light out all at once and gives it back so; walls do not, and exposure, which makes up
# for it, takes longer. docs/studies/ukf-map.md has the measurement.
COVERED = 1 / 3  # of the light that there was
DARKENING_FRAMES, CLEARING_FRAMES = 12, 3


class TrackingMonitor:
    def __init__(self, config: UkfConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        self.outage_since: int | None = None  # IMU time since when nothing is known of the motion but by the IMU
        self._blind_since: int | None = None  # IMU time since when the image shows too little
        self._light: deque[float] = deque(maxlen=DARKENING_FRAMES)  # brightness of the last images, uncovered
        self._dark: deque[float] = deque(
            maxlen=CLEARING_FRAMES
        )  # the same, covered; empty while nothing covers the lens
        self._disagreements = 0
        self._lifted = 0
        self._tried = self._passed = 0.0

    def why_lost(
        self, state: FilterState, frame: TrackedFrame, t_imu_ns: int, wheels: BodyVelocity | None, result: FrameResult
    ) -> str | None:
        """The reason to give up tracking; None while it is sound.

        wheels: what they say of this frame; None of a rig that has none.
        """
        config = self._config
        if not is_finite(state):
            return "the estimate stopped making sense"
        if self._is_blind_too_long(frame, t_imu_ns, wheels is not None and bool(np.isfinite(wheels.sigma[0]))):
            return "the image shows nothing to follow"
        if wheels is not None:
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

    def _is_blind_too_long(self, frame: TrackedFrame, t_imu_ns: int, rolls: bool) -> bool:
        """Whether the images have shown too little for longer than the other sensors bear.

        rolls: wheels say how fast the robot goes. Before a blank wall wheels and IMU go on, and no outage begins; not
        under a cover: what covers the lens may carry the robot away.
        """
        config = self._config
        if frame.num_tracked >= config.min_features:
            self._blind_since = self.outage_since = None
            self._dark.clear()
            self._light.append(frame.brightness)
            return False
        is_covered = self._is_covered(frame.brightness)
        if self._blind_since is None:
            self._blind_since = t_imu_ns
        if rolls and not is_covered:
            self.outage_since = None
            return t_imu_ns - self._blind_since > config.max_outage_wheels_s * 1e9
        if self.outage_since is None:
            self.outage_since = t_imu_ns
        return t_imu_ns - self.outage_since > (config.max_covered_s if rolls else config.max_outage_s) * 1e9

    def _is_covered(self, brightness: float) -> bool:
        """Whether something keeps the light out."""
        if self._dark and min(self._dark) < COVERED * brightness:
            self._dark.clear()
        if self._dark or brightness < COVERED * max(self._light, default=0.0):
            self._dark.append(brightness)
            return True
        self._light.append(brightness)
        return False

    def _seldom_fits(self, result: FrameResult) -> bool:
        """Over the last second most of what the camera saw was refused, as with a calibration that is wrong."""
        tried = result.num_landmarks_observed + result.num_window_tried + result.num_window_misfits
        passed = result.num_landmarks_passed + result.num_window_used
        self._tried = MEMORY * self._tried + tried
        self._passed = MEMORY * self._passed + passed
        return self._tried > MIN_REMEMBERED and self._passed < FEW_FIT * self._tried
