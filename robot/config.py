"""All settings of robot-server, from one TOML file; command-line options override it. Unknown keys are refused.

The sections are frozen msgspec structs, not dataclasses: they check types, ranges and unknown keys by themselves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from shared.bounded import MAX_SETTINGS_BYTES, parse_toml, read_text
from shared.discovery import DEFAULT_PORT
from shared.errors import ConfigError
from shared.messages import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S, MAX_NAME_LENGTH
from shared.text import SEEN_WHOLE, explain, is_unseen

Positive = Annotated[float, Meta(gt=0)]
ShortText = Annotated[str, Meta(max_length=MAX_NAME_LENGTH, pattern=SEEN_WHOLE)]


Settings = TypeVar("Settings")


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the TOML file."""


class IdentityConfig(Section, frozen=True, kw_only=True):
    id: ShortText = ""  # empty: the host's name
    name: ShortText = ""  # for people; empty: the id, and "Simulated robot" for a simulated one without id

    def __post_init__(self) -> None:
        for text in (self.id, self.name):
            if text and is_unseen(text):
                raise ValueError("a name needs a character that is seen")


class ServerConfig(Section, frozen=True, kw_only=True):
    """Where stations connect, and how much is kept for them."""

    host: str = "127.0.0.1"  # beyond loopback only with access control (docs/access.md)
    port: Annotated[int, Meta(ge=0, le=65535)] = DEFAULT_PORT  # 0: any free port, printed at start
    max_stations: Annotated[int, Meta(ge=1, le=64)] = 8
    max_waiting: Annotated[int, Meta(ge=1, le=256)] = 32  # connections that have not joined yet; the oldest yields
    # 36 s at 225 Hz: a station that was away or stalled for less gets every sample.
    imu_backlog_samples: Annotated[int, Meta(ge=256, le=1_000_000)] = 8192
    imu_batch_interval_ms: Annotated[int, Meta(ge=0, le=100)] = 10  # one packet per sample would cost the Pi a core


class AccessConfig(Section, frozen=True, kw_only=True):
    """Who may connect (docs/access.md). On loopback without a folder: everybody on this machine."""

    folder: str = ""  # of key, certificate and tokens; empty: ~/.local/state/sentinel/robot-access beyond loopback
    insecure: bool = False  # no access control: whoever reaches the port can watch and drive


class DriveConfig(Section, frozen=True, kw_only=True):
    """What commands the motors get. Faster ones are refused."""

    max_linear_m_s: Annotated[float, Meta(gt=0, le=MAX_LINEAR_M_S)] = 0.5
    max_angular_rad_s: Annotated[float, Meta(gt=0, le=MAX_ANGULAR_RAD_S)] = 2.5


class SimulatedConfig(Section, frozen=True, kw_only=True):
    world: str = "home"
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 1
    # emulated: IMU and motors go through the real firmware in an emulated Mega (docs/firmware.md)
    imu: Literal["simulated", "emulated"] = "simulated"
    settings: str = (
        ""  # TOML file of imperfections, faults and build errors (docs/simulator.md), as robot-sim's --config
    )
    sim_port: Annotated[int, Meta(ge=0, le=65535)] | None = None  # where tests and the demo ask for the truth


class RecordedConfig(Section, frozen=True, kw_only=True):
    """The recording that is played instead of a robot."""

    dataset: str = ""
    speed: Annotated[float, Meta(gt=0, le=100)] = 1.0
    at_end: Literal["stop", "loop"] = "stop"  # loop: again, with times that go on


class CalibrationConfig(Section, frozen=True, kw_only=True):
    """Where the robot keeps the calibration that a station gives it (docs/robot.md)."""

    # Of calibration.yaml; empty: ~/.local/state/sentinel/robot-calibration on a Pi, else only memory.
    folder: str = ""


class PiConfig(Section, frozen=True, kw_only=True):
    """Parts and wiring of the real robot (docs/robot.md)."""

    serial_port: str = "/dev/sentinel-mega"  # the Arduino Mega; robot/install.sh gives it this name
    camera: bool = True
    imu: bool = True
    motors: Literal["mega", "gpio", "none"] = "mega"  # where the DRV8833 is wired to
    pan_tilt: Literal["mega", "gpio", "none"] = "mega"
    battery: Literal["mega", "ina219", "none"] = "mega"
    # What measures how far things are: an HC-SR04 on the Mega, or an OAK-D on USB. Both look straight ahead.
    depth: Literal["hc-sr04", "oak-d", "none"] = "none"
    depth_position_m: tuple[float, float, float] = (0.2, 0.0, 0.0)  # of its face from the IMU: forward, left, up
    depth_pitch_deg: Annotated[float, Meta(ge=-60, le=60)] = 0.0  # by how much an OAK-D looks up
    # Folder with this robot's camera.yaml, imu.yaml, while no calibration.yaml is kept; empty: the reference robot's.
    calibration: str = ""

    width: Annotated[int, Meta(ge=64, le=4096)] = 640
    height: Annotated[int, Meta(ge=64, le=4096)] = 480
    rate_hz: Annotated[float, Meta(ge=1, le=120)] = 30.0
    jpeg_quality: Annotated[int, Meta(ge=10, le=100)] = 80
    max_exposure_ms: Annotated[float, Meta(ge=0.1, le=100)] = 10.0  # at 1 rad/s a pixel then smears over 11 px at most
    max_gain: Annotated[float, Meta(ge=1, le=64)] = 8.0

    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 500
    accel_range_g: Literal[2, 4, 8, 16] = 4

    full_speed_m_s: Positive = 0.6  # one side at full duty
    track_m: Positive = 0.25  # effective: skid-steering slips
    deadband: Annotated[float, Meta(ge=0, lt=0.9)] = 0.15
    invert_left: bool = False
    invert_right: bool = False
    slow_decay: bool = True
    ramp_ms: Annotated[int, Meta(ge=4, le=1000)] = 250  # from rest to full duty

    battery_empty_v: Positive = 6.4  # two lithium cells; the Mega holds the motors off below
    battery_full_v: Positive = 8.4
    ina219_bus: Annotated[int, Meta(ge=0, le=20)] = 1
    ina219_address: Annotated[int, Meta(ge=0x40, le=0x4F)] = 0x40
    # BCM numbers: left IN1 IN2, right IN1 IN2, pan, tilt
    gpio_pins: tuple[int, int, int, int, int, int] = (17, 27, 23, 24, 12, 13)


class RobotConfig(Section, frozen=True, kw_only=True):
    identity: IdentityConfig = IdentityConfig()
    server: ServerConfig = ServerConfig()
    access: AccessConfig = AccessConfig()
    drive: DriveConfig = DriveConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    simulated: SimulatedConfig = SimulatedConfig()
    recorded: RecordedConfig = RecordedConfig()
    pi: PiConfig = PiConfig()


def load_config(path: Path | None, overrides: dict[str, dict[str, Any]]) -> RobotConfig:
    """Read the file (none: defaults) and lay the command line's values over it.

    Args:
        path: TOML file.
        overrides: section → key → value; None means not given.
    Raises:
        ConfigError: names the file, the key and what is allowed.
    """
    content = {} if path is None else read_toml(path)
    convert(content, RobotConfig, str(path))  # the file must be right by itself: its mistakes are reported in its name
    for section, values in overrides.items():
        given = {key: value for key, value in values.items() if value is not None}
        if given:
            content[section] = {**content.get(section, {}), **given}
    return convert(content, RobotConfig, "the command line")


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file's content. Raises ConfigError."""
    try:
        return parse_toml(read_text(path, MAX_SETTINGS_BYTES))
    except OSError as exc:
        raise ConfigError(f"{path} cannot be read ({exc.strerror}); give an existing TOML file to --config") from exc
    except ValueError as exc:
        raise ConfigError(f"{path} is not valid TOML: {exc}") from exc


def convert(content: dict[str, Any], kind: type[Settings], source: str) -> Settings:
    """Settings of a kind from plain values. Raises ConfigError that names the source, the key and what is allowed."""
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as exc:
        # msgspec says `... - at `$.server.port``; people know keys without the `$.`.
        raise ConfigError(f"{source}: {explain(exc)}".replace("$.", "")) from exc
