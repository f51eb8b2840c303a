"""What is known of a robot's sensors before any data: camera model, noise, mounting. Travels in the hello."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, get_args

import msgspec
import numpy as np

from shared.errors import ConfigError
from shared.geometry import FloatArray, inverse, orthonormal, se3
from shared.text import PRINTABLE

Rig = Literal["wheels", "hand-held", "unknown"]
RIGS: tuple[str, ...] = get_args(Rig)
MAX_IMAGE_SIDE_PX = 8192
Side = Annotated[int, msgspec.Meta(ge=1, le=MAX_IMAGE_SIDE_PX)]
IDENTITY = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
MAX_DEPTH_SIDE_PX = 2048  # no depth camera has more
# Half a pixel's width by the distance. Zones of a VL53L5CX have 0.05 (8 x 8) or 0.1 (4 x 4), an HC-SR04 0.27.
MAX_RAY_SPREAD = 0.15
MAX_SHIFT_S = 10.0  # between the clocks of one robot's sensors; more is a mistake of units
MAX_LINE_DELAY_S = 0.01  # a row every 10 ms would take seconds for one image
# Beyond these no phone, fisheye or telescope goes: a number is in the wrong place or unit.
FOCAL_SIDES = (0.05, 50.0)  # focal length over the picture's longer side
MAX_PIXEL_ASPECT = 4.0  # fx over fy, or fy over fx
MAX_DISTORTION = 1000.0
MAX_LEVER_M = 10.0  # camera or head from the IMU
LEAST_UPRIGHT = 0.5  # sine of the angle between looking straight up or down and where a camera looks
MAX_SKEW = 1e-3  # of a rotation's rows from unit length and right angles
MAX_NOISE = 10.0  # of a gyroscope's or accelerometer's densities and walks, SI units
MAX_SCALE, MAX_MISALIGNMENT_RAD = 2.0, 0.5  # of an accelerometer; more is a mistake of units
MAX_RATE_HZ = 1e5
WHEEL_FACTORS = (0.1, 10.0)  # beyond, a command and what comes of it are not the same motion
GRAVITIES = (1.0, 30.0)  # m/s^2, smaller than the Moon's, more than Jupiter's


def _check_mounting(name: str, T: tuple[float, ...], sensor: str) -> None:
    """Whether 16 numbers are a rigid motion that puts a sensor on a robot. Raises ConfigError."""
    if len(T) != 16:
        raise ConfigError(f"{name} has {len(T)} numbers, needs 16 (row-major 4x4)")
    R = np.array(T, dtype=np.float64).reshape(4, 4)[:3, :3]
    may_be = np.abs(R).max() <= 1.0 + MAX_SKEW  # products of larger numbers may overflow
    is_rotation = may_be and np.abs(R @ R.T - np.eye(3)).max() <= MAX_SKEW and np.linalg.det(R) > 0
    if not is_rotation or T[12:] != (0, 0, 0, 1):
        raise ConfigError(
            f"{name} is no rigid motion: its rotation's rows must be right-handed unit axes, its last row 0, 0, 0, 1"
        )
    if math.hypot(T[3], T[7], T[11]) > MAX_LEVER_M:
        raise ConfigError(f"{name} puts the {sensor} further than {MAX_LEVER_M:g} m from the IMU; it is in metres")


class CameraCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """Pinhole camera with lens distortion, mounted on the body (= IMU). The centre of the first pixel is (0, 0).

    T_body_cam is that of a head that looks straight ahead; a turned one carries the camera along (shared/head.py).
    """

    width: Side
    height: Side
    fx: float
    fy: float
    cx: float
    cy: float
    model: Literal["radtan", "equidistant"] = "radtan"
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)  # radtan: k1 k2 p1 p2; equidistant: k1 k2 k3 k4
    T_body_cam: tuple[float, ...] = IDENTITY  # row-major 4x4
    time_shift_s: float = 0.0  # t_imu = t_cam + time_shift_s
    line_delay_s: float = 0.0  # rolling shutter: row v is exposed line_delay_s * v after row 0; 0 is a global shutter
    rate_hz: float = 20.0
    is_measured: bool = True  # False: another camera's numbers, for want of its own

    def __post_init__(self) -> None:
        if not (0 < self.width <= MAX_IMAGE_SIDE_PX and 0 < self.height <= MAX_IMAGE_SIDE_PX):
            raise ConfigError(f"camera size {self.width}x{self.height} is outside 1..{MAX_IMAGE_SIDE_PX} pixels")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion, *self.T_body_cam)
        if not all(math.isfinite(n) for n in numbers):
            raise ConfigError("camera calibration holds a number that is not finite")
        # Written so that NaN fails as well.
        if not 1e-3 <= self.rate_hz <= MAX_RATE_HZ:
            raise ConfigError(f"rate_hz is {self.rate_hz:g}, must be 0.001 to {MAX_RATE_HZ:.0f} images a second")
        if not abs(self.time_shift_s) <= MAX_SHIFT_S:
            raise ConfigError(f"time_shift_s is {self.time_shift_s:g}, must be within {MAX_SHIFT_S:g} s")
        if not abs(self.line_delay_s) <= MAX_LINE_DELAY_S:
            raise ConfigError(f"line_delay_s is {self.line_delay_s:g}, must be within {MAX_LINE_DELAY_S:g} s")
        if len(self.distortion) != 4:
            raise ConfigError(f"distortion has {len(self.distortion)} numbers, needs 4")
        self._check_lens()
        _check_mounting("T_body_cam", self.T_body_cam, "camera")

    def _check_lens(self) -> None:
        if self.fx <= 0 or self.fy <= 0:
            raise ConfigError(f"focal length ({self.fx}, {self.fy}) px must be positive")
        shortest, longest = (sides * max(self.width, self.height) for sides in FOCAL_SIDES)
        if not (shortest <= self.fx <= longest and shortest <= self.fy <= longest):
            raise ConfigError(
                f"focal length ({self.fx:g}, {self.fy:g}) px is none that a lens gives pictures of"
                f" {self.width}x{self.height}, which is {shortest:g} to {longest:g} px"
            )
        if max(self.fx / self.fy, self.fy / self.fx) > MAX_PIXEL_ASPECT:
            raise ConfigError(f"focal lengths {self.fx:g} and {self.fy:g} px differ more than any sensor's pixels do")
        if max(map(abs, self.distortion)) > MAX_DISTORTION:
            raise ConfigError(f"distortion {self.distortion} is no lens's, whose numbers are within {MAX_DISTORTION:g}")

    @property
    def middle_row_shift_s(self) -> float:
        """From an image's stamp to the exposure of its middle row, in the IMU's clock."""
        return self.time_shift_s + 0.5 * (self.height - 1) * self.line_delay_s

    @property
    def K(self) -> FloatArray:
        """Intrinsics (3, 3) px. Thesis eq. 3.1 with zero skew."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def T_body_cam_matrix(self) -> FloatArray:
        """(4, 4), maps camera to body coordinates."""
        return np.array(self.T_body_cam, dtype=np.float64).reshape(4, 4)

    @property
    def T_cam_body_matrix(self) -> FloatArray:
        """(4, 4), maps body to camera coordinates."""
        return inverse(self.T_body_cam_matrix)


class DepthCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """A depth sensor, as a pinhole camera without distortion whose pixels are distances along its axis.

    A depth camera has many pixels, a time-of-flight sensor as the VL53L5CX 8 x 8, an HC-SR04 one. It is fixed to the
    body.
    """

    width: Side
    height: Side
    fx: float
    fy: float
    cx: float
    cy: float
    T_body_depth: tuple[float, ...] = IDENTITY  # row-major 4x4
    is_measured: bool = True  # False: where it sits is a guess

    def __post_init__(self) -> None:
        if not (0 < self.width <= MAX_DEPTH_SIDE_PX and 0 < self.height <= MAX_DEPTH_SIDE_PX):
            raise ConfigError(f"depth pictures of {self.width}x{self.height} are outside 1..{MAX_DEPTH_SIDE_PX} pixels")
        if not all(math.isfinite(n) for n in (self.fx, self.fy, self.cx, self.cy, *self.T_body_depth)):
            raise ConfigError("the depth sensor's calibration holds a number that is not finite")
        shortest, longest = (sides * max(self.width, self.height) for sides in FOCAL_SIDES)
        if not (shortest <= self.fx <= longest and shortest <= self.fy <= longest):
            raise ConfigError(
                f"focal length ({self.fx:g}, {self.fy:g}) px is none that a depth sensor of"
                f" {self.width}x{self.height} pixels has, which is {shortest:g} to {longest:g} px"
            )
        _check_mounting("T_body_depth", self.T_body_depth, "depth sensor")

    @property
    def T_body_depth_matrix(self) -> FloatArray:
        """(4, 4), maps the sensor's coordinates (z along its axis, x right, y down) to body coordinates."""
        return np.array(self.T_body_depth, dtype=np.float64).reshape(4, 4)

    @property
    def is_cone(self) -> bool:
        """Whether its pixels are so wide that they tell how near the nearest thing in them is, but not where."""
        return 0.5 / min(self.fx, self.fy) > MAX_RAY_SPREAD

    def thinned(self, step: int) -> DepthCalibration:
        """Of every step-th pixel of every step-th row, from the middle of the first step x step pixels on."""
        first = (step - 1) // 2
        return msgspec.structs.replace(
            self,
            width=len(range(first, self.width, step)),
            height=len(range(first, self.height, step)),
            fx=self.fx / step,
            fy=self.fy / step,
            cx=(self.cx - first) / step,
            cy=(self.cy - first) / step,
        )


class HeadCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """A pan-tilt head that carries the camera. Pan turns about the body's z axis, tilt about the head's own y axis."""

    pivot_body: tuple[float, float, float]  # m, where both axes cross
    max_pan: float = math.radians(80)  # rad, to either side
    max_tilt: float = math.radians(40)
    speed: float = 0.7  # rad/s, at which the robot leads its servos: faster, pictures blur and show nothing twice
    lag_s: float = 0.06  # by which the servos follow what they are told
    sigma: float = math.radians(3)  # rad, how far from the angle they are told hobby servos come to rest

    def __post_init__(self) -> None:
        numbers = (self.max_pan, self.max_tilt, self.speed, self.sigma)
        if not all(map(math.isfinite, self.pivot_body)) or not all(0 < n < math.inf for n in numbers):
            raise ConfigError("the head's calibration holds a number that is not positive and finite")
        if math.hypot(*self.pivot_body) > MAX_LEVER_M:
            raise ConfigError(f"the head's pivot is further than {MAX_LEVER_M:g} m from the IMU; it is in metres")
        if not 0 <= self.lag_s <= MAX_SHIFT_S:
            raise ConfigError(f"the head's lag_s is {self.lag_s:g}, must be within 0 to {MAX_SHIFT_S:g} s")


class AccelerometerCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """What a sensor makes of forces, but for its bias, which drifts and is estimated on the way.

    force = T (scale * reading), T of `upper_triangular`. Source: Tedaldi, Pretto and Menegatti, ICRA 2014, eqs. 2, 5.
    """

    scale: tuple[float, float, float]
    misalignment: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad: y towards x, z towards x, z towards y

    def __post_init__(self) -> None:
        if not all(1 / MAX_SCALE <= s <= MAX_SCALE for s in self.scale):
            raise ConfigError(f"the accelerometer's scale {self.scale} is none, 1 means right")
        if not all(abs(a) <= MAX_MISALIGNMENT_RAD for a in self.misalignment):
            raise ConfigError(f"the accelerometer's misalignment {self.misalignment} is none, it is in radians")

    def forces(self, readings: FloatArray) -> FloatArray:
        """(N, 3) of readings (N, 3), both m/s^2."""
        return np.asarray((np.array(self.scale) * readings) @ upper_triangular(self.misalignment).T)


def upper_triangular(angles: Sequence[float] | FloatArray) -> FloatArray:
    """(3, 3) from axes that are not at right angles, x right: Tedaldi, Pretto and Menegatti, ICRA 2014, eq. 2."""
    yx, zx, zy = angles
    return np.array([[1.0, -yx, zx], [0.0, 1.0, -zy], [0.0, 0.0, 1.0]])


class ImuNoise(msgspec.Struct, frozen=True, kw_only=True):
    """Continuous-time noise of the IMU (Kalibr's conventions), and what is known of its accelerometer besides.

    Estimators divide by each noise, so that none is 0.
    """

    gyro_density: float  # rad/s/sqrt(Hz)
    accel_density: float  # m/s^2/sqrt(Hz)
    gyro_walk: float  # rad/s^2/sqrt(Hz)
    accel_walk: float  # m/s^3/sqrt(Hz)
    rate_hz: float
    gyro_range: float = math.inf  # rad/s: readings at the range are saturated
    accel_range: float = math.inf  # m/s^2
    accelerometer: AccelerometerCalibration | msgspec.UnsetType = msgspec.UNSET  # not measured

    def __post_init__(self) -> None:
        for name in ("gyro_density", "accel_density", "gyro_walk", "accel_walk"):
            if not 0 < getattr(self, name) <= MAX_NOISE:
                raise ConfigError(
                    f"the IMU's {name} is {getattr(self, name):g}, must be over 0, up to {MAX_NOISE:g} (SI units)"
                )
        if not 0 < self.rate_hz <= MAX_RATE_HZ:
            raise ConfigError(f"the IMU's rate_hz is {self.rate_hz:g}, must be over 0, up to {MAX_RATE_HZ:.0f}")
        if not (self.gyro_range > 0 and self.accel_range > 0):
            raise ConfigError(f"the IMU's ranges ({self.gyro_range:g}, {self.accel_range:g}) must be over 0")

    @property
    def densities(self) -> FloatArray:
        """(6,) of the gyroscope's axes, then the accelerometer's."""
        return np.repeat([self.gyro_density, self.accel_density], 3)

    def forces(self, readings: FloatArray) -> FloatArray:
        """(N, 3) m/s^2 of an accelerometer's readings (N, 3): as they are, where its errors were not measured."""
        known = self.accelerometer
        return known.forces(readings) if isinstance(known, AccelerometerCalibration) else readings


class WheelCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """What motors make of a command by themselves. Robot-server asks them for that much more, so that it comes true.

    Wheels that skid turn less than they roll: the two differ.
    """

    speed: float = 1.0  # m/s over ground for each commanded one
    turn: float = 1.0  # rad/s likewise

    def __post_init__(self) -> None:
        least, most = WHEEL_FACTORS
        for name in ("speed", "turn"):
            if not least <= getattr(self, name) <= most:
                raise ConfigError(f"the wheels' {name} is {getattr(self, name):g}, must be {least:g} to {most:g}")


class Calibration(msgspec.Struct, frozen=True, kw_only=True):
    """Everything the station must know of one robot's sensors, and what was measured of its wheels."""

    camera: CameraCalibration | None
    imu: ImuNoise | None
    # "sentinel": our own robot; anything else is a rig of which only the sensors are known
    robot_kind: Annotated[str, msgspec.Meta(max_length=64, pattern=PRINTABLE)] = "generic"
    gravity: float = 9.81
    rig: Rig = "unknown"  # what carries the sensors
    head: HeadCalibration | None = None  # None: the camera is fixed to the body
    wheels: WheelCalibration | msgspec.UnsetType = msgspec.UNSET  # not measured
    depth: DepthCalibration | msgspec.UnsetType = msgspec.UNSET  # it has no such sensor

    def __post_init__(self) -> None:
        lightest, heaviest = GRAVITIES
        if not lightest <= self.gravity <= heaviest:
            raise ConfigError(f"gravity is {self.gravity:g}, must be {lightest:g} to {heaviest:g} m/s^2")

    @property
    def wheel_factors(self) -> WheelCalibration:
        """As measured; or motors that do as they are told."""
        return self.wheels if isinstance(self.wheels, WheelCalibration) else WheelCalibration()

    @property
    def depth_sensor(self) -> DepthCalibration | None:
        return self.depth if isinstance(self.depth, DepthCalibration) else None

    @property
    def has_wheels(self) -> bool:
        """Whether it stands upright on driven wheels, so that drive commands and a level floor tell how it moves."""
        return self.rig == "wheels" or (self.rig == "unknown" and self.robot_kind == "sentinel")

    @property
    def up_in_image_deg(self) -> float | None:
        """Which way is up in its images, clockwise from their upper edge, to a quarter turn; None: any way.

        A robot on wheels stands upright, so its camera's mounting tells. A quarter turn: a mounting that is corrected
        by a degree does not change what is up.
        """
        if self.camera is None or not self.has_wheels:
            return None
        up_cam = self.camera.T_body_cam_matrix[2, :3]  # z of the body, x right and y down in the image
        if np.hypot(up_cam[0], up_cam[1]) < LEAST_UPRIGHT:
            return None  # it looks at the floor or the ceiling, where up is no direction
        return float(np.round(np.degrees(np.arctan2(up_cam[0], -up_cam[1])) / 90.0) * 90.0 % 360.0)


# Thesis eqs. 3.2-3.5. The printed rotation has 4 digits; the nearest true rotation is used.
# Body axes there: x forward (the camera's optical axis), y left, z up.
_R_BODY_CAM = orthonormal(np.array([[0.0116, 0.0364, 0.9993], [-0.9993, 0.0371, 0.0102], [-0.0367, -0.9986, 0.0368]]))
REFERENCE_CAMERA = CameraCalibration(
    width=640,
    height=480,
    fx=1083.4,
    fy=1076.4,
    cx=335.0879,
    cy=257.0793,
    model="radtan",
    distortion=(-0.4373, 0.2476, 0.0, 0.0),
    T_body_cam=tuple(se3(_R_BODY_CAM, np.array([0.1903, 0.0396, 0.006])).ravel().tolist()),
    time_shift_s=-0.04175,
    line_delay_s=30e-6,  # the Pi camera reads its rows in about 15 ms per frame
    rate_hz=30.0,
)


def has_borrowed_mounting(camera: CameraCalibration) -> bool:
    """Whether where a camera sits and when it sees are still the reference robot's, though its lens is its own.

    No measurement agrees with that robot's to the last digit.
    """

    def placed(c: CameraCalibration) -> tuple[object, ...]:
        return c.T_body_cam, c.time_shift_s

    def lens(c: CameraCalibration) -> tuple[object, ...]:
        return c.fx, c.fy, c.cx, c.cy, c.distortion

    return placed(camera) == placed(REFERENCE_CAMERA) and lens(camera) != lens(REFERENCE_CAMERA)


# ICM-20948 datasheet (DS-000189 v1.3): gyro 0.015 dps/sqrt(Hz), accel 230 ug/sqrt(Hz); walks are typical of its class.
REFERENCE_IMU = ImuNoise(
    gyro_density=math.radians(0.015),
    accel_density=230e-6 * 9.81,
    gyro_walk=2e-5,
    accel_walk=3e-4,
    rate_hz=225.0,
    gyro_range=math.radians(500.0),
    accel_range=4 * 9.81,
)
# The lens of a Pi camera in a bracket for two SG90 servos lies 3 cm before the axes.
REFERENCE_HEAD = HeadCalibration(pivot_body=(0.16, 0.0396, 0.006))
REFERENCE_ROBOT = Calibration(
    camera=REFERENCE_CAMERA, imu=REFERENCE_IMU, robot_kind="sentinel", rig="wheels", head=REFERENCE_HEAD
)
