"""The calibration that a robot tells: what its devices came with, until a station gives it a measured one."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import msgspec

from robot.config import RobotConfig
from shared.calibration import Calibration, CameraCalibration
from shared.calibration_yaml import calibration_text, read_calibration, read_previous
from shared.disk import make_folder, remove_scratch, replace_file
from shared.errors import ConfigError, DataError
from shared.messages import CalibrationOrigin

logger = logging.getLogger(__name__)

FILE = "calibration.yaml"
NOT_MEASURED = "another robot's numbers, for want of its own"
CAME_WITH = "what its devices came with"
FROM_FILE = f"its {FILE}"
IN_MEMORY = "given by a station, until robot-server ends (set calibration.folder to keep it)"
REMEDY = "set calibration.folder to a folder that robot-server may write"


def calibration_folder(kind: str, config: RobotConfig) -> Path | None:
    """Where the robot keeps its calibration; None: only in memory, as a simulated robot without settings does."""
    if config.calibration.folder:
        return Path(config.calibration.folder).expanduser()
    return Path.home() / ".local" / "state" / "sentinel" / "robot-calibration" if kind == "pi" else None


def read_own(folder: Path | None) -> Calibration | None:
    """The calibration that a station gave; None: none yet. Raises DataError, which names the file."""
    if folder is None or not (folder / FILE).is_file():
        return None
    return read_calibration(folder / FILE)


class OwnCalibration:
    """What the robot tells now, and the one before it. One file keeps both, and is written whole or not at all."""

    def __init__(self, folder: Path | None, came_with: Calibration) -> None:
        """Raises DataError or ConfigError: the folder's calibration cannot be read or is not of this robot."""
        self._folder = folder
        self._came_with = came_with
        self._previous: Calibration | None = None
        self._is_given = False
        self.current = came_with
        if folder is not None:
            remove_scratch(folder)
        if folder is not None and (own := read_own(folder)) is not None:
            self._check(own, f"{folder / FILE}: ")
            self.current, self._is_given = self._as_built(own), True
            self._previous = self._read_previous(folder / FILE)

    @property
    def origin(self) -> CalibrationOrigin:
        """Where it comes from, and what can be done about it."""
        return CalibrationOrigin(source=self._source, can_undo=self._previous is not None, fixed=self._why_fixed())

    def use(self, calibration: Calibration) -> None:
        """Tell this from now on; the present one is kept. Touches the disk.

        Raises:
            ConfigError: it is not of this robot, or its folder cannot be written. Nothing has changed then.
        """
        self._check(calibration)
        self._check_what_nobody_measures(calibration)
        self._replace(calibration)

    def undo(self) -> None:
        """Tell the one before it again; undone twice is done. Raises ConfigError as `use`, or where none is kept."""
        if self._previous is None:
            raise ConfigError("no earlier calibration is kept; there is nothing to undo")
        self._check(self._previous)
        self._replace(self._previous)

    def _replace(self, calibration: Calibration) -> None:
        before = self.current
        if self._folder is not None:
            # What is told is what the file says: a restart must not change it by a rounding.
            calibration = _stored(self._folder, before, calibration)
        self.current, self._previous, self._is_given = self._as_built(calibration), before, True

    def _read_previous(self, path: Path) -> Calibration | None:
        """None as well where it cannot be used: what is told now is whole, and a robot without undo still drives."""
        try:
            if (previous := read_previous(path)) is not None:
                self._check(previous, f"{path}: ")
        except (ConfigError, DataError) as exc:
            logger.warning("the calibration before the present one cannot be used, so there is no undo: %s", exc)
            return None
        return None if previous is None else self._as_built(previous)

    def _as_built(self, calibration: Calibration) -> Calibration:
        """Head and depth sensor are as they were built: nobody measures them, the file leaves them out."""
        return msgspec.structs.replace(calibration, head=self._came_with.head, depth=self._came_with.depth)

    @property
    def _source(self) -> str:
        if self._is_given:
            return FROM_FILE if self._folder is not None else IN_MEMORY
        camera = self.current.camera
        return CAME_WITH if camera is None or camera.is_measured else NOT_MEASURED

    def _why_fixed(self) -> str:
        if self._folder is None:
            return ""
        there = self._folder
        while not there.exists() and there != there.parent:
            there = there.parent
        if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
            return ""
        return f"the robot cannot write into {self._folder}; {REMEDY}"

    def _check(self, calibration: Calibration, where: str = "") -> None:
        """Raises ConfigError: its numbers cannot be this robot's."""
        ours, given = self._came_with, calibration
        for part in ("camera", "imu"):
            if (getattr(ours, part) is None) != (getattr(given, part) is None):
                had, has = ("no", "one") if getattr(ours, part) is None else ("one", "none")
                raise ConfigError(f"{where}the robot has {had} {part}, the calibration {has}")
        if ours.camera is not None and given.camera is not None:
            _check_camera(ours.camera, given.camera, where)
        if given.robot_kind != ours.robot_kind:
            raise ConfigError(f"{where}it is of a {given.robot_kind!r} robot, this one is {ours.robot_kind!r}")

    def _check_what_nobody_measures(self, given: Calibration) -> None:
        """Raises ConfigError: an order changes how the robot was built."""
        if given.rig != self.current.rig:
            raise ConfigError(f"the robot's rig is {self.current.rig!r}, no calibration makes it {given.rig!r}")
        if _ranges(given) != _ranges(self.current):
            raise ConfigError("the ranges of the robot's IMU are its settings; no calibration changes them")


def _ranges(calibration: Calibration) -> tuple[float, float] | None:
    return None if calibration.imu is None else (calibration.imu.gyro_range, calibration.imu.accel_range)


def _check_camera(ours: CameraCalibration, given: CameraCalibration, where: str) -> None:
    size = (given.width, given.height)
    if size != (ours.width, ours.height):
        raise ConfigError(
            f"{where}it is of pictures of {size[0]}x{size[1]}, the camera's have {ours.width}x{ours.height};"
            " calibrate at that size"
        )
    if not (0 <= given.cx < given.width and 0 <= given.cy < given.height):
        raise ConfigError(f"{where}the principal point ({given.cx:g}, {given.cy:g}) px is outside the picture")


def _stored(folder: Path, before: Calibration, calibration: Calibration) -> Calibration:
    """Write both, at once; returns the new one as it will be read at the next start. Raises ConfigError."""
    try:
        make_folder(folder)
        replace_file(folder / FILE, calibration_text(calibration, before).encode())
        return read_calibration(folder / FILE)
    except OSError as exc:
        raise ConfigError(f"the robot cannot write {folder / FILE} ({exc.strerror}); {REMEDY}") from exc


def summary(calibration: Calibration) -> str:
    """One line for the log."""
    camera = calibration.camera
    if camera is None:
        return "no camera"
    return f"focal length {camera.fx:.1f}, {camera.fy:.1f} px, time shift {1e3 * camera.time_shift_s:.2f} ms"
