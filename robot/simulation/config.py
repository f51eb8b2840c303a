"""Every imperfection and fault of the simulated robot is a parameter here and can be switched off."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shared.errors import ConfigError


@dataclass(frozen=True, slots=True)
class CameraImperfections:
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


@dataclass(frozen=True, slots=True)
class ImuImperfections:
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


@dataclass(frozen=True, slots=True)
class BodyParameters:
    """The skid-steer platform."""

    radius_m: float = 0.21  # around the IMU; the camera's front is inside
    imu_height_m: float = 0.25
    max_linear_m_s: float = 0.6
    max_angular_rad_s: float = 3.0
    lag_s: float = 0.08  # of the critically damped motor response
    slip: bool = True
    yaw_efficiency: float = 0.33  # achieved / commanded yaw rate; 2.0 rad/s commanded gave 0.43-0.84 on a real one
    yaw_efficiency_spread: float = 0.07  # between drives and along a drive
    linear_efficiency: float = 0.96
    icr_offset_m: float = 0.02  # the turning centre lies this far behind the IMU
    wobble: bool = True  # roll, pitch and heave from an uneven floor
    wobble_deg: float = 0.25
    heave_mm: float = 0.4


@dataclass(frozen=True, slots=True)
class Faults:
    """Things that go wrong; can be changed while the robot runs."""

    covered_lens: bool = False
    light: float = 1.0  # brightness of all lamps
    person: bool = False  # somebody walks through the picture
    frozen_camera: bool = False
    imu_dropout: float = 0.0  # share of IMU samples that never arrive


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """Everything about a simulated robot except the world it lives in."""

    camera: CameraImperfections = field(default_factory=CameraImperfections)
    imu: ImuImperfections = field(default_factory=ImuImperfections)
    body: BodyParameters = field(default_factory=BodyParameters)
    faults: Faults = field(default_factory=Faults)
    lookalike_rooms: bool = False
    moved_chairs_seed: int | None = None
    light_seed: int | None = None
    camera_rate_hz: float = 20.0


def without_imperfections(config: SimulationConfig | None = None) -> SimulationConfig:
    """The same robot with ideal sensors on an even floor; wheels still lag and walls still stop it."""
    config = config or SimulationConfig()
    return dataclasses.replace(
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
        body=dataclasses.replace(config.body, slip=False, wobble=False),
    )


def load_config(path: Path) -> SimulationConfig:
    """Read a TOML file whose tables are the field names; unknown keys are refused."""
    try:
        table = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as exc:
        raise ConfigError(f"{path} is not a readable TOML file: {exc}") from exc
    return config_from_table(SimulationConfig(), table, "")


def config_from_table(default: Any, table: dict[str, Any], prefix: str) -> Any:
    """A copy of a configuration dataclass with the table's values. Raises ConfigError that names the key."""
    changes: dict[str, Any] = {}
    names = {f.name for f in dataclasses.fields(default)}
    for key, value in table.items():
        if key not in names:
            raise ConfigError(f"unknown key {prefix}{key}; known here: {', '.join(sorted(names))}")
        current = getattr(default, key)
        if dataclasses.is_dataclass(current):
            if not isinstance(value, dict):
                raise ConfigError(f"{prefix}{key} must be a table")
            changes[key] = config_from_table(current, value, f"{prefix}{key}.")
        elif current is None:
            if not isinstance(value, int) or isinstance(value, bool):
                raise ConfigError(f"{prefix}{key} is {value!r}, must be a whole number")
            changes[key] = value
        else:
            is_number = isinstance(current, float) and isinstance(value, int) and not isinstance(value, bool)
            if type(value) is not type(current) and not is_number:
                raise ConfigError(f"{prefix}{key} is {value!r}, must be of type {type(current).__name__}")
            changes[key] = type(current)(value)
    return dataclasses.replace(default, **changes)
