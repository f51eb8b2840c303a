"""A room that was named in a map of another day is suggested its name when the same home is mapped anew."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from station.files.navigation_folder import load_navigation
from station.maps.store import MapStore
from station.model.floor_plan import Room
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.joining.known_names import names_in
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig
from station.places.naming import suggest
from station.places.rooms.edits import require_plan, with_room_renamed
from station.places.rooms.planning import planned
from station.workers.library_jobs import LibraryJobs
from tests.support.days import made_up_days

pytestmark = pytest.mark.computing

HOME, OTHER_HOME = 5, 9  # plans of the first are one room, as it is


def largest(place_map: PlaceMap) -> Room:
    return max(require_plan(place_map).rooms, key=lambda room: room.area)


def first_days(home: int, folder: Path, days: int = 2) -> list[PlaceMap]:
    drives = made_up_days(home, folder)[:days]
    return [planned(build_map(load_navigation(drive.folder), name=f"day {n}")) for n, drive in enumerate(drives)]


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory) -> list[PlaceMap]:
    return first_days(HOME, tmp_path_factory.mktemp("days"))


def test_a_room_is_suggested_what_it_was_called_on_another_day(days: list[PlaceMap]) -> None:
    first, second = days
    named = with_room_renamed(first, largest(first).id, "Kitchen")
    (found,) = names_in(named, second, PlacesConfig())
    assert (found.room, found.name, found.source) == (largest(second).id, "Kitchen", "other map")
    assert 0 < found.confidence <= largest(second).certainty and 'in the map "day 0"' in found.reason
    plan, shown = require_plan(second), found.keyframe_index
    assert shown is not None
    (at,) = plan.rooms_at(second.navigation.keyframes.T_world_cam[shown, None, :3, 3])
    assert plan.rooms[at].id == found.room


def test_names_that_nobody_gave_are_not_carried_and_rooms_that_are_named_get_none(days: list[PlaceMap]) -> None:
    first, second = days
    assert names_in(first, second, PlacesConfig()) == ()
    named = with_room_renamed(first, largest(first).id, "Kitchen")
    assert names_in(named, with_room_renamed(second, largest(second).id, "Loft"), PlacesConfig()) == ()


def test_another_home_names_nothing(days: list[PlaceMap], tmp_path: Path) -> None:
    (elsewhere,) = first_days(OTHER_HOME, tmp_path, days=1)
    named = with_room_renamed(elsewhere, largest(elsewhere).id, "Kitchen")
    assert names_in(named, days[1], PlacesConfig()) == ()


def test_the_job_that_makes_a_map_asks_the_others_that_the_station_keeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suggest, "can_read_print", lambda: False)  # there is nothing to read
    drives = made_up_days(HOME, tmp_path)
    address, store = StoreAddress(tmp_path / "maps"), MapStore(tmp_path / "maps")
    jobs = LibraryJobs(lambda _: None)
    first = jobs.build_map([drives[0].folder], address, "Monday", None)
    before = store.load(first.map_id)
    store.edit(first.map_id, partial(with_room_renamed, room_id=largest(before).id, name="Kitchen"), "named")
    second = store.load(jobs.build_map([drives[1].folder], address, "Tuesday", None).map_id)
    assert [(s.room, s.name, s.source) for s in second.suggestions] == [(largest(second).id, "Kitchen", "other map")]
    assert largest(second).name != "Kitchen"
    again = store.load(jobs.build_map([drives[0].folder], address, "Monday", None).map_id)
    assert largest(again).name == "Kitchen" and again.suggestions == ()
