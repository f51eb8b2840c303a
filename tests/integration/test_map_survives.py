"""Kills, wrong bits, full disks and two stations at once: the map is there (the long runs are in benchmarks/)."""

from __future__ import annotations

import contextlib
import multiprocessing
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from shared.errors import DataError
from station.maps.repair.check import verify
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from tests.support.crashing.disks import NoDisk
from tests.support.crashing.flips import flip_many
from tests.support.crashing.maps import MAP, variant
from tests.support.crashing.runs import RUNS_ON_BAD_DISK, SCENARIOS, run_once, run_two_stations
from tests.support.disk import small_disk
from tests.support.postgres import PostgresServer, running_postgres
from tests.support.store import rename_place

NAMES_EACH = 6


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_nothing_promised_is_lost_when_the_program_is_killed(scenario: str, tmp_path: Path) -> None:
    for seed in (1, 2):
        run_once(scenario, tmp_path / "work", seed)


def test_a_wrong_bit_never_gives_a_wrong_map(tmp_path: Path) -> None:
    outcomes = flip_many(30, 100, tmp_path)
    assert set(outcomes) <= {"put right", "harmless", "older version"} and outcomes["put right"]


@pytest.fixture(scope="module")
def postgres() -> Iterator[PostgresServer]:
    with running_postgres() as server:
        yield server


def rename_over_and_over(address: StoreAddress, place: int) -> None:
    """One of two stations."""
    store = MapStore(address)
    for number in range(NAMES_EACH):
        rename_place(store, MAP.id, MAP.places[place].id, f"{address.author} {number}")
    store.save(variant(0) if place else MAP)


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_two_stations_that_write_at_once_keep_every_write(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    url = "" if kind == "sqlite" else request.getfixturevalue("postgres").fresh_database()
    addresses = [StoreAddress(tmp_path, url, author=author) for author in ("desk", "hall")]
    store = MapStore(addresses[0])
    store.save(MAP)
    spawn = multiprocessing.get_context("spawn")
    stations = [spawn.Process(target=rename_over_and_over, args=(a, n)) for n, a in enumerate(addresses)]
    for station in stations:
        station.start()
    for station in stations:
        station.join(120)
        assert station.exitcode == 0
    history = store.history(MAP.id)
    renames = [record for record in history if record.kind == "edited"]
    assert [record.number for record in history] == list(range(len(history), 0, -1))
    for author in ("desk", "hall"):
        assert sum(record.author == author for record in renames) == NAMES_EACH
    last_names = {place.name for record in renames for place in record.places[:2]}
    assert {f"desk {NAMES_EACH - 1}", f"hall {NAMES_EACH - 1}"} <= last_names
    assert verify(store) == ()


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_station_that_is_killed_takes_no_write_of_another_with_it(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    for seed in (1, 2, 3):
        url = "" if kind == "sqlite" else request.getfixturevalue("postgres").fresh_database()
        run_two_stations(tmp_path / "work", seed, url)


@pytest.mark.parametrize("fault", RUNS_ON_BAD_DISK)
@pytest.mark.parametrize("scenario", ["record", "save", "rename"])
def test_a_disk_that_refuses_in_the_middle_costs_nothing(scenario: str, fault: str) -> None:
    try:
        RUNS_ON_BAD_DISK[fault](scenario, 1)
    except NoDisk as exc:
        pytest.skip(f"no small disk can be had here: {exc}")


def save_until_full(store: MapStore) -> int:
    """The last one that was kept."""
    for number in range(1, 1000):
        try:
            store.save(variant(number))
        except DataError:
            return number - 1
    raise AssertionError("the disk never became full")


def test_a_full_disk_costs_nothing_that_was_kept(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "3m") as disk:
        store = MapStore(disk / "maps")
        (disk / "ballast").write_bytes(bytes(400_000))
        store.save(variant(0))
        kept = save_until_full(store)
        assert MapStore(disk / "maps").load(MAP.id).name == f"v{kept}"
        assert verify(MapStore(disk / "maps")) == ()
        filler = disk / "filler"
        with contextlib.suppress(OSError):
            filler.write_bytes(bytes(10_000_000))
        for attempt in (
            lambda: rename_place(store, MAP.id, MAP.places[0].id, "Sofa"),
            lambda: store.delete(MAP.id),
            lambda: store.undo(MAP.id, to=1),
        ):
            with pytest.raises(DataError, match=r"No space left|is full"):
                attempt()
        assert MapStore(disk / "maps").load(MAP.id).name == f"v{kept}"
        filler.unlink()
        (disk / "ballast").unlink()
        rename_place(store, MAP.id, MAP.places[0].id, "Sofa")
        assert MapStore(disk / "maps").load(MAP.id).places[0].name == "Sofa"


def test_a_read_only_disk_is_still_read(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "4m") as disk:
        MapStore(disk / "maps").save(MAP)
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        store = MapStore(disk / "maps")
        assert [summary.id for summary in store.list()] == [MAP.id]
        assert store.load(MAP.id).name == MAP.name and verify(store) == ()
        with pytest.raises(DataError, match=r"[Rr]ead-only|readonly"):
            rename_place(store, MAP.id, MAP.places[0].id, "Sofa")
        with pytest.raises(DataError, match=r"[Rr]ead-only"):
            store.save(variant(1))
