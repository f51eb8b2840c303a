"""A dataset or a finished navigation → what an experiment starts from, with its truth where recorded."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from shared.errors import ConfigError, DataError
from station.datasets import Dataset, Truth, open_dataset
from station.files.navigation_folder import load_navigation
from station.model.navigation import Navigation


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


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """One navigation, opened and checked: a finished navigation, or a dataset still to be reconstructed."""

    path: Path
    source: Navigation | Dataset
    truth: Truth | None


def open_input(path: Path, frames: FrameRange, truth_path: Path | None, *, step: int = 1) -> Input:
    """A dataset or a navigation folder, with its truth; nothing is computed yet.

    A navigation folder holds no truth: `truth_path` names the dataset it was made from.
    Raises:
        DataError: the path, or a file in it, cannot be used.
        ConfigError: a range of frames was given for a navigation that is finished.
    """
    truth = open_truth(truth_path)
    if is_navigation(path):
        if frames != FrameRange():
            raise ConfigError(f"{path} is a finished navigation; frame ranges choose from a dataset's images")
        return Input(path, load_navigation(path), truth)
    data = open_dataset(path, frames.first, frames.last, step)
    if not data.has_images:
        raise DataError(f"{path} holds no camera images; choose a dataset with images, or a finished navigation")
    return Input(path, data, truth or data.truth)


def open_truth(path: Path | None) -> Truth | None:
    """The true poses of a dataset that was named for them. Raises DataError where it has none."""
    if path is None:
        return None
    truth = open_dataset(path).truth
    if truth is None:
        raise DataError(f"{path} holds no true poses; name a dataset that has them, or leave the option out")
    return truth
