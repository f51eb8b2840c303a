"""Sensor data as the estimation sees it: from the link, a dataset or a recording; robot clock."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shared.calibration import DepthCalibration
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray
from shared.pictures import picture_size

ImageArray = npt.NDArray[np.uint8]
DepthArray = npt.NDArray[np.uint16]  # mm along the sensor's axis; 0: nothing was measured
NO_DEPTH = (0, 0xFFFF)  # what sensors and datasets write for it


def decode_picture(encoded: bytes, flags: int) -> ImageArray:
    """Pixels of a JPEG or PNG file, as cv2's `flags` say. Raises ValueError as picture_size does."""
    picture_size(encoded)
    image = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), flags)
    if image is None:
        raise ValueError("is not a readable JPEG or PNG")
    return np.asarray(image, dtype=np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class ImageFrame:
    """One camera image, still encoded: who needs pixels decodes them."""

    index: int  # position in the navigation, counts every frame seen
    t_robot_ns: int  # mid-exposure of the first row, camera clock as delivered (see CameraCalibration.time_shift_s)
    exposure_ns: int  # 0 where unknown
    encoded: bytes  # a JPEG or PNG file
    name: str = ""  # file name in a dataset, for messages

    def grey(self) -> ImageArray:
        """Pixels (H, W). Raises DataError when the image cannot be decoded."""
        return self._decode(cv2.IMREAD_GRAYSCALE)

    def bgr(self) -> ImageArray:
        """Pixels (H, W, 3), blue first. Raises DataError when the image cannot be decoded."""
        return self._decode(cv2.IMREAD_COLOR)

    def half_bgr(self) -> ImageArray:
        """Pixels at half size, blue first: of a JPEG in less than half of bgr()'s time. Raises DataError like it."""
        return self._decode(cv2.IMREAD_REDUCED_COLOR_2)

    def _decode(self, flags: int) -> ImageArray:
        try:
            return decode_picture(self.encoded, flags)
        except ValueError as exc:
            raise DataError(f"image {self.name or self.index} {exc}; remove it or copy it again") from exc


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrame:
    """What a depth sensor measured at one time: a picture of distances, or the few zones of a time-of-flight sensor."""

    t_robot_ns: int  # the IMU's clock
    encoded: bytes  # a PNG file of 16 bit grey: mm along the sensor's axis, 0 or 65535 where nothing was measured
    sensor: DepthCalibration
    name: str = ""  # file name in a dataset, for messages

    def millimetres(self) -> DepthArray:
        """(H, W). Raises DataError when it cannot be decoded, or is no picture of this sensor."""
        what = f"depth picture {self.name or self.t_robot_ns}"
        try:
            size = picture_size(self.encoded)
        except ValueError as exc:
            raise DataError(f"{what} {exc}; remove it or copy it again") from exc
        if size != (self.sensor.width, self.sensor.height):  # before it takes memory
            raise DataError(
                f"{what} is {size[0]}x{size[1]}, the calibration is for {self.sensor.width}x{self.sensor.height}; "
                "give the calibration of these pictures"
            )
        image = cv2.imdecode(np.frombuffer(self.encoded, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16 or image.ndim != 2:
            raise DataError(f"{what} is no PNG of 16 bit grey; remove it or copy it again")
        return np.where(image == NO_DEPTH[1], 0, image).astype(np.uint16)


@dataclass(frozen=True, slots=True, eq=False)
class ImuBatch:
    """Inertial samples in time order."""

    t_robot_ns: IntArray  # (N,)
    gyro_imu: FloatArray  # (N, 3) rad/s
    accel_imu: FloatArray  # (N, 3) m/s^2, specific force: +9.81 along up at rest

    def __len__(self) -> int:
        return len(self.t_robot_ns)


@dataclass(frozen=True, slots=True)
class DriveSample:
    """The velocity the motors were told to hold from this time on, and the angles the head's servos were told then."""

    t_robot_ns: int
    linear_m_s: float
    angular_rad_s: float
    pan_rad: float = 0.0  # positive left
    tilt_rad: float = 0.0  # positive up
