"""What a recorded drive's files say, for robot and station alike: ASL tables, and images named by time or number."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator
from io import TextIOWrapper
from itertools import pairwise
from pathlib import Path
from typing import TextIO

from shared.bounded import MAX_LINE_BYTES, Refused, open_file
from shared.errors import DataError

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png"}
VIDEO_SUFFIXES = {".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm"}
MAX_TIME_NS = 2**62  # 146 years: sums and differences of times stay within 64 bits
MAX_EXPOSURE_NS = 10**10
FIRST_STAMP = 10**15  # a number in an image's name from here on is a time in ns, as EuRoC writes it: 11 days and more


def check_readable(path: Path) -> None:
    """Before a library is given a recording's name: it would wait for a pipe. Raises DataError."""
    try:
        open_file(path).close()
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give the file or folder of a recorded drive") from exc


def asl_rows(path: Path, columns: int) -> Iterator[tuple[int, int, list[str]]]:
    """Line number, time in ns, and the further cells of every line of an ASL `data.csv`.

    Raises:
        DataError: a line has no time, or fewer than `columns` further cells, or is not later than the one before it.
    """
    last_ns = None
    try:
        with TextIOWrapper(open_file(path), encoding="utf-8", newline="") as file:
            for line_number, row in enumerate(csv.reader(_lines(file)), start=1):
                if not row or row[0].lstrip().startswith("#"):
                    continue
                t_ns = _time_ns(row[0], path, line_number)
                if len(row) <= columns:
                    raise DataError(f"{path} line {line_number} has {len(row)} columns, needs {columns + 1}")
                if last_ns is not None and t_ns <= last_ns:
                    raise DataError(
                        f"{path} line {line_number} is not later than the line before; sort the file by time"
                    )
                last_ns = t_ns
                yield line_number, t_ns, row[1:]
    except (OSError, UnicodeDecodeError, csv.Error) as exc:
        raise DataError(f"{path} cannot be read ({exc}); copy it again") from exc


def _lines(file: TextIO) -> Iterator[str]:
    while line := file.readline(MAX_LINE_BYTES):
        if len(line) == MAX_LINE_BYTES:
            raise Refused(f"a line of it has more than {MAX_LINE_BYTES} characters")
        yield line


def _time_ns(text: str, path: Path, line_number: int) -> int:
    try:
        t_ns = int(text)
    except ValueError as exc:
        raise DataError(f"{path} line {line_number} starts with no time in ns; correct it") from exc
    if abs(t_ns) > MAX_TIME_NS:
        raise DataError(f"{path} line {line_number} starts with {t_ns}, which is no time in ns; correct it")
    return t_ns


def asl_numbers(path: Path, columns: int) -> Iterator[tuple[int, list[float]]]:
    """Time in ns and `columns` numbers of every line of an ASL `data.csv`; raises DataError as asl_rows does."""
    for line_number, t_ns, cells in asl_rows(path, columns):
        try:
            numbers = [float(cell) for cell in cells[:columns]]
        except ValueError as exc:
            raise DataError(f"{path} line {line_number} does not hold numbers; correct or remove it") from exc
        if not all(map(math.isfinite, numbers)):
            raise DataError(f"{path} line {line_number} holds a number that is not finite; correct or remove it")
        yield t_ns, numbers


def exposures_ns(path: Path, cells: Iterable[tuple[int, list[str]]], default_ns: int) -> list[int]:
    """Exposure of every frame: the third column that robot-sim writes, else the camera's own `default_ns`.

    Args:
        path: the frame list, for messages.
        cells: line number, and the cells after the time.
    """
    found = []
    for line_number, row in cells:
        text = row[1].strip() if len(row) > 1 else ""
        try:
            exposure_ns = int(text) if text else default_ns
        except ValueError as exc:
            raise DataError(
                f"{path} line {line_number}: exposure {text!r} is no time in ns; correct or remove it"
            ) from exc
        if not 0 <= exposure_ns <= MAX_EXPOSURE_NS:
            raise DataError(
                f"{path} line {line_number}: exposure {exposure_ns} ns is no exposure of up to 10 s; correct it"
            )
        found.append(exposure_ns)
    return found


def images_in_order(folder: Path) -> list[tuple[int, Path]]:
    """A folder's images with the last number in each name, in its order; depth images are left out.

    Where names have no numbers of their own, their alphabetical order counts from 0.
    """
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and ".depth" not in p.name)
    found = [re.findall(r"\d+", p.name.split(".")[0], re.ASCII) for p in files]
    numbers = [int(digits[-1]) for digits in found if digits]
    if len(set(numbers)) < len(files):
        return list(enumerate(files))
    return sorted(zip(numbers, files, strict=True))


def depth_images(folder: Path) -> dict[int, Path]:
    """The depth pictures `*.depth.png` of a folder of images, by the number of the image that each was taken with."""
    found = {}
    for path in sorted(folder.glob("*.depth.png")):
        digits = re.findall(r"\d+", path.name.split(".")[0], re.ASCII)
        if digits:
            found[int(digits[-1])] = path
    return found


def image_times_ns(numbers: list[int], rate_hz: float, folder: Path) -> list[int]:
    """When images of these increasing numbers were taken: number / rate from 0 on, or the numbers if they are stamps.

    Raises:
        DataError: the numbers are neither.
    """
    is_stamps = bool(numbers) and numbers[0] >= FIRST_STAMP
    times = numbers if is_stamps else [round(number * 1e9 / rate_hz) for number in numbers]
    if times and (times[-1] > MAX_TIME_NS or any(b <= a for a, b in pairwise(times))):
        raise DataError(
            f"{folder}: the numbers in the images' names, {numbers[0]} to {numbers[-1]}, give no times at "
            f"{rate_hz:g} images a second; name the images by frame number or by time in ns"
        )
    return times
