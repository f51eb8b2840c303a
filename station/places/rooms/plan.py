"""A navigation and its places -> a floor plan: free space, the rooms it falls into, their doors and walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from shared.geometry import FloatArray, rotation_of, transform, yaw_rotation
from station.model.floor_plan import NO_ROOM, Door, FloorPlan, PlanEdits, Room
from station.model.navigation import Navigation
from station.model.place_map import Place
from station.places.making.scale import ground_rotation
from station.places.rooms.axes import plan_axes, turn_to_walls
from station.places.rooms.belonging import rooms_of_places
from station.places.rooms.evidence import Ground, gather_evidence
from station.places.rooms.feet import with_feet
from station.places.rooms.identity import inherited, new_id, new_names
from station.places.rooms.segments import Gate, Labels, Segments, part_rooms
from station.places.rooms.surfaces import Seen, Surfaces, find_surfaces
from station.places.rooms.wall_model import WallModel, wall_model

NO_EDITS = PlanEdits()


def make_floor_plan(
    navigation: Navigation,
    places: Sequence[Place],
    edits: PlanEdits = NO_EDITS,
    previous: FloorPlan | None = None,
    T_map_previous: FloatArray | None = None,
) -> FloorPlan:
    """The plan of what this navigation saw; the same for the same arguments, and without rooms where it saw nothing.

    Args:
        edits: what people made of the plan, in the axes of `previous`, or of this plan where there is none before.
        previous: an earlier plan of the same home: its rooms keep their ids and names, and its axes stay.
        T_map_previous: (4, 4) carries the earlier plan's map frame into this one's, maybe with a scale; None: the same.
    """
    R = _axes(navigation, previous, T_map_previous)
    return plan_along(R, navigation, places, wall_model(), edits, previous, T_map_previous)


def plan_along(
    R_ground_map: FloatArray,
    navigation: Navigation,
    places: Sequence[Place],
    model: WallModel,
    edits: PlanEdits = NO_EDITS,
    previous: FloorPlan | None = None,
    T_map_previous: FloatArray | None = None,
) -> FloorPlan:
    """`make_floor_plan` where the axes (3, 3) and what walls look like are given."""
    R, T = R_ground_map, np.eye(4) if T_map_previous is None else T_map_previous
    ground = gather_evidence(navigation, R)
    drawn, erased = (_carried(lines, R, previous, T_map_previous) for lines in (edits.doors_drawn, edits.doors_erased))
    segments = part_rooms(ground, gathered_surfaces(navigation, R), model, drawn, erased)
    labels = segments.labels
    rooms = _rooms(ground, segments, navigation.id, edits, previous, T)
    plan = FloorPlan(
        R_ground_map=R,
        low=ground.low,
        cell=ground.cell,
        unit=ground.unit,
        state=ground.state,
        room=(labels + NO_ROOM).astype(np.int16),
        rooms=rooms,
        doors=tuple(_door(gate, rooms) for gate in segments.gates),
        walls=segments.walls,
    )
    return replace(plan, room_of_place=rooms_of_places(plan, navigation, places))


def gathered_surfaces(navigation: Navigation, R_ground_map: FloatArray) -> Surfaces | None:
    """All that says where walls are, in these axes (3, 3); None where nothing does."""
    surfaces = find_surfaces(Seen.of(navigation, R_ground_map))
    return None if surfaces is None else with_feet(surfaces, navigation, R_ground_map)


def _axes(navigation: Navigation, previous: FloorPlan | None, T: FloatArray | None) -> FloatArray:
    """R_ground_map (3, 3): along the walls, and turned as the previous plan is."""
    if previous is not None:
        return previous.R_ground_map if T is None else previous.R_ground_map @ rotation_of(T).T
    level = ground_rotation(navigation)
    p = navigation.landmarks.p_world
    R = plan_axes(level, p[np.isfinite(p).all(axis=1)], 1.0)
    return yaw_rotation(turn_to_walls(Seen.of(navigation, R), wall_model())) @ R


def _carried(
    lines: Sequence[FloatArray], R: FloatArray, previous: FloorPlan | None, T: FloatArray | None
) -> list[FloatArray]:
    """Lines (n, 2) of the previous plan in this one's axes."""
    if previous is None or T is None:
        return list(lines)
    before = previous.R_ground_map
    return [(transform(T, np.column_stack([line, np.zeros(len(line))]) @ before) @ R.T)[:, :2] for line in lines]


def _rooms(
    ground: Ground,
    segments: Segments,
    navigation_id: str,
    edits: PlanEdits,
    previous: FloorPlan | None,
    T: FloatArray,
) -> tuple[Room, ...]:
    labels, count = segments.labels, segments.count
    before = () if previous is None else previous.rooms
    same = {}
    if previous is not None:
        R = ground.R_ground_map
        carried = _carried([xy[None] for xy in edits.middles.values()], R, previous, T)
        middles = {room_id: xy[0] for room_id, xy in zip(edits.middles, carried, strict=True)}
        same = inherited(labels, count, ground.low, ground.cell, R, previous, T, middles)
    taken = [room.id for room in before]
    names = iter(new_names(count, [room.name for room in before] + list(edits.names.values())))
    rooms: list[Room] = []
    for number in range(1, count + 1):
        cells = labels == number
        if number in same:
            room_id, name = before[same[number]].id, before[same[number]].name
        else:
            room_id, name = new_id(navigation_id, number, taken), next(names)
            taken.append(room_id)
        name = edits.names.get(room_id, name)
        area, certainty = float(cells.sum()) * ground.cell**2, segments.certainty[number - 1]
        rooms.append(Room(room_id, name, area, _middle(ground, cells), certainty))
    return tuple(rooms)


def _middle(ground: Ground, cells: Labels) -> FloatArray:
    """(2,) the free cell of a room that is farthest from what is not the room."""
    padded = np.pad(cells, 1)
    inside = ndimage.distance_transform_edt(padded)[1:-1, 1:-1]
    inside[~ground.free] *= 0.01  # where furniture fills a room, its widest part is better than none
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    return np.asarray(ground.low + (np.array(at) + 0.5) * ground.cell)


def _door(gate: Gate, rooms: Sequence[Room]) -> Door:
    a, b = rooms[gate.a - 1].id, rooms[gate.b - 1].id if gate.b else None
    x, y = gate.ends.mean(axis=0)
    pair = "-".join(word.removeprefix("room-") for word in (a, b or "out"))
    return Door(f"door-{pair}-{x:.1f},{y:.1f}", (a, b), gate.ends, gate.is_drawn)
