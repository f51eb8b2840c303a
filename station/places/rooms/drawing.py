"""A floor plan as a picture: what is drawn where, in metres with y up; `svg.py` and `png.py` put it on paper."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray
from shared.text import columns, fitted
from station.model.floor_plan import NO_ROOM, OCCUPIED, FloorPlan
from station.model.place_map import PlaceMap

MARGIN_M = 0.6
TEXT_M = 0.26  # height of a room's name where the room has space for it
LEAST_TEXT_M = 0.13  # a longer name is cut: smaller letters nobody reads
LETTER = 0.6  # mean width of a letter over the text's height
WIDEST_SWING_M = 1.3  # a wider door has no leaf
SMOOTH_CELLS = 0.8  # outlines of rooms lose what is finer
GOLDEN = 0.618  # hues this far apart differ most from their neighbours
SCALES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnRoom:
    id: str
    name: str
    label: str  # the name, as much of it as the room is wide
    area: str  # "12.4 m²"; "" where nobody knows the scale
    colour: Colour
    outlines: tuple[FloatArray, ...]  # (n, 2) each, closed
    middle: FloatArray  # (2,) of the label
    text_m: float  # height of its name


@dataclass(frozen=True, slots=True, eq=False)
class DrawnDoor:
    id: str
    ends: FloatArray  # (2, 2)
    swing: FloatArray  # (n, 2) the way of its leaf's edge; empty: an opening without a leaf
    is_drawn: bool


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """Everything on a plan, in metres (or the map's guess of them)."""

    low: FloatArray  # (2,) of the page
    high: FloatArray
    rooms: tuple[DrawnRoom, ...]
    furniture: FloatArray  # (n, 4) x0 y0 x1 y1
    walls: FloatArray  # (W, 2, 2)
    doors: tuple[DrawnDoor, ...]
    places: tuple[tuple[FloatArray, str], ...]  # where, name
    path: tuple[FloatArray, ...]  # (n, 2) each: pieces of unbroken tracking
    scale_m: float | None  # length of the scale bar


def draw_plan(plan: FloorPlan, place_map: PlaceMap | None = None) -> Drawing:
    """What is on the page; places and path where a map is given."""
    is_metric = place_map is None or place_map.navigation.is_metric
    rooms = _rooms(plan, is_metric)
    walls = plan.walls / plan.unit
    places, path = ((), ()) if place_map is None else (_places(plan, place_map), _path(plan, place_map))
    shown = [walls.reshape(-1, 2), *(o for room in rooms for o in room.outlines), *path, np.zeros((0, 2))]
    points = np.concatenate([*shown, *(at[None] for at, _ in places)])
    points = points if len(points) else np.zeros((1, 2))
    low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    return Drawing(
        low=low,
        high=high,
        rooms=rooms,
        furniture=_furniture(plan),
        walls=walls,
        doors=tuple(_door(plan, k) for k in range(len(plan.doors))),
        places=places,
        path=path,
        scale_m=_scale(float(high[0] - low[0])) if is_metric else None,
    )


def room_colour(number: int) -> Colour:
    """A soft colour, RGB; rooms next to each other in the list differ."""
    r, g, b = colorsys.hls_to_rgb((0.58 + GOLDEN * number) % 1.0, 0.88, 0.55)
    return round(255 * r), round(255 * g), round(255 * b)


def room_outlines(plan: FloorPlan) -> list[list[FloatArray]]:
    """For each room its closed outlines (n, 2), map units on the ground; the first one is the largest."""
    found: list[list[FloatArray]] = []
    for number, (begin, end) in enumerate(zip(*_boxes(plan), strict=True)):
        if (end <= begin).any():
            found.append([])
            continue
        # Twice as fine, so that the outline runs around the cells and not through their middles.
        mask = plan.room[begin[0] : end[0], begin[1] : end[1]] == number
        mask = mask.astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1)
        fine = cv2.copyMakeBorder(mask, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(0.0,))
        outlines, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        corner = plan.low + plan.cell * (begin - 1)
        pieces = []
        for outline in sorted(outlines, key=cv2.contourArea, reverse=True):
            smooth = cv2.approxPolyDP(outline, 2 * SMOOTH_CELLS, closed=True)[:, 0, ::-1]
            if len(smooth) >= 3:
                pieces.append(corner + plan.cell * (smooth + 0.5) / 2)
        found.append(pieces)
    return found


def _boxes(plan: FloorPlan) -> tuple[IntArray, IntArray]:
    """(rooms, 2) the first cell of each room along both axes, and the one after its last; equal where it has none."""
    cells = np.argwhere(plan.room != NO_ROOM)
    numbers = plan.room[tuple(cells.T)]
    order = np.argsort(numbers, kind="stable")
    own, first = np.unique(numbers[order], return_index=True)
    low, high = np.zeros((len(plan.rooms), 2), dtype=np.int64), np.zeros((len(plan.rooms), 2), dtype=np.int64)
    if len(own):
        low[own], high[own] = (of.reduceat(cells[order], first, axis=0) for of in (np.minimum, np.maximum))
        high[own] += 1
    return low, high


def _rooms(plan: FloorPlan, is_metric: bool) -> tuple[DrawnRoom, ...]:
    drawn = []
    for number, (room, outlines) in enumerate(zip(plan.rooms, room_outlines(plan), strict=True)):
        metres = tuple(outline / plan.unit for outline in outlines)
        middle = room.middle / plan.unit
        left, right = (metres[0][:, 0].min(), metres[0][:, 0].max()) if metres else middle[0] + np.array([-0.5, 0.5])
        space = 0.85 * float(right - left)
        text_m = float(np.clip(space / (LETTER * max(columns(room.name), 4)), LEAST_TEXT_M, TEXT_M))
        label = fitted(room.name, max(1, int(space / (LETTER * text_m) + 1e-9)))
        half = min(LETTER * text_m * columns(label), right - left) / 2
        middle = np.array([np.clip(middle[0], left + half, right - half), middle[1]])
        area = f"{room.area / plan.unit**2:.1f} m²" if is_metric else ""
        drawn.append(DrawnRoom(room.id, room.name, label, area, room_colour(number), metres, middle, text_m))
    return tuple(drawn)


def _furniture(plan: FloorPlan) -> FloatArray:
    """(n, 4) runs of occupied cells inside rooms: x0 y0 x1 y1."""
    stands = (plan.state == OCCUPIED) & (plan.room != NO_ROOM)
    change = np.diff(np.pad(stands, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    begin, end = np.argwhere(change == 1), np.argwhere(change == -1)  # both row by row: they pair up
    boxes = np.column_stack([begin[:, 0], begin[:, 1], begin[:, 0] + 1, end[:, 1]])
    return np.asarray((np.tile(plan.low, 2) + plan.cell * boxes) / plan.unit)


def _door(plan: FloorPlan, number: int) -> DrawnDoor:
    door = plan.doors[number]
    ends = door.ends / plan.unit
    d = ends[1] - ends[0]
    swing = np.zeros((0, 2))
    if door.width / plan.unit <= WIDEST_SWING_M and not door.is_drawn:
        angle = np.linspace(0.0, math.pi / 2, 13)[:, None]
        swing = ends[0] + np.cos(angle) * d + np.sin(angle) * np.array([-d[1], d[0]])
    return DrawnDoor(door.id, ends, swing, door.is_drawn)


def _on_page(plan: FloorPlan, p_map: FloatArray) -> FloatArray:
    """(n, 2) m, of positions (n, 3) of the map."""
    return (p_map @ plan.R_ground_map.T)[:, :2] / plan.unit


def _places(plan: FloorPlan, place_map: PlaceMap) -> tuple[tuple[FloatArray, str], ...]:
    seen = [place for place in place_map.places if not place.hidden]
    if not seen:
        return ()
    at = _on_page(plan, np.array([place.centroid_map for place in seen]))
    return tuple((p, place.name) for p, place in zip(at, seen, strict=True))


def _path(plan: FloorPlan, place_map: PlaceMap) -> tuple[FloatArray, ...]:
    keyframes = place_map.navigation.keyframes
    p = _on_page(plan, keyframes.T_world_cam[:, :3, 3])
    finite = np.isfinite(p).all(axis=1)
    segments = keyframes.segment
    return tuple(p[finite & (segments == s)] for s in np.unique(segments))


def _scale(width_m: float) -> float:
    fitting: Sequence[float] = [length for length in SCALES_M if length <= 0.3 * width_m]
    return max(fitting, default=SCALES_M[0])
