"""Every imperfection and fault of the simulated robot is a parameter here and can be switched off."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robot.config import Section, convert, read_toml


class CameraImperfections(Section, frozen=True, kw_only=True):
    """What a small camera does to an ideal image."""

    rolling_shutter: bool = True  # rows are exposed one after the other (CameraCalibration.line_delay_s)
    motion_blur: bool = True
    auto_exposure: bool = True
    exposure_ms: float = 6.0  # of the normally lit flat; auto-exposure moves it
    max_exposure_ms: float = 14.0
    lens_blur_px: float = 0.55  # standard deviation of the lens' and sensor's point spread
    vignetting: float = 0.3  # share of light lost in the corners
    noise: float = 1.5  # grey levels of read noise at gain 1; shot noise is added in proportion; 0 switches both off
    jpeg_quality: int = 90


class ImuImperfections(Section, frozen=True, kw_only=True):
    """What a MEMS IMU does to true rates and forces; densities and ranges are in the calibration."""

    noise: bool = True
    bias: bool = True  # constant at switch-on
    bias_walk: bool = True
    vibration: bool = True  # motors and gears shake the sensor while driving
    saturation: bool = True
    gyro_bias_rad_s: float = 0.015  # standard deviation of the switch-on bias
    accel_bias_m_s2: float = 0.12
    gyro_vibration_rad_s: float = 0.012  # rms at 0.4 m/s
    accel_vibration_m_s2: float = 0.3


class DepthSensorModel(Section, frozen=True, kw_only=True):
    """A depth sensor beside the camera, that sees what the camera sees. By default the robot has none."""

    rate_hz: Annotated[float, Meta(ge=0, le=30)] = 0.0  # 0: it has none
    # Across the camera's picture; 8: the zones of a VL53L5CX; 1: as an HC-SR04, the nearest thing in all of it
    columns: Annotated[int, Meta(ge=1, le=640)] = 64
    noise: Annotated[float, Meta(ge=0, lt=1)] = 0.01  # standard deviation, as a share of the distance
    max_m: Annotated[float, Meta(gt=0, le=60)] = 4.0  # beyond, nothing is measured


class BodyParameters(Section, frozen=True, kw_only=True):
    radius_m: float = 0.21  # around the IMU; the camera's front is inside
    imu_height_m: float = 0.25
    max_linear_m_s: float = 0.6
    max_angular_rad_s: float = 3.0
    lag_s: float = 0.08  # of the critically damped motor response
    slip: bool = True
    yaw_efficiency: float = 0.33  # achieved / commanded yaw rate; 2.0 rad/s commanded gave 0.43-0.84 on a real one
    yaw_efficiency_spread: float = 0.07  # between drives and along a drive
    yaw_waves: float = 0.08  # how much grip changes along the way, as a share: amplitude of each of two waves
    linear_efficiency: float = 0.96
    icr_offset_m: float = 0.02  # the turning centre lies this far behind the IMU
    wobble: bool = True  # roll, pitch and heave from an uneven floor
    wobble_deg: float = 0.25
    heave_mm: float = 0.4


class ServoImperfections(Section, frozen=True, kw_only=True):
    """What two hobby servos make of the angles they are told. Straight ahead, as it was mounted, they are right.

    With a seed they are the same servos in every drive, as those of one robot are; else each drive has its own.
    """

    seed: Annotated[int, Meta(ge=0)] | None = None
    delay_s: float = 0.02  # until the next pulse
    lag_s: float = 0.05
    error_deg: float = 3.0  # rms over +-60 degrees: the same at the same angle, it grows and wanders with it
    backlash_deg: float = 0.5  # an angle is reached from the left and from the right that far apart
    jitter_deg: float = 0.1  # rms


class BuildErrors(Section, frozen=True, kw_only=True):
    """How the robot's camera was built other than its calibration tells; what it tells stays as it is.

    With a seed it is another camera altogether: lens, mounting and shifts as `robot-sim calibration` draws them for
    that seed, and the other numbers come on top. Of its wheels it tells nothing: other ones are `BodyParameters`.
    """

    seed: Annotated[int, Meta(ge=0)] | None = None
    focal_percent: Annotated[float, Meta(gt=-50, lt=50)] = 0.0  # longer than told
    pitch_deg: float = 0.0  # mounting: turned about the camera's x axis, looking further up
    yaw_deg: float = 0.0  # mounting: turned about the camera's y axis, looking further to the right
    roll_deg: float = 0.0  # mounting: turned about the camera's z axis, so that the picture turns to the left
    forward_cm: float = 0.0  # mounting: shifted along the body's axes
    left_cm: float = 0.0
    up_cm: float = 0.0
    time_shift_ms: float = 0.0  # stamps come that much earlier than told
    line_delay_us: float = 0.0  # rows are read that much slower than told


class Faults(Section, frozen=True, kw_only=True):
    """Things that go wrong; can be changed while the robot runs."""

    covered_lens: bool = False
    light: Annotated[float, Meta(ge=0, le=10)] = 1.0  # brightness of all lamps
    person: bool = False  # somebody walks through the picture
    frozen_camera: bool = False
    imu_dropout: Annotated[float, Meta(ge=0, le=1)] = 0.0  # share of IMU samples that never arrive


class SimulationConfig(Section, frozen=True, kw_only=True):
    """Everything about a simulated robot except the world it lives in."""

    camera: CameraImperfections = CameraImperfections()
    imu: ImuImperfections = ImuImperfections()
    depth: DepthSensorModel = DepthSensorModel()
    body: BodyParameters = BodyParameters()
    servos: ServoImperfections = ServoImperfections()
    build: BuildErrors = BuildErrors()
    faults: Faults = Faults()
    lookalike_rooms: bool = False
    identical_twins: bool = False  # twin rooms have the same pictures, too: nothing within them tells them apart
    stickers: bool = False  # one in each room, with its name (docs/names.md)
    moved_chairs_seed: int | None = None
    light_seed: int | None = None
    walkers: Annotated[int, Meta(ge=0, le=4)] | None = None  # persons who walk about; None: those of the world's kind
    walkers_seed: int = 0  # other persons, other ways
    camera_rate_hz: float = 20.0


def without_imperfections(config: SimulationConfig | None = None) -> SimulationConfig:
    """The same robot with ideal sensors on an even floor; wheels still lag and walls still stop it."""
    config = config or SimulationConfig()
    return msgspec.structs.replace(
        config,
        camera=CameraImperfections(
            rolling_shutter=False,
            motion_blur=False,
            auto_exposure=False,
            lens_blur_px=0.0,
            vignetting=0.0,
            noise=0.0,
            jpeg_quality=95,
        ),
        imu=ImuImperfections(noise=False, bias=False, bias_walk=False, vibration=False, saturation=False),
        body=msgspec.structs.replace(config.body, slip=False, wobble=False),
        servos=ServoImperfections(
            seed=config.servos.seed, delay_s=0.0, lag_s=0.0, error_deg=0.0, backlash_deg=0.0, jitter_deg=0.0
        ),
    )


def load_config(path: Path) -> SimulationConfig:
    """Read a TOML file whose tables are the field names; unknown keys are refused."""
    return convert(read_toml(path), SimulationConfig, str(path))
