"""The floor plan of a map: rooms and doors in its record, where a person can read them; cells and walls in a file."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import msgspec
import numpy as np

from shared.errors import DataError
from shared.geometry import FloatArray, are_poses, se3
from shared.text import is_printable, printable
from station.files.npz import open_arrays
from station.maps.editing import MAX_NAME
from station.model.floor_plan import MAX_EDITS, NO_ROOM, OCCUPIED, Door, FloorPlan, NameSuggestion, PlanEdits, Room
from station.model.place_map import PlaceMap

CELLS = "floor_plan.npz"
MAX_CELLS = 4_000_000  # as free space has at most (places/space)
MAX_WALLS = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class PlanRecord:
    """A plan but for its cells and walls, what people made of it, and the names that something speaks for."""

    R_ground_map: FloatArray
    low: FloatArray
    cell: float
    unit: float
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    room_of_place: Mapping[str, str]
    edits: PlanEdits
    suggestions: tuple[NameSuggestion, ...]


_OF_PLAN = [field.name for field in fields(PlanRecord) if field.name not in ("edits", "suggestions")]


def describe_plan(place_map: PlaceMap) -> PlanRecord | None:
    """What a record says of a map's plan. Raises DataError: a name of a room cannot be shown."""
    if place_map.plan is None:
        return None
    for room in place_map.plan.rooms:
        if not is_printable(room.name):
            raise DataError(f"map {place_map.id}: the name {room.name!r} holds characters that cannot be shown")
    of_plan = {name: getattr(place_map.plan, name) for name in _OF_PLAN}
    return PlanRecord(**of_plan, edits=place_map.plan_edits, suggestions=place_map.suggestions)


def encode_plan(plan: PlanRecord | None) -> dict[str, Any]:
    """What a record has of it, in plain types: nothing without a plan, as in records from before there were plans."""
    if plan is None:
        return {}
    content = msgspec.to_builtins(plan, enc_hook=np.ndarray.tolist)
    return {"rooms": content.pop("rooms"), "floor_plan": content}


def decode_plan(content: Mapping[str, Any]) -> PlanRecord | None:
    """What `encode_plan` wrote, in a record or not. Raises ValueError or a ValidationError."""
    if "floor_plan" not in content:
        return None
    plan = msgspec.convert({**content["floor_plan"], "rooms": content["rooms"]}, PlanRecord, dec_hook=_array)
    shapes = [(plan.R_ground_map, (3, 3)), (plan.low, (2,))]
    shapes += [(room.middle, (2,)) for room in plan.rooms] + [(door.ends, (2, 2)) for door in plan.doors]
    shapes += [(line, (2, 2)) for line in (*plan.edits.doors_drawn, *plan.edits.doors_erased)]
    shapes += [(xy, (2,)) for xy in plan.edits.middles.values()]
    shapes += [(s.corners_px, (4, 2)) for s in plan.suggestions if s.corners_px is not None]
    shapes += [(s.p_map, (3,)) for s in plan.suggestions if s.p_map is not None]
    if any(values.shape != shape for values, shape in shapes):
        raise ValueError("an array of its floor plan has another shape")
    numbers = [plan.cell, plan.unit, *(room.area for room in plan.rooms), *(s.confidence for s in plan.suggestions)]
    if not all(map(math.isfinite, numbers)) or min(plan.cell, plan.unit) <= 0:
        raise ValueError("a length of its floor plan is none")
    _check_ranges(plan)
    _check_names(plan)
    ids = {room.id for room in plan.rooms}
    named = [*plan.room_of_place.values(), *(id for door in plan.doors for id in door.rooms if id is not None)]
    if (
        len(ids) < len(plan.rooms)
        or len({door.id for door in plan.doors}) < len(plan.doors)
        or not ids.issuperset(named)
    ):
        raise ValueError("its floor plan names a room that it does not have, or a room or a door twice")
    return replace(
        plan,
        rooms=tuple(replace(room, name=printable(room.name)) for room in plan.rooms),
        edits=replace(plan.edits, names={id: printable(name) for id, name in plan.edits.names.items()}),
        suggestions=tuple(
            replace(s, name=printable(s.name), reason=printable(s.reason)) for s in plan.suggestions
        ),
    )  # fmt: skip


def _check_ranges(plan: PlanRecord) -> None:
    """Raises ValueError for numbers that no plan has."""
    R = plan.R_ground_map
    if not are_poses(se3(R, np.zeros(3))[None]) or np.linalg.det(R) < 0:
        raise ValueError("the axes of its floor plan are no rotation")
    if any(room.area < 0 for room in plan.rooms):
        raise ValueError("a room of its floor plan has a negative area")
    if not all(0.0 <= room.certainty <= 1.0 for room in plan.rooms):
        raise ValueError("a probability of its floor plan is none")
    for suggestion in plan.suggestions:
        if not 0 <= suggestion.confidence <= 1 or (suggestion.keyframe_index or 0) < 0:
            raise ValueError("a suggestion for its rooms has a confidence beside 0 to 1, or a picture that is none")
    if len(plan.edits.doors_drawn) + len(plan.edits.doors_erased) > MAX_EDITS:
        raise ValueError(f"its floor plan has more than {MAX_EDITS} doors that people drew or erased")


def _check_names(plan: PlanRecord) -> None:
    """Raises ValueError for names that no room can have."""
    names = [room.name for room in plan.rooms]
    given = [*plan.edits.names.values(), *(suggestion.name for suggestion in plan.suggestions)]
    if not all(0 < len(name) <= MAX_NAME for name in (*names, *given)):
        raise ValueError(f"a name of a room needs 1 to {MAX_NAME} characters")
    if len({name.casefold() for name in names}) < len(names):
        raise ValueError("two of its rooms have one name")


def plan_files(place_map: PlaceMap) -> dict[str, bytes]:
    """The file beside the record, by its name; none without a plan. Equal plans give equal bytes."""
    if (plan := place_map.plan) is None:
        return {}
    cells = io.BytesIO()
    np.savez_compressed(
        cells,
        state=plan.state.astype(np.uint8),
        room=plan.room.astype("<i2"),
        walls=plan.walls.astype("<f8").reshape(-1, 2, 2),
    )
    return {CELLS: cells.getvalue()}


def with_plan(place_map: PlaceMap, plan: PlanRecord | None, cells: bytes) -> PlaceMap:
    """A map with the plan of its record and its file. Raises one of npz.UNREADABLE."""
    if plan is None:
        return place_map
    with open_arrays(io.BytesIO(cells)) as arrays:
        for name, limit in (("state", MAX_CELLS), ("room", MAX_CELLS), ("walls", 4 * MAX_WALLS)):
            with arrays.open(name) as (header, _):
                if math.prod(header.shape) > limit:
                    raise ValueError(f"its {name} is too large")
        state, room, walls = (arrays.read(name) for name in ("state", "room", "walls"))
    if state.dtype != np.uint8 or room.dtype != np.int16 or walls.dtype != np.float64 or walls.shape[1:] != (2, 2):
        raise ValueError("an array is of another kind")
    if state.ndim != 2 or state.shape != room.shape or not np.isfinite(walls).all():
        raise ValueError("its cells do not fit together")
    if state.size and (state.max() > OCCUPIED or room.min() < NO_ROOM or room.max() >= len(plan.rooms)):
        raise ValueError("a cell is of no room that there is")
    pictures = len(place_map.navigation.keyframes.encoded)
    if any((suggestion.keyframe_index or 0) >= max(pictures, 1) for suggestion in plan.suggestions):
        raise ValueError("a suggestion for its rooms is of a picture that there is not")
    of_plan = {name: getattr(plan, name) for name in _OF_PLAN}
    made = FloorPlan(**of_plan, state=state, room=room, walls=walls)
    return replace(place_map, plan=made, plan_edits=plan.edits, suggestions=plan.suggestions)


def _array(_: type, values: Iterable[Any]) -> FloatArray:
    """(…) finite numbers. Raises ValueError."""
    array = np.array(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError("a number of its floor plan is not finite")
    return array
