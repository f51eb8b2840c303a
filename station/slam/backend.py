"""The interface of every SLAM backend, online and offline. Pure: no clock, socket, thread; time is in the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from shared.calibration import CameraCalibration
from shared.errors import ConfigError
from station.model.frames import DriveSample, ImageArray, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.vision.features import Features


class SlamBackend(Protocol):
    """Fed in sensor-time order: IMU and drive samples up to a frame's time come before the frame."""

    def add_imu(self, imu: ImuBatch) -> None: ...

    def add_drive(self, drive: DriveSample) -> None: ...

    def add_frame(self, frame: ImageFrame) -> SlamUpdate: ...

    def catch_up(self) -> bool:
        """Do a piece of the work that can wait, while no data do; False when nothing waits. `finish` does the rest."""
        ...

    def keyframe_pictures(self) -> Sequence[bytes]:
        """Encoded images that are going to be keyframes, as far as is known by now; a shorter list is a new one."""
        ...

    def keyframe_features(self, number: int) -> Features | None:
        """What `FeatureExtractor` finds in keyframe_pictures()[number]; None where the backend did not use it."""
        ...

    def finish(self) -> Navigation:
        """End the navigation. Raises EstimationError, with the reason, when nothing could be reconstructed."""
        ...


def check_size(frame: ImageFrame, pixels: ImageArray, camera: CameraCalibration) -> None:
    """Raises ConfigError when the image (H, W) has another size than the calibration's."""
    if pixels.shape[:2] != (camera.height, camera.width):
        raise ConfigError(
            f"image {frame.name or frame.index} is {pixels.shape[1]}x{pixels.shape[0]}, the calibration is for "
            f"{camera.width}x{camera.height}; give the calibration of these images"
        )
