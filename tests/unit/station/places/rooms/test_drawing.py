"""A floor plan on paper: whole files, with every room and door on them."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import cv2
import numpy as np

from station.model.floor_plan import PlanEdits
from station.places.rooms.geojson import floorplan_json
from station.places.rooms.plan import make_floor_plan
from station.places.rooms.png import floorplan_png
from station.places.rooms.svg import floorplan_svg
from tests.support.flats import TWO_ROOMS, WAY_OF_TWO, navigate

NAVIGATION = navigate(TWO_ROOMS, WAY_OF_TWO)
FIRST = make_floor_plan(NAVIGATION, ())
PLAN = make_floor_plan(NAVIGATION, (), PlanEdits(names={FIRST.rooms[0].id: "Küche <1>"}), FIRST)


def test_the_svg_names_each_room_and_shows_its_door() -> None:
    page = ElementTree.fromstring(floorplan_svg(PLAN))
    texts = ["".join(node.itertext()) for node in page.iter("{http://www.w3.org/2000/svg}text")]
    assert any(text.startswith("Küche <1>") for text in texts) and any(text.startswith("Room 2") for text in texts)
    kinds = [node.get("class") for node in page.iter()]
    assert kinds.count("room") == 2 and kinds.count("door") == 1


def test_the_png_is_as_large_as_the_flat_and_has_walls_and_colours() -> None:
    image = cv2.imdecode(np.frombuffer(floorplan_png(PLAN), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.shape[1] > 1.5 * image.shape[0]
    dark = np.mean(image.max(axis=2) < 80)
    assert 0.02 < dark < 0.3
    assert np.mean(image.min(axis=2) < 250) > 0.5  # rooms are filled


def test_the_json_has_rooms_doors_and_walls() -> None:
    features = json.loads(floorplan_json(PLAN))["features"]
    kinds = [feature["properties"]["kind"] for feature in features]
    assert kinds.count("room") == 2 and kinds.count("door") == 1 and kinds.count("walls") == 1
    assert features[0]["properties"]["name"] == "Küche <1>"
