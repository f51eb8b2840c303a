"""Is the robot standing still? Image and IMU must both say so. And since when: its pose then is its pose now."""

from __future__ import annotations

from collections import deque

import numpy as np

from shared.geometry import FloatArray
from station.model.frames import ImuBatch
from station.slam.ukf.batch.motion_start import StartConfig
from station.slam.ukf.filter.constraints import SamePlace, WheelConfig, turn_between
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.memory import RecentFrame
from station.vision.klt import TrackedFrame


class StillnessDetector:
    """Watches the features' displacement over a while, and how quiet the IMU is."""

    def __init__(self, config: StartConfig) -> None:
        self._config = config
        self._frames: deque[tuple[int, TrackedFrame]] = deque()

    def reset(self) -> None:
        self._frames.clear()

    def update(self, t_imu_ns: int, frame: TrackedFrame, imu: ImuBatch) -> bool:
        """Take a frame in; True when nothing moved over the last still_s.

        Args:
            imu: samples of at least the last still_s.
        """
        config = self._config
        window_ns = int(config.still_s * 1e9)
        self._frames.append((t_imu_ns, frame))
        while len(self._frames) > 1 and self._frames[1][0] <= t_imu_ns - window_ns:
            self._frames.popleft()
        t_first, first = self._frames[0]
        if t_imu_ns - t_first < 0.95 * window_ns:
            return False
        _, i, j = np.intersect1d(first.ids, frame.ids, assume_unique=True, return_indices=True)
        if len(i) < 8:
            return False
        moved = float(np.median(np.linalg.norm(first.uv_px[i] - frame.uv_px[j], axis=1)))
        recent = imu.t_robot_ns > t_imu_ns - window_ns
        if moved > config.still_flow_px or recent.sum() < 5:
            return False
        gyro, accel = imu.gyro_imu[recent], imu.accel_imu[recent]
        # Means of ten samples: what shakes faster than that moves nothing.
        gyro, accel = _means_of_ten(gyro), _means_of_ten(accel)
        return bool(
            gyro.std(axis=0).max() < config.still_gyro and accel.std(axis=0).max() < config.still_accel
        )  # fmt: skip


def _means_of_ten(
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    count = max(1, len(values) // 10)
    size = len(values) // count
    return values[: count * size].reshape(count, size, 3).mean(axis=1)


class Standstill:
    """Remembers the frame with which standing still began."""

    def __init__(self) -> None:
        self._since: int | None = None  # ImageFrame.index
        self._newest = -1

    def reset(self) -> None:
        self._since, self._newest = None, -1

    @property
    def began_with_previous(self) -> bool:
        """Whether the newest frame is the one that the following ones refer to, so that it must stay in the window."""
        return self._since == self._newest

    def update(self, frame_index: int, is_still: bool) -> None:
        if not is_still:
            self._since = None
        elif self._since is None:
            self._since = frame_index
        self._newest = frame_index

    def same_place(
        self,
        recent: dict[int, RecentFrame],
        state: FilterState,
        current: RecentFrame,
        R_body_cam: FloatArray,
        config: WheelConfig,
    ) -> SamePlace | None:
        """The pose of the frame with which standing still began, and the turn since then by the image."""
        since = self._since
        if since is None or since not in recent or since not in state.clone_frame:
            self._since = None
            return None
        then, now = recent[since].tracked, current.tracked
        _, i, j = np.intersect1d(then.ids, now.ids, assume_unique=True, return_indices=True)
        turn = turn_between(then.xy[i], now.xy[j], R_body_cam)
        return None if turn is None else SamePlace(since, turn, config.sigma_still_rad, config.sigma_still_m)
