"""Which kind of dataset a path is."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

from shared.errors import DataError
from shared.recorded_files import VIDEO_SUFFIXES, check_readable
from station.datasets.asl import open_asl
from station.datasets.dataset import Dataset
from station.datasets.image_folder import open_image_folder
from station.datasets.video import open_video

Opener = Callable[[Path, int | None, int | None, int], Dataset]


def open_dataset(path: str | Path, first: int | None = None, last: int | None = None, step: int = 1) -> Dataset:
    """Open a recorded navigation: ASL/EuRoC folder, folder of images, video file or MCAP recording.

    Args:
        path: folder or file.
        first, last: numbers of the first and last frame to use (both included): the number in the file name
            for a folder of images (`frame-000398.color.jpg` is 398), the position from 0 otherwise.
        step: use every step-th of these frames. Inertial samples are cut to the range, never thinned.
    Raises:
        DataError: the path, or a file in it, cannot be used; says which and what to do.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path} does not exist; give the folder or file of a recorded navigation")
    if not path.is_dir():
        return _open_file(path, first, last, step)
    if path.name == "mav0" and not (path / "mav0").is_dir():
        path = path.parent if path.parent != path else path
    if (path / "mav0").is_dir():
        return open_asl(path, first, last, step)
    return open_image_folder(path, first, last, step)


def _open_file(path: Path, first: int | None, last: int | None, step: int) -> Dataset:
    check_readable(path)
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        # Imported here: a recorder's libraries are needed only for recordings.
        opener: Opener = importlib.import_module("station.datasets.mcap").open_mcap
        return opener(path, first, last, step)
    if suffix in VIDEO_SUFFIXES:
        return open_video(path, first, last, step)
    raise DataError(
        f"{path} is no dataset; give a folder, an .mcap recording or a video ({', '.join(sorted(VIDEO_SUFFIXES))})"
    )
