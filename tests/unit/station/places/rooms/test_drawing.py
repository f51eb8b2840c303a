"""A floor plan on paper: whole files, with every room and door on them."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import cv2
import numpy as np

from station.model.floor_plan import PlanEdits
from station.places.rooms.drawing import draw_plan
from station.places.rooms.geojson import floorplan_json
from station.places.rooms.plan import make_floor_plan
from station.places.rooms.png import floorplan_png
from station.places.rooms.svg import floorplan_svg
from tests.support.flats import TWO_ROOMS, WAY_OF_TWO, navigate

SVG = "{http://www.w3.org/2000/svg}"
NAVIGATION = navigate(TWO_ROOMS, WAY_OF_TWO)
FIRST = make_floor_plan(NAVIGATION, ())
PLAN = make_floor_plan(NAVIGATION, (), PlanEdits(names={FIRST.rooms[0].id: "Küche <1>"}), FIRST)


def test_the_svg_names_each_room_and_shows_its_door() -> None:
    page = ElementTree.fromstring(floorplan_svg(PLAN))
    texts = [node.findtext(f"{SVG}tspan") or "" for node in page.iter(f"{SVG}text")]
    assert any(text.startswith("Küche <1>") for text in texts) and any(text.startswith("Room 2") for text in texts)
    kinds = [node.get("class") for node in page.iter()]
    assert kinds.count("room") == 2 and kinds.count("door") == 1


def test_the_png_is_as_large_as_the_flat_and_has_walls_and_colours() -> None:
    image = cv2.imdecode(np.frombuffer(floorplan_png(PLAN), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.shape[1] > 1.5 * image.shape[0]
    dark = np.mean(image.max(axis=2) < 80)
    assert 0.02 < dark < 0.3
    assert np.mean(image.min(axis=2) < 250) > 0.5  # rooms are filled


def test_a_long_name_is_cut_where_its_room_ends_and_whole_beside_the_pointer() -> None:
    name = "The room with the blue curtains where grandmother keeps everything that we need."
    plan = make_floor_plan(NAVIGATION, (), PlanEdits(names={FIRST.rooms[0].id: name}), FIRST)
    drawing = draw_plan(plan)
    room = drawing.rooms[0]
    assert room.label.endswith("…") and name.startswith(room.label[:-1]) and len(room.label) > 20
    page = ElementTree.fromstring(floorplan_svg(plan))
    labels = [node for node in page.iter(f"{SVG}text") if node.get("data-id") == room.id]
    assert [node.findtext(f"{SVG}title") for node in labels] == [name]
    assert [node.findtext(f"{SVG}tspan") for node in labels] == [room.label]
    long, short = (cv2.imdecode(np.frombuffer(floorplan_png(p), np.uint8), cv2.IMREAD_GRAYSCALE) for p in (plan, FIRST))
    assert long is not None and short is not None and long.shape == short.shape
    written_m = np.flatnonzero((long != short).any(axis=0)) * (drawing.high - drawing.low)[0] / long.shape[1]
    x_m = room.outlines[0][:, 0] - drawing.low[0]
    assert x_m.min() < written_m.min() and written_m.max() < x_m.max()


def test_the_json_has_rooms_doors_and_walls() -> None:
    features = json.loads(floorplan_json(PLAN))["features"]
    kinds = [feature["properties"]["kind"] for feature in features]
    assert kinds.count("room") == 2 and kinds.count("door") == 1 and kinds.count("walls") == 1
    assert features[0]["properties"]["name"] == "Küche <1>"
