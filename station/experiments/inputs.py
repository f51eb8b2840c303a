"""A recorded drive or a finished navigation → Navigation, and its truth where recorded."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shared.errors import ConfigError, DataError
from station.datasets import Dataset, Truth, open_dataset
from station.navigation import Navigation
from station.navigation_files import load_navigation

Reconstruct = Callable[[Dataset], Navigation]


@dataclass(frozen=True, slots=True)
class FrameRange:
    """Frames `first` to `last`, both included; by the number in the file name for a folder of images."""

    first: int | None = None
    last: int | None = None

    @classmethod
    def parse(cls, text: str | None, option: str) -> FrameRange:
        """`0-398`, `100-` or `-398`. Raises ConfigError naming the option."""
        if text is None:
            return cls()
        match = re.fullmatch(r"(\d*)-(\d*)", text.strip())
        if match is None or match.group() == "-":
            raise ConfigError(f'{option} is "{text}", must be two frame numbers such as 0-398')
        first, last = (int(number) if number else None for number in match.groups())
        if first is not None and last is not None and last < first:
            raise ConfigError(f'{option} is "{text}", its end lies before its start')
        return cls(first, last)


def is_navigation(path: Path) -> bool:
    """Whether a folder was written by `station slam`."""
    return (path / "navigation.json").is_file()


def load_input(
    path: Path, frames: FrameRange, truth_path: Path | None, reconstruct: Reconstruct, *, step: int = 1
) -> tuple[Navigation, Truth | None]:
    """The navigation of a dataset (reconstructed now) or of a navigation folder (as it is), with its truth.

    A navigation folder holds no truth: `truth_path` names the dataset it was made from.
    Raises:
        DataError: the path, or a file in it, cannot be used.
        ConfigError: a range of frames was given for a navigation that is finished.
    """
    if is_navigation(path):
        if frames != FrameRange():
            raise ConfigError(f"{path} is a finished navigation; frame ranges choose from a dataset's images")
        truth = open_dataset(truth_path).truth() if truth_path is not None else None
        return load_navigation(path), truth
    data = open_dataset(path, frames.first, frames.last, step)
    if not data.has_images:
        raise DataError(f"{path} holds no camera images; choose a dataset with images, or a finished navigation")
    truth = open_dataset(truth_path).truth() if truth_path is not None else data.truth()
    return reconstruct(data), truth
