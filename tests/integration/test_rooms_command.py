"""`station map rooms` and `station export --format floorplan`; bad input becomes one sentence and leaves nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from station.main import app
from station.maps.folder import save_map_folder
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
