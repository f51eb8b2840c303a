"""Rooms keep who they are: each one of a plan takes id and name of the room of the plan before that it covers most.

Of a room that others were joined to, that is the part of it that it was before they were.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse_sim3, transform
from station.model.floor_plan import NO_ROOM, FloorPlan
from station.places.rooms.segments import Labels

NAME_PREFIX = "Room "


def inherited(
    labels: Labels,
    count: int,
    low: FloatArray,
    cell: float,
    R: FloatArray,
    previous: FloorPlan,
    T: FloatArray,
    middles: Mapping[str, FloatArray],
) -> dict[int, int]:
    """Number in `labels` (from 1 on) -> number in `previous.rooms`, one-to-one, the largest overlaps first.

    Args:
        T: (4, 4) carries the previous plan's map frame into this one's, and may be a similarity.
        middles: (2,) on this plan, by id: where rooms were before others joined them. What lies there goes before all.
    """
    shared = shared_cells(labels, count, low, cell, R, previous, T)
    for old, room in enumerate(previous.rooms):
        if (new := _label_at(labels, low, cell, middles.get(room.id))) and shared[new, old]:
            shared[new, old] += labels.size
    return one_to_one(shared)


def _label_at(labels: Labels, low: FloatArray, cell: float, xy: FloatArray | None) -> int:
    """0 outside of every room, and for nowhere."""
    if xy is None:
        return 0
    i, j = np.floor((xy - low) / cell).astype(np.int64).tolist()
    inside = 0 <= i < labels.shape[0] and 0 <= j < labels.shape[1]
    return int(labels[i, j]) if inside else 0


def one_to_one(shared: IntArray) -> dict[int, int]:
    """Row -> column, each once, the largest overlaps first; none where there is none."""
    taken: dict[int, int] = {}
    for flat in np.argsort(-shared, axis=None, kind="stable"):
        new, old = (int(k) for k in np.unravel_index(flat, shared.shape))
        if shared[new, old] == 0:
            break
        if new not in taken and old not in taken.values():
            taken[new] = old
    return taken


def shared_cells(
    labels: Labels, count: int, low: FloatArray, cell: float, R: FloatArray, previous: FloorPlan, T: FloatArray
) -> IntArray:
    """(count + 1, len(previous.rooms)) how many cells of each label lie in each room of the previous plan."""
    shared = np.zeros((count + 1, len(previous.rooms)), dtype=np.int64)
    index = np.argwhere(labels > 0)
    ground = np.column_stack([low + (index + 0.5) * cell, np.zeros(len(index))])
    there = previous.rooms_at(transform(inverse_sim3(T), ground @ R))
    both = there != NO_ROOM
    np.add.at(shared, (labels[tuple(index[both].T)], there[both]), 1)
    return shared


def new_id(navigation_id: str, number: int, others: Sequence[str]) -> str:
    """An id for a room that no plan had before."""
    for attempt in range(len(others) + 1):
        digest = hashlib.sha256(json.dumps([navigation_id, number, attempt]).encode()).hexdigest()[:12]
        if f"room-{digest}" not in others:
            return f"room-{digest}"
    raise AssertionError("more ids than rooms are taken")


def new_names(count: int, taken: Sequence[str]) -> list[str]:
    """The next numbers that no room has."""
    used = [name.removeprefix(NAME_PREFIX) for name in taken if name.startswith(NAME_PREFIX)]
    first = 1 + max([int(number) for number in used if number.isdecimal()], default=0)
    return [f"{NAME_PREFIX}{number}" for number in range(first, first + count)]
