"""Which kind of dataset a path is."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from shared.errors import DataError
from shared.recorded_files import VIDEO_SUFFIXES, check_readable
from station.datasets.asl import open_asl
from station.datasets.dataset import Dataset
from station.datasets.image_folder import open_image_folder
from station.datasets.video import open_video

MAX_ACCEL_M_S2 = 1000.0  # no IMU of such a rig measures more: a damaged sample, as one that is no number
MAX_TILT_DEG = 45.0  # no floor at home is as steep, and nobody mounts an IMU so askew who means its z axis to be up
Opener = Callable[[Path, int | None, int | None, int], Dataset]


def open_dataset(
    path: str | Path,
    first: int | None = None,
    last: int | None = None,
    step: int = 1,
    *,
    needs_camera: bool = True,
    needs_upright: bool = True,
) -> Dataset:
    """Open a recorded navigation: ASL/EuRoC folder, folder of images, video file or MCAP recording.

    Args:
        path: folder or file.
        first, last: numbers of the first and last frame to use (both included): the number in the file name
            for a folder of images (`frame-000398.color.jpg` is 398), the position from 0 otherwise.
        step: use every step-th of these frames. Inertial samples are cut to the range, never thinned.
        needs_camera: False: images whose camera no file describes are opened too, without a camera calibration.
        needs_upright: False: a rig on wheels may lie on its side, as when its IMU is calibrated.
    Raises:
        DataError: the path, or a file in it, cannot be used; says which and what to do.
    """
    data = _open(Path(path), first, last, step, needs_camera)
    if needs_upright:
        _check_axes(data)
    return data


def _open(path: Path, first: int | None, last: int | None, step: int, needs_camera: bool) -> Dataset:
    if not path.exists():
        raise DataError(f"{path} does not exist; give the folder or file of a recorded navigation")
    if not path.is_dir():
        return _open_file(path, first, last, step, needs_camera)
    if path.name == "mav0" and not (path / "mav0").is_dir():
        path = path.parent if path.parent != path else path
    if (path / "mav0").is_dir():
        return open_asl(path, first, last, step, needs_camera)
    return open_image_folder(path, first, last, step, needs_camera)


def _check_axes(data: Dataset) -> None:
    """Raise DataError for a rig on wheels whose IMU's z axis is certainly not up.

    Half of the samples say so: a hand that turned the robot over for a while does not.
    """
    if data.imu is None or not data.calibration.has_wheels:
        return
    accel = data.imu.accel_imu
    accel = accel[(np.abs(accel) < MAX_ACCEL_M_S2).all(axis=1)]
    if not len(accel):
        return
    up_imu = np.median(accel, axis=0)
    force = float(np.linalg.norm(up_imu))
    if abs(force / data.calibration.gravity - 1.0) > 0.5:
        return  # no gravity in it: samples that were made up, or cut at the sensor's range
    tilt_deg = math.degrees(math.acos(np.clip(up_imu[2] / force, -1.0, 1.0)))
    if tilt_deg > MAX_TILT_DEG:
        raise DataError(
            f"{data.path} is a rig on wheels, and its IMU's z axis is {tilt_deg:.0f} degrees from up; turn the IMU's "
            "axes in the data so that x points forward, y left and z up, or say `rig: hand-held` in cam0/sensor.yaml"
        )


def _open_file(path: Path, first: int | None, last: int | None, step: int, needs_camera: bool) -> Dataset:
    check_readable(path)
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        # Imported here: a recorder's libraries are needed only for recordings.
        opener: Opener = importlib.import_module("station.datasets.mcap").open_mcap
        return opener(path, first, last, step)
    if suffix in VIDEO_SUFFIXES:
        return open_video(path, first, last, step, needs_camera)
    raise DataError(
        f"{path} is no dataset; give a folder, an .mcap recording or a video ({', '.join(sorted(VIDEO_SUFFIXES))})"
    )
