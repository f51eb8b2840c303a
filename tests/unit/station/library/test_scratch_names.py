"""A killed writer leaves one file at most beside each small document, and the next write removes it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from station.library.bin import Bin
from station.library.map_choice import store_choice
from station.library.navigation_records import NavigationLibrary, NavigationRecord


def write_bin(folder: Path) -> None:
    Bin(folder / "bin.json").update({"map": [("flat", "Flat")]}, now_s=1.0, run_s=1.0)


def write_choice(folder: Path) -> None:
    store_choice(folder, ("flat",))


def write_record(folder: Path) -> None:
    NavigationLibrary(folder.parent).write(NavigationRecord(folder.name, "Flat", "ready", 1.0, "sfm"))


@pytest.mark.parametrize(
    ("write", "file"), [(write_bin, "bin.json"), (write_choice, "active.json"), (write_record, "record.json")]
)
def test_what_a_killed_writer_left_is_gone_after_the_next_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[Path], None], file: str
) -> None:
    folder = tmp_path / "data"
    flushed: list[Path] = []
    monkeypatch.setattr(os, "fsync", lambda fd: flushed.append(Path(os.readlink(f"/proc/self/fd/{fd}"))))
    write(folder)
    (scratch,) = (path for path in flushed if path.parent == folder)
    assert scratch.name != file
    (folder / file).rename(scratch)  # killed before it could rename it
    write(folder)
    assert [path.name for path in folder.iterdir()] == [file]


def test_things_deleted_at_once_are_written_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: time.sleep(0.001))  # lets the others run in between
    path = tmp_path / "bin.json"
    deleted = Bin(path)
    with ThreadPoolExecutor(8) as threads:
        for _ in threads.map(lambda n: deleted.update({"map": [(f"map-{n}", "Flat")]}, float(n), 0.0), range(40)):
            pass
    again = Bin(path)
    again.open()
    assert again.list() == deleted.list()
    assert [entry.name for entry in tmp_path.iterdir()] == ["bin.json"]
