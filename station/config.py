"""Settings of a running station: frozen, defaults for a desk; a TOML file and command-line options override them."""

from __future__ import annotations

import dataclasses
import importlib
import ipaddress
import os
import re
import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from shared.bounded import MAX_SETTINGS_BYTES, parse_toml, read_text, shortened, shown
from shared.calibration import Calibration
from shared.discovery import DEFAULT_PORT
from shared.errors import ConfigError
from shared.listening import show_address
from shared.messages import MAX_DRIVE_TTL_MS, MAX_NAME_LENGTH
from shared.text import explain, is_printable

DEFAULT_DATA_DIR = Path("station-data")
MAX_ROBOTS = 64  # each has two worker processes
MAX_ACTIVE_MAPS = 8  # every picture is looked for in each of them, and their indexes are kept
BACKENDS = ("sfm", "ukf", "mono", "smoothing")
AUTO = "auto"  # what suits the robot
DASK, PROCESSES = "dask://", "processes"
MAX_FILE_NAME_BYTES, MAX_PATH_BYTES = 255, 4095  # of Linux; other systems have the same or a little less
NAME_RULE = "a robot's name has 1 to 40 letters, digits, - and _, and begins with a letter"
# Letters of any alphabet: names in DNS may have them.
_ADDRESS = re.compile(r"(?:\[(?P<v6>[^\[\]]+)\]|(?P<host>[^\s:\[\]]+))(?::(?P<port>[0-9]{1,5}))?")
_ROBOT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,39}")


def _check_range(key: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise ConfigError(f"{key} = {shown(value)} is outside {least}..{most}")


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """Where the robot-server listens, and what this station calls the robot."""

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    name: str = ""  # in addresses: /robots/NAME/place/current; without one robot-1, robot-2, ...


@dataclass(frozen=True, slots=True)
class ApiConfig:
    """Where the API and the page are served. Loopback only, unless a person decides otherwise."""

    host: str = "127.0.0.1"
    port: int = 8080
    allowed_hosts: tuple[str, ...] = ()  # further names that this station is called by, such as "robots.local"


@dataclass(frozen=True, slots=True)
class AccessConfig:
    """Who may ask (docs/access.md). On loopback: everybody on this machine."""

    on_loopback: bool = False  # tokens and TLS there too, for a machine with several users or behind a proxy
    insecure: bool = False  # no access control, and robots without TLS: whoever reaches the port can watch and drive


@dataclass(frozen=True, slots=True)
class DriveConfig:
    """Who may drive, and for how long without a word."""

    lease_s: float = 1.0  # a driver silent for longer has let go of the wheel
    repeat_ms: int = 100  # a command with a longer life than the protocol's is repeated to the robot this often

    def __post_init__(self) -> None:
        _check_range("drive.lease_s", self.lease_s, 0.2, 30)
        _check_range("drive.repeat_ms", self.repeat_ms, 20, MAX_DRIVE_TTL_MS - 1)


@dataclass(frozen=True, slots=True)
class SlamConfig:
    """The backend that follows a navigation while it is recorded."""

    backend: str = "auto"  # ukf for a calibrated robot on wheels with an IMU, else sfm
    seed: int = 1
    frame_backlog: int = 900  # frames that wait for a busy worker (60 MB); then the oldest is skipped, and counted
    live_frame_backlog: int = 20  # the same for backends that answer with a pose: that pose should be of now
    # A busy worker skips pictures that waited longer, at any frame rate: long before inertial samples would be lost.
    frame_wait_s: float = 30.0
    live_frame_wait_s: float = 5.0
    imu_backlog: int = 30_000  # batches, two minutes if each is one sample; then the oldest is lost and announced


@dataclass(frozen=True, slots=True)
class LocalizationConfig:
    """How often the running picture is looked for in the active maps."""

    rate_hz: float = 4.0

    def __post_init__(self) -> None:
        _check_range("localization.rate_hz", self.rate_hz, 0.1, 30)


@dataclass(frozen=True, slots=True)
class RecordingConfig:
    """How much of the disk recordings may take. 0: no limit; then only the free space ends a recording."""

    max_gb: float = 0.0  # beyond, the oldest recordings of finished navigations go; what SLAM made of them stays
    max_days: float = 0.0  # older ones go
    keep_free_mb: int = 256  # the disk also holds the maps

    def __post_init__(self) -> None:
        for name in ("max_gb", "max_days", "keep_free_mb"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"recordings.{name} = {shown(getattr(self, name))} must not be below 0")


@dataclass(frozen=True, slots=True)
class StoreConfig:
    """Where maps are kept; by default in the data folder."""

    database: str = ""  # postgresql://user:password@host/name; stations may share one
    blobs: str = ""  # a URL that fsspec knows, such as s3://bucket/maps; stations that share a database share this too

    def __post_init__(self) -> None:
        kind, _, place = self.database.partition("://")
        if kind.partition("+")[0] != "sqlite":
            return
        file = place.partition("?")[0].removeprefix("/")
        if why := "it names no file" if file in ("", ":memory:") else why_no_path(file):
            raise ConfigError(
                f"store.database = {shown(self.database)} cannot be used ({why});"
                " give SQLite's file by its path, as in sqlite:////var/lib/sentinel/maps.db"
            )


@dataclass(frozen=True, slots=True)
class StationConfig:
    """Everything. Each part of the station gets only its own piece."""

    data_dir: Path = DEFAULT_DATA_DIR
    name: str = "station"
    executor: str = ""  # where jobs compute: dask://HOST:PORT of a scheduler; without it in a process here each
    robot: RobotConfig = field(default_factory=RobotConfig)
    robots: tuple[RobotConfig, ...] = ()  # several, instead of `robot`: [[robots]] in the file
    api: ApiConfig = field(default_factory=ApiConfig)
    access: AccessConfig = field(default_factory=AccessConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)
    slam: SlamConfig = field(default_factory=SlamConfig)
    localization: LocalizationConfig = field(default_factory=LocalizationConfig)
    store: StoreConfig = field(default_factory=StoreConfig)
    recordings: RecordingConfig = field(default_factory=RecordingConfig)

    def __post_init__(self) -> None:
        _check_range("robot.port", self.robot.port, 1, 65535)
        _check_range("api.port", self.api.port, 0, 65535)
        for number, robot in enumerate(self.robots):
            _check_range(f"robots[{number}].port", robot.port, 1, 65535)
        if not 0 < len(self.name) <= MAX_NAME_LENGTH or not is_printable(self.name):  # robots would refuse it
            raise ConfigError(
                f"name = {shown(self.name)} must have 1 to {MAX_NAME_LENGTH} characters that can be shown"
            )
        _check_fleet(self.fleet)
        check_executor(self.executor)

    @property
    def fleet(self) -> tuple[RobotConfig, ...]:
        """The robots, each with a name. The first one is meant where none is named."""
        return tuple(
            dataclasses.replace(robot, name=robot.name or f"robot-{number}")
            for number, robot in enumerate(self.robots or (self.robot,), start=1)
        )


def load_config(path: Path | None) -> StationConfig:
    """The settings of a TOML file, checked; the defaults without one. Raises ConfigError naming file and key."""
    if path is None:
        return StationConfig()
    try:
        content = parse_toml(read_text(path, MAX_SETTINGS_BYTES))
    except (OSError, UnicodeDecodeError) as exc:
        raise ConfigError(f"{path} cannot be read ({explain(exc)}); give a TOML file") from exc
    except ValueError as exc:
        raise ConfigError(f"{path} is no TOML ({explain(exc)}); correct that line") from exc
    _refuse_unknown(content, StationConfig, path, "")
    try:
        return msgspec.convert(content, StationConfig, dec_hook=_decode)
    except msgspec.ValidationError as exc:
        raise ConfigError(f"{path}: {explain(exc)}") from exc


def parse_robot(text: str, option: str) -> RobotConfig:
    """`HOST:PORT` or `NAME=HOST:PORT`. Raises ConfigError naming the option."""
    name, equals, address = text.rpartition("=")
    if equals and not _ROBOT_NAME.fullmatch(name):
        raise ConfigError(f"{option} {shown(text)}: {NAME_RULE}, for example lab=192.168.1.20:{DEFAULT_PORT}")
    return RobotConfig(*parse_address(address, option), name=name)


def parse_address(text: str, option: str) -> tuple[str, int]:
    """`HOST:PORT`, `[V6]:PORT` or only a host; V6 without a port also bare. Raises ConfigError naming the option."""
    if _is_v6(text):
        return text, DEFAULT_PORT
    found = _ADDRESS.fullmatch(text)
    if found is not None and is_printable(text) and (found["host"] or _is_v6(found["v6"])):
        port = int(found["port"] or DEFAULT_PORT)
        if 1 <= port <= 65535:
            return found["host"] or found["v6"], port
    raise ConfigError(f"{option} {shown(text)} is no HOST:PORT, for example 192.168.1.20:{DEFAULT_PORT}")


def _is_v6(text: str) -> bool:
    try:
        ipaddress.IPv6Address(text)
    except ValueError:
        return False
    return is_printable(text)  # its zone may be anything


def _check_fleet(fleet: tuple[RobotConfig, ...]) -> None:
    if len(fleet) > MAX_ROBOTS:
        raise ConfigError(f"{len(fleet)} robots are given, one station serves {MAX_ROBOTS}; start another station")
    for robot in fleet:
        if not _ROBOT_NAME.fullmatch(robot.name):
            raise ConfigError(f"robots: {shown(robot.name)} is no name; {NAME_RULE}")
    if len(fleet) > 1 and any(robot.host == "auto" for robot in fleet):
        raise ConfigError("robots: auto looks for the only robot in the network; give the HOST:PORT of each of several")
    for what in ([robot.name for robot in fleet], [show_address(robot.host, robot.port) for robot in fleet]):
        if (twice := next((one for one in what if what.count(one) > 1), None)) is not None:
            raise ConfigError(f"robots: {shortened(twice)} is given twice; give each robot its own name and address")


def _refuse_unknown(content: dict[str, Any], kind: type[Any], path: Path, prefix: str) -> None:
    known = {f.name: f for f in dataclasses.fields(kind)}
    for key, value in content.items():
        if key not in known:
            raise ConfigError(f"{path}: unknown key {prefix}{shortened(key)}; known are {', '.join(known)}")
        default: Any = known[key].default_factory
        if isinstance(value, dict) and isinstance(default, type) and dataclasses.is_dataclass(default):
            _refuse_unknown(value, default, path, f"{prefix}{key}.")
        elif kind is StationConfig and key == "robots" and isinstance(value, list):
            for number, robot in enumerate(value):
                _refuse_unknown(robot if isinstance(robot, dict) else {}, RobotConfig, path, f"robots[{number}].")


def _decode(kind: type[Any], value: Any) -> Any:
    """Raises ValueError, to which msgspec adds the key."""
    if kind is not Path:
        raise NotImplementedError  # as msgspec asks of a hook that does not know a type
    if not isinstance(value, str):
        raise ValueError(f"Expected `str`, got `{type(value).__name__}`")
    if why := why_no_path(value):
        raise ValueError(f"{shown(value)} is no folder's name ({why})")
    try:
        return Path(value).expanduser()
    except RuntimeError as exc:  # ~somebody
        raise ValueError(f"{shown(value)} is no folder's name (nobody here has this home)") from exc


def why_no_path(text: str) -> str:
    """Why no file can have this name; empty: one can."""
    if not text:
        return "it is empty"
    if "\0" in text:
        return "it has a NUL character"
    whole = os.fsencode(text)
    if len(whole) > MAX_PATH_BYTES or max(map(len, whole.split(b"/"))) > MAX_FILE_NAME_BYTES:
        return "it is too long"
    return ""


def check_folder(folder: Path, setting: str) -> Path:
    """The folder, where it is one or may become one. Raises ConfigError naming the setting."""
    why = ""
    try:
        if not stat.S_ISDIR(folder.stat().st_mode):
            why = "a file has this name"
    except (FileNotFoundError, PermissionError):  # it is made when it is needed; who may not is told then
        pass
    except (OSError, ValueError) as exc:
        why = getattr(exc, "strerror", None) or str(exc)
    if why:
        raise ConfigError(f"{setting} = {shown(str(folder))} is no folder ({why}); name another one")
    return folder


def check_executor(address: str) -> None:
    """Raises ConfigError when it is no address of an executor."""
    host, colon, port = address.removeprefix(DASK).rpartition(":")
    if address in ("", PROCESSES) or (address.startswith(DASK) and colon and host and port.isdecimal()):
        return
    raise ConfigError(f"executor {shown(address)} is none; give {PROCESSES} or dask://HOST:PORT of a Dask scheduler")


def choose_backend(name: str, calibration: Calibration) -> str:
    """The backend that is meant: "auto" is ukf for a robot on wheels with an IMU and a camera that was measured.

    Any other is followed by sfm, which needs images only; the filter believes the camera's numbers.
    """
    if name != AUTO:
        return name
    return "ukf" if can_filter(calibration) and calibration.has_wheels else "sfm"


def follows_head(name: str, calibration: Calibration) -> bool:
    """Whether that backend knows where a pan-tilt head has the camera: of a head whose pivot was measured."""
    return choose_backend(name, calibration) == "ukf" and calibration.head is not None


def can_filter(calibration: Calibration) -> bool:
    """Whether there is all that ukf needs: an IMU, and a camera that was measured."""
    return calibration.imu is not None and calibration.camera is not None and calibration.camera.is_measured


def check_backend(name: str) -> None:
    """Whether there is such a backend: one of BACKENDS, "auto" or "package.module:factory". Raises ConfigError."""
    if name not in (*BACKENDS, AUTO):
        load_factory(name)


def load_factory(name: str) -> Callable[[Calibration], Any]:
    """What makes the backend "package.module:factory". Raises ConfigError."""
    choices = ", ".join((AUTO, *BACKENDS))
    module, colon, factory = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), factory, None) if colon else None
    except (ImportError, ValueError) as exc:
        raise ConfigError(f"backend {shown(name)} cannot be loaded ({explain(exc)}); choose one of {choices}") from exc
    if not callable(found):
        raise ConfigError(f"backend {shown(name)} is unknown; choose one of {choices}")
    make: Callable[[Calibration], Any] = found
    return make
