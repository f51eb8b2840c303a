"""A pipe where a station expects a file of its own: nobody waits for what never comes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from shared.errors import DataError
from station.library.bin import Bin
from station.library.comparisons import Comparisons
from station.library.map_choice import stored_choice
from station.library.navigation_records import NavigationLibrary
from station.maps.bucket import FolderBucket


def read_bin(data: Path) -> object:
    deleted = Bin(data / "bin.json")
    deleted.open()
    return deleted.list()


def read_navigations(data: Path) -> object:
    library = NavigationLibrary(data)
    library.open()
    return (*library.list(), *library.deleted())


READERS: dict[str, Callable[[Path], object]] = {
    "bin.json": read_bin,
    "active.json": stored_choice,
    "nav-1/record.json": read_navigations,
    ".bin/nav-1/record.json": read_navigations,
    "cmp-1/comparison.json": lambda data: Comparisons(data).list(),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", READERS)
def test_a_station_waits_for_no_pipe(name: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(tmp_path / name)
    assert READERS[name](tmp_path) == ()


@pytest.mark.timeout(20)
def test_a_map_store_waits_for_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "blob")
    with pytest.raises(DataError, match="it is a pipe, no file"):
        FolderBucket(tmp_path).get("blob")
