"""A folder of results: written whole or not at all, in the place of an earlier run's."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Set
from contextlib import contextmanager
from pathlib import Path

from shared.disk import make_folder, replacing_folder
from shared.errors import DataError


def check_results_folder(folder: Path, names: Set[str]) -> None:
    """Whether results of these names may take the folder's place. Raises DataError where it holds something else."""
    if not folder.exists():
        return
    foreign = {path.name for path in folder.iterdir()} - names if folder.is_dir() else {folder.name}
    if foreign:
        raise DataError(f"--out {folder} holds {min(foreign)}, which is no result of this command; give a new folder")


@contextmanager
def naming_replaced(out: Path, what: str, mark: str = "") -> Iterator[None]:
    """Around what writes to `out`: a line on stderr where an earlier one was there, once it is replaced.

    Args:
        mark: what of it tells that it was there; by default any file in it.
    """
    was_there = (out / mark).exists() if mark else out.is_dir() and any(out.iterdir())
    yield
    if was_there:
        print(f"station: {what} that {out} held from before is replaced", file=sys.stderr)


@contextmanager
def write_results(folder: Path) -> Iterator[Path]:
    """A folder to fill, which takes the name when the block ends. Raises DataError where it cannot be written."""
    out, folder = folder, folder.absolute()
    try:
        make_folder(folder.parent)
        with naming_replaced(out, "the result"), replacing_folder(folder) as fresh:
            yield fresh
    except OSError as exc:
        raise DataError(f"--out {folder} cannot be written ({exc.strerror}); choose another folder") from exc
