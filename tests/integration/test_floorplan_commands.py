"""Floor plans by the commands, from a finished navigation on: its map, its rooms, its drawings; and bad input."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from shared.errors import DataError
from station.files.navigation_folder import save_navigation
from station.main import app
from station.maps.folder import save_map_folder
from station.places.making.build import build_map
from tests.support.flats import TWO_ROOMS, WAY_OF_TWO, navigate

pytestmark = pytest.mark.computing


def station(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the navigation `nav` through two rooms and its `map`."""
    root = tmp_path_factory.mktemp("home")
    navigation = navigate(TWO_ROOMS, WAY_OF_TWO)
    save_navigation(navigation, root / "nav")
    save_map_folder(build_map(navigation), root / "map")
    return root


def test_rooms_of_a_map_are_listed_with_their_areas_and_the_door(home: Path) -> None:
    lines = station("map", "rooms", home / "map").stdout.splitlines()
    assert sum("m²" in line for line in lines) == 2
    assert sum(line.startswith("  Room 1 - Room 2: door, ") for line in lines) == 1
    listed = json.loads(station("map", "rooms", home / "map", "--json").stdout)
    assert [room["area"] for room in listed["rooms"]] == pytest.approx([16.0, 16.0], rel=0.1)
    (door,) = listed["doors"]
    assert sorted(door["rooms"]) == sorted(room["id"] for room in listed["rooms"])


def test_a_plan_is_drawn_with_its_rooms_in_every_format(home: Path, tmp_path: Path) -> None:
    for ending in ("svg", "png", "json"):
        result = station("export", home / "map", "--format", "floorplan", "--out", tmp_path / f"plan.{ending}")
        assert result.exit_code == 0, result.output
    words = " ".join(ElementTree.parse(tmp_path / "plan.svg").getroot().itertext())
    assert "Room 1" in words and "Room 2" in words
    picture = cv2.imread(str(tmp_path / "plan.png"))
    assert picture is not None and len(np.unique(picture.reshape(-1, 3), axis=0)) > 3
    kinds = [feature["properties"]["kind"] for feature in json.loads((tmp_path / "plan.json").read_text())["features"]]
    assert kinds.count("room") == 2 and kinds.count("door") == 1


@pytest.mark.parametrize(
    ("source", "name", "words"),
    [
        ("nowhere", "plan.svg", "nowhere is no folder"),
        ("nav", "plan.svg", "is a navigation and has no rooms"),
        ("map", "plan.pdf", "let its name end in .svg, .png or .json"),
    ],
)
def test_what_cannot_be_drawn_is_refused_and_leaves_nothing(
    home: Path, tmp_path: Path, source: str, name: str, words: str
) -> None:
    result = station("export", home / source, "--format", "floorplan", "--out", tmp_path / name)
    assert result.exit_code != 0 and isinstance(result.exception, DataError)
    assert words in str(result.exception) and not list(tmp_path.iterdir())


@pytest.mark.parametrize(("source", "words"), [("nowhere", "is no folder"), ("nav", "holds no map")])
def test_rooms_of_what_is_no_map_are_refused_in_a_sentence(home: Path, source: str, words: str) -> None:
    result = station("map", "rooms", home / source)
    assert result.exit_code != 0 and isinstance(result.exception, DataError)
    assert words in str(result.exception) and not result.stdout
