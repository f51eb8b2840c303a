"""`station map rooms` and `station export --format floorplan`; bad input becomes one sentence and leaves nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from station.commands import map as map_command
from station.files.navigation_folder import save_navigation
from station.main import app
from station.maps.folder import save_map_folder
from station.model.floor_plan import NameSuggestion
from station.model.place_map import PlaceMap
from station.places.rooms.edits import with_room_renamed
from tests.support.made_up_workers import made_up_navigation
from tests.support.places import make_map
from tests.support.plans import with_two_rooms


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    save_map_folder(with_two_rooms(make_map()), tmp_path / "map")
    return tmp_path / "map"


def test_rooms_and_doors_are_listed(flat: Path) -> None:
    said = CliRunner().invoke(app, ["map", "rooms", str(flat)]).stdout
    assert "Living room: 12.0 m², 1 place\n" in said
    assert "Living room - Room 2: door, 0.90 m wide" in said and "Room 2 - outside of the map: door" in said
    listed = json.loads(CliRunner().invoke(app, ["map", "rooms", str(flat), "--json"]).stdout)
    assert [room["name"] for room in listed["rooms"]] == ["Living room", "Room 2"]
    assert [door["rooms"] for door in listed["doors"]] == [["room-l", "room-k"], ["room-k", None]]


def test_names_that_are_suggested_are_listed_with_what_speaks_for_them(flat: Path) -> None:
    place_map = replace(
        with_two_rooms(make_map()),
        suggestions=(
            NameSuggestion("room-k", "Pantry", "model", 0.31, "rooms.onnx takes two of its places for one"),
            NameSuggestion("room-k", "Kitchen", "door plate", 0.98, "A plate beside the door reads so.", 1),
            NameSuggestion("room-l", "living ROOM", "sticker", 0.9, "it is called so"),
        ),
    )
    save_map_folder(place_map, flat.parent / "suggested")
    lines = CliRunner().invoke(app, ["map", "rooms", str(flat.parent / "suggested")]).stdout.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("  Room 2:"))
    assert lines[at + 1 : at + 3] == [
        "    Kitchen? (98%, printed word) A plate beside the door reads so. (picture 1)",
        "    Pantry? (31%, model) rooms.onnx takes two of its places for one",
    ]
    assert not any("living ROOM" in line for line in lines)
    listed = json.loads(CliRunner().invoke(app, ["map", "rooms", str(flat.parent / "suggested"), "--json"]).stdout)
    first, _ = listed["rooms"][1]["suggestions"]
    assert (first["name"], first["confidence"], first["picture"]) == ("Kitchen", 0.98, 1)
    assert listed["rooms"][1]["named"] is False


def test_a_long_name_is_cut_in_the_list_and_whole_as_json(flat: Path) -> None:
    long = "The room with the blue curtains where grandmother keeps everything that we need"
    place_map = with_room_renamed(with_two_rooms(make_map()), "room-l", long)
    save_map_folder(place_map, flat.parent / "long")
    lines = CliRunner().invoke(app, ["map", "rooms", str(flat.parent / "long")]).stdout.splitlines()
    assert "  The room with the blue curtains where g…: 12.0 m², 1 place" in lines
    assert max(map(len, lines)) < 80
    listed = json.loads(CliRunner().invoke(app, ["map", "rooms", str(flat.parent / "long"), "--json"]).stdout)
    assert listed["rooms"][0]["name"] == long


@pytest.mark.parametrize(("name", "begin"), [("a.svg", b"<svg"), ("a.PNG", b"\x89PNG"), ("a.json", b"{")])
def test_a_plan_is_drawn_as_the_file_is_called(flat: Path, name: str, begin: bytes) -> None:
    out = flat.parent / name
    assert CliRunner().invoke(app, ["export", str(flat), "--format", "floorplan", "--out", str(out)]).exit_code == 0
    assert out.read_bytes().startswith(begin)


def test_a_file_name_that_says_no_format_is_refused_and_leaves_nothing(flat: Path) -> None:
    out = flat.parent / "a.bmp"
    result = CliRunner().invoke(app, ["export", str(flat), "--format", "floorplan", "--out", str(out)])
    assert result.exit_code != 0 and "end in .svg" in str(result.exception) and not out.exists()


def test_a_map_older_than_plans_gets_its_plan_where_it_is_asked_for(flat: Path) -> None:
    save_map_folder(make_map(), flat.parent / "old")
    said = CliRunner().invoke(app, ["map", "rooms", str(flat.parent / "old"), "--json"])
    assert said.exit_code == 0 and "rooms" in json.loads(said.stdout.splitlines()[-1])


@pytest.mark.computing
def test_building_a_map_shows_what_it_does_until_it_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []  # what the bar says; empty where there is none
    during: list[str] = []

    class Said:
        def step(self, description: str, total: int | None = None) -> None:
            shown[:] = [description]

        def advance(self) -> None:
            pass

    @contextmanager
    def said(description: str) -> Iterator[Said]:
        shown[:] = [description]
        yield Said()
        shown.clear()

    def look(place_map: PlaceMap, say: Callable[[str], None]) -> PlaceMap:
        during.extend(shown)
        return place_map

    def plan(place_map: PlaceMap, earlier: PlaceMap | None = None) -> PlaceMap:
        during.extend(shown)
        return place_map

    monkeypatch.setattr(map_command, "working", said)
    monkeypatch.setattr(map_command, "planned", plan)
    monkeypatch.setattr(map_command, "with_suggestions", look)
    save_navigation(made_up_navigation(), tmp_path / "drive")
    built = CliRunner().invoke(app, ["map", "build", str(tmp_path / "drive"), "--out", str(tmp_path / "map")])
    assert built.exit_code == 0, built.output
    assert during == ["looking for rooms and doors", "looking for stickers that name rooms"]
