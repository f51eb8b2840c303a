"""Which maps are active: kept over a restart, never two of one flat, and what cannot be read is left out."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path

import pytest

from station.errors import Conflict, Unknown
from station.events import Events
from station.library.map_choice import FILE, store_choice, stored_choice, why_not_together
from station.library.maps import Maps
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from tests.support.places import make_map


def map_of(map_id: str, drive: str) -> PlaceMap:
    place_map = make_map(map_id)
    return replace(place_map, navigation=replace(place_map.navigation, id=drive))


FLAT, ATTIC = map_of("flat", "nav-1"), map_of("attic", "nav-2")


@pytest.fixture
async def maps(tmp_path: Path) -> Maps:
    """A store of two maps of different rooms, and of one that shares a drive with the first."""
    store = MapStore(tmp_path)
    for place_map in (FLAT, ATTIC, map_of("both", "nav-1+nav-3")):
        store.save(place_map)
    store.close()
    return await started(tmp_path)


async def started(root: Path) -> Maps:
    """As a station starts."""
    maps = Maps(StoreAddress(root), Events())
    await maps.open()
    return maps


def active(maps: Maps) -> list[str]:
    return [one.place_map.id for one in maps.active.all]


def said(maps: Maps) -> list[str]:
    assert isinstance(maps._events, Events)
    return [line.text for line in maps._events.log]


async def test_a_damaged_map_is_told_with_a_command_for_this_stations_data(tmp_path: Path) -> None:
    maps = Maps(StoreAddress(tmp_path / "data" / "maps"), Events())
    maps._loop = asyncio.get_running_loop()
    maps._found_damage("a blob is missing; run `station map repair` or restore a backup")
    await asyncio.sleep(0)
    assert f"run `station map repair --data {tmp_path / 'data'}` or" in said(maps)[0]


@pytest.mark.parametrize(
    ("content", "chosen"),
    [
        ('{"id": "flat"}\n', ("flat",)),  # what stations wrote before there were sets
        ('{"id": null}\n', ()),
        ('{"id": "flat", "also": ["attic"]}', ("flat", "attic")),
        ('{"id": "flat", "also": ["flat", "attic", "attic"]}', ("flat", "attic")),
        ('{"id": 5}', ()),
        ("", ()),
    ],
)
def test_a_file_of_any_station_is_read(tmp_path: Path, content: str, chosen: tuple[str, ...]) -> None:
    (tmp_path / FILE).write_text(content)
    assert stored_choice(tmp_path) == chosen


@pytest.mark.parametrize("chosen", [(), ("flat",), ("flat", "attic", "cellar")])
def test_what_is_kept_is_read_again(tmp_path: Path, chosen: tuple[str, ...]) -> None:
    store_choice(tmp_path, ("another",))
    store_choice(tmp_path, chosen)
    assert stored_choice(tmp_path) == chosen
    stored = json.loads((tmp_path / FILE).read_text())
    assert stored["id"] == (chosen[0] if chosen else None)
    assert ("also" in stored) == (len(chosen) > 1)  # so that a station from before can read a file of one map


def test_maps_of_one_drive_or_of_one_flat_are_not_put_together() -> None:
    assert why_not_together([]) == why_not_together([FLAT]) == why_not_together([FLAT, ATTIC]) == ""
    same_drive = why_not_together([ATTIC, FLAT, map_of("both", "nav-3+nav-1")])
    assert "made from nav-1" in same_drive and "flat and both" in same_drive and "one map" in same_drive
    again = replace(map_of("again", "nav-4"), places=(*ATTIC.places[1:],))  # its places were carried over
    assert "they share places" in why_not_together([FLAT, ATTIC, again])


async def test_a_set_is_active_in_its_order_and_after_a_restart(maps: Maps) -> None:
    await maps.activate(("attic", "flat", "attic"))
    assert active(maps) == ["attic", "flat"] and maps.active.require_first().place_map.id == "attic"
    assert said(maps)[-1] == "using attic, and flat too"
    found = maps.active.find("flat")
    assert found is not None and found.place("flat-0").name == "Place 0" and maps.active.find("both") is None
    again = await started(maps.address.root)
    assert active(again) == ["attic", "flat"]
    await again.activate(("flat",))
    assert active(await started(maps.address.root)) == ["flat"]
    await again.activate(())
    assert active(await started(maps.address.root)) == [] and again.active.first is None


async def test_a_set_that_cannot_be_changes_nothing(maps: Maps) -> None:
    await maps.activate(("attic",))
    revision = maps.active.revision
    with pytest.raises(Conflict, match="maps of the same rooms, both are made from nav-1"):
        await maps.activate(("flat", "both"))
    with pytest.raises(Unknown, match="no map 'cellar'"):
        await maps.activate(("flat", "cellar"))
    assert (
        active(maps) == ["attic"]
        and stored_choice(maps.address.root) == ("attic",)
        and maps.active.revision == revision
    )


@pytest.mark.parametrize(("gone", "left"), [("attic", ["flat"]), ("flat", ["attic"])])
async def test_a_map_that_went_between_two_starts_is_left_out_and_looked_in_when_it_is_back(
    maps: Maps, gone: str, left: list[str]
) -> None:
    await maps.activate(("flat", "attic"))
    store = MapStore(maps.address.root)
    store.delete(gone)
    again = await started(maps.address.root)
    assert active(again) == left
    [line] = [text for text in said(again) if "left out" in text]
    assert f"no map '{gone}'" in line
    store.undo(gone)
    assert active(await started(maps.address.root)) == ["flat", "attic"]


async def test_a_damaged_map_is_left_out_and_told(maps: Maps) -> None:
    await maps.activate(("flat", "attic"))
    for record in (maps.address.root / "records").glob("attic.*"):
        record.write_bytes(b"not a record")
    again = await started(maps.address.root)
    assert active(again) == ["flat"]
    assert any("left out" in text and "attic" in text for text in said(again))


async def test_deleting_one_of_a_set_leaves_it_out_and_the_first_stays_protected(maps: Maps) -> None:
    await maps.activate(("flat", "attic"))
    with pytest.raises(Conflict, match="flat is in use"):
        await maps.delete("flat")
    assert await maps.delete("attic")
    assert active(maps) == ["flat"] and stored_choice(maps.address.root) == ("flat",)
    assert "attic is deleted, so it is left out from now on" in said(maps)
    assert not await maps.delete("both")  # nobody looked in it
    await maps.restore("attic")
    assert active(maps) == ["flat"]


async def test_any_map_of_the_set_is_renamed_and_places_of_the_first(maps: Maps) -> None:
    await maps.activate(("flat", "attic"))
    await maps.rename("attic", "Under the roof")
    assert [one.place_map.name for one in maps.active.all] == ["flat", "Under the roof"]
    await maps.rename_place("flat-1", "Kitchen")
    with pytest.raises(Unknown, match="attic-1"):
        await maps.rename_place("attic-1", "Bed")
    assert [one.place_map.places[1].name for one in maps.active.all] == ["Kitchen", "Place 1"]
