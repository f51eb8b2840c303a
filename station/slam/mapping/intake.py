"""Which images are used: in time order, decodable, of the calibration's size. The others are counted."""

from __future__ import annotations

from shared.calibration import CameraCalibration
from shared.errors import DataError
from station.model.frames import ImageArray, ImageFrame
from station.slam.backend import check_size


class FrameIntake:
    def __init__(self, camera: CameraCalibration) -> None:
        self._camera = camera
        self.first_t_ns = 0
        self.last_t_ns = 0
        self.used = 0
        self.out_of_order = 0
        self.undecodable = 0
        self.without_imu = 0

    @property
    def elapsed_s(self) -> float:
        """From the first to the last image that was used."""
        return (self.last_t_ns - self.first_t_ns) * 1e-9

    def take(self, frame: ImageFrame) -> ImageArray | str:
        """The grey image (H, W), or why the frame is left out. Raises ConfigError for another size."""
        if self.used and frame.t_robot_ns <= self.last_t_ns:
            self.out_of_order += 1
            return "image out of order: left out"
        try:
            grey = frame.grey()
        except DataError as exc:
            self.undecodable += 1
            return str(exc)
        check_size(frame, grey, self._camera)
        if not self.used:
            self.first_t_ns = frame.t_robot_ns
        self.last_t_ns = frame.t_robot_ns
        self.used += 1
        return grey
