"""A printed word names the room behind the door that it hangs beside, a word for a room the one that it hangs in."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from shared.errors import DataError
from station.events import Events
from station.library.maps import Maps
from station.maps.store import MapStore
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.frames import ImageArray
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.naming import suggest
from station.places.naming.close_views import close_views
from station.places.naming.plates import find_plates, plate_name, reads_like_a_plate
from station.places.naming.room_words import default_words
from station.places.naming.sightings import suggestions
from station.places.naming.suggest import plate_names, sticker_names, suggest_names
from station.places.rooms.planning import with_plan, with_suggestions_of
from station.vision.printed import PrintedLine, PrintReader
from station.workers import library_jobs
from station.workers.library_jobs import LibraryJobs
from tests.support.plans import WALL_X, two_rooms
from tests.support.plates import map_of_walls, plate_picture
from tests.support.stickers import sticker_picture

BESIDE_DOOR_Y, FAR_FROM_DOOR_Y = 0.7, 1.3  # along the wall between the rooms; the door ends at 0.45
FAR = (5.4, 1.0)  # in the kitchen, 1.5 m before its outer wall, whose door is beyond reach of the plate


@pytest.fixture(scope="module")
def reader() -> PrintReader:
    return PrintReader()


def read_by(reader: PrintReader, *plates: tuple[str, tuple[float, float]]) -> tuple[NameSuggestion, ...]:
    """Plates that are read from 1.5 m before them."""
    place_map = map_of_walls([plate_picture(text) for text, _ in plates], [xy for _, xy in plates], [1.5] * len(plates))
    plan = two_rooms()
    return suggestions(find_plates(place_map, plan, default_words(), reader), plan)


@pytest.mark.computing
@pytest.mark.parametrize("text", ["Kitchen", "Room 2.14", "Anna"])
def test_a_plate_beside_a_door_names_the_room_behind_it(reader: PrintReader, text: str) -> None:
    (found,) = read_by(reader, (text, (WALL_X - 1.5, BESIDE_DOOR_Y)))
    assert (found.room, found.name, found.source, found.keyframe_index) == ("room-k", text, "door plate", 0)
    assert "beside the door to here" in found.reason and "1.5 m" in found.reason
    assert found.corners_px is not None and abs(found.corners_px.mean(axis=0) - [319.5, 239.5]).max() < 6


@pytest.mark.computing
def test_a_word_for_a_room_away_from_doors_names_the_room_that_it_hangs_in(reader: PrintReader) -> None:
    (found,) = read_by(reader, ("KITCHEN", FAR))
    assert (found.room, found.name) == ("room-k", "Kitchen") and "hangs here" in found.reason


@pytest.mark.computing
def test_other_words_away_from_doors_name_nothing(reader: PrintReader) -> None:
    assert read_by(reader, ("Panasonic", FAR), ("Room 2.14", (WALL_X - 1.5, FAR_FROM_DOOR_Y))) == ()


@pytest.mark.computing
def test_a_plate_beside_a_door_that_nobody_went_through_names_nothing(reader: PrintReader) -> None:
    assert read_by(reader, ("Office", (5.5, 0.7))) == ()


@pytest.mark.computing
def test_a_name_printed_on_a_sticker_is_the_stickers(reader: PrintReader) -> None:
    """The page that `station stickers` prints says the name beneath the code, and hangs inside the room."""
    hangs = (WALL_X - 1.5, BESIDE_DOOR_Y)
    both = map_of_walls([sticker_picture("Parlour", 1.5), plate_picture("Parlour")], [hangs] * 2, [1.5] * 2)
    (found,) = suggest_names(both, two_rooms())
    assert (found.source, found.room) == ("sticker", "room-l")
    assert plate_names(both, two_rooms()) == ()
    assert [s.name for s in sticker_names(both, two_rooms())] == ["Parlour"]


@pytest.mark.computing
async def test_plates_are_read_once_a_map_is_there_and_its_rooms_have_their_names_at_once(
    reader: PrintReader, tmp_path: Path
) -> None:
    plan = two_rooms()
    place_map = replace(map_of_walls([plate_picture("Pantry")], [(WALL_X - 1.5, BESIDE_DOOR_Y)], [1.5]), plan=plan)
    address = StoreAddress(tmp_path)
    MapStore(address).save(place_map)
    maps = Maps(address, Events())
    await maps.activate([place_map.id])
    await maps.rename_room("room-l", "Hall")
    said: list[str] = []
    jobs = LibraryJobs(lambda progress: said.append(progress.message))
    assert jobs.read_plates(address, place_map.id)
    assert said == ["reading door plates, picture 1 of 1"]
    await maps.refresh(place_map.id)

    def suggested() -> list[tuple[str, str]]:
        return [(s.room, s.name) for s in maps.active.require_first().place_map.suggestions]

    assert suggested() == [("room-k", "Pantry")]
    (named,) = await maps.changes()  # a person's own; that plates were read is none
    await maps.undo(named.version)
    assert maps.active.require_first().room("room-l").name != "Hall" and suggested() == [("room-k", "Pantry")]
    assert await maps.changes() == ()


@pytest.mark.computing
def test_plates_of_a_map_that_was_made_anew_meanwhile_are_left_out(
    reader: PrintReader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walls = map_of_walls([plate_picture("Pantry")], [(WALL_X - 1.5, BESIDE_DOOR_Y)], [1.5])
    place_map, store = replace(walls, plan=two_rooms()), MapStore(StoreAddress(tmp_path))
    store.save(place_map)
    other = replace(walls.navigation.keyframes, encoded=(plate_picture("Office"),))

    def while_it_is_made_anew(place_map: PlaceMap, plan: FloorPlan, say: object) -> tuple[NameSuggestion, ...]:
        store.save(replace(place_map, navigation=replace(place_map.navigation, keyframes=other)))
        return plate_names(place_map, plan)

    monkeypatch.setattr(library_jobs, "plate_names", while_it_is_made_anew)
    with pytest.raises(DataError, match="made anew"):
        LibraryJobs(lambda _: None).read_plates(StoreAddress(tmp_path), place_map.id)
    assert store.load(place_map.id).suggestions == ()


@pytest.mark.computing
def test_a_plan_made_again_leaves_a_plate_with_the_room_behind_the_door(reader: PrintReader) -> None:
    place_map = map_of_walls([plate_picture("Pantry")], [(WALL_X - 1.5, BESIDE_DOOR_Y)], [1.5])
    plan = two_rooms()
    found = suggestions(find_plates(place_map, plan, default_words(), reader), plan)
    flat = with_plan(place_map, plan)
    (again,) = with_suggestions_of(flat, "door plate", found).suggestions
    assert (again.room, again.confidence) == ("room-k", found[0].confidence)


def test_a_plate_whose_distance_nobody_knows_names_nothing() -> None:
    place_map = map_of_walls([plate_picture("Pantry")], [(WALL_X - 1.5, BESIDE_DOOR_Y)], [1.5])

    def in_a_corner(_: ImageArray) -> list[PrintedLine]:
        return [PrintedLine("Pantry", 1.0, np.array([[-90.0, -90], [-60, -90], [-60, -80], [-90, -80]]))]

    assert find_plates(place_map, two_rooms(), default_words(), in_a_corner) == []


def test_without_the_extra_nothing_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suggest, "can_read_print", lambda: False)
    place_map = map_of_walls([plate_picture("Pantry")], [(WALL_X - 1.5, BESIDE_DOOR_Y)], [1.5])
    assert suggest_names(place_map, two_rooms()) == ()


@pytest.mark.parametrize("is_late", [False, True])
def test_a_reader_that_does_not_load_costs_the_plates_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, is_late: bool
) -> None:
    """At once, as an onnxruntime of another processor, or with the first picture, as a model that is not there."""

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no such model")

    monkeypatch.setattr(suggest, "can_read_print", lambda: True)
    broken = SimpleNamespace(RapidOCR=(lambda **_: fail) if is_late else fail)
    monkeypatch.setitem(sys.modules, "rapidocr", broken)
    hangs = (WALL_X - 1.5, BESIDE_DOOR_Y)
    both = map_of_walls([sticker_picture("Parlour", 1.5), plate_picture("Pantry")], [hangs] * 2, [1.5] * 2)
    said: list[str] = []
    assert [s.name for s in suggest_names(both, two_rooms(), said.append)] == ["Parlour"]
    assert "no door plates are read" in said[-1] and "RuntimeError: no such model" in caplog.text


def test_each_thing_is_read_once_and_from_nearby() -> None:
    """A wall seen from 3 m and from 1.5 m, and another one seen twice from one spot."""
    place_map = map_of_walls([b""] * 4, [(0.0, 0.0), (1.5, 0.0), (9.0, 0.0), (9.0, 0.0)], [1.5] * 4)
    landmarks = place_map.navigation.landmarks
    n = int((landmarks.observed_keyframe == 1).sum())
    seen_twice = replace(landmarks, observed_landmark=np.concatenate([np.arange(n, 3 * n), np.arange(n, 3 * n)]))
    seen_twice = replace(seen_twice, observed_keyframe=np.repeat([0, 2, 1, 3], n))
    navigation = replace(place_map.navigation, landmarks=seen_twice)
    assert close_views(navigation, 4, 10).tolist() == [1, 2]
    assert close_views(navigation, 4, 1).tolist() == [1]
    assert close_views(navigation, n + 1, 10).tolist() == []


def test_a_word_that_is_in_the_list_needs_no_further_proof_and_others_do() -> None:
    nowhere = np.zeros((4, 2))
    lines = [PrintedLine(text, score, nowhere) for text in ("KUCHE", "Anna") for score in (0.91, 0.98)]
    assert [plate_name(line, default_words()) for line in lines] == ["Küche", "Küche", None, "Anna"]
    assert plate_name(PrintedLine("1.99 €", 1.0, nowhere), default_words()) is None


@pytest.mark.parametrize("text", ["Kitchen", "Room 2.14", "2.14", "WC", "Dr. A. Smith", "Kid's room"])
def test_plates_read_like_plates(text: str) -> None:
    assert reads_like_a_plate(text)


@pytest.mark.parametrize(
    "text", ["a", "1.99 €", "https://x.org", "30 %", "keep this door closed at night", "***!--", ""]
)
def test_what_is_no_plate_does_not(text: str) -> None:
    assert not reads_like_a_plate(text)
