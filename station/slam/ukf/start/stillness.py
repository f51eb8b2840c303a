"""Is the robot standing still? Image and IMU must both say so (commands may be wrong, and hands move robots)."""

from __future__ import annotations

from collections import deque

import numpy as np

from station.model.frames import ImuBatch
from station.slam.ukf.start.motion_start import StartConfig
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
