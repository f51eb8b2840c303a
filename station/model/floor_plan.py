"""A floor plan: where it is free, what stands in the way, which part is which room, and the doors between them.

Everything lies on the ground: axes x and y of `R_ground_map` (z up), in map units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray

UNSEEN, FREE, OCCUPIED = 0, 1, 2
NO_ROOM = -1
MAX_EDITS = 500  # doors that were drawn or erased in one map
SuggestionSource = Literal["sticker", "door plate", "model", "other map"]  # a printed word is a "door plate" anywhere


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A part of free space behind doors."""

    id: str  # stable: survives a longer map, merges and another day
    name: str
    area: float  # square map units
    middle: FloatArray  # (2,) a free cell of it, far from its walls: where its name is written
    certainty: float = 1.0  # probability that it is one room, and all of it; 1 in plans from before it was known


@dataclass(frozen=True, slots=True, eq=False)
class Door:
    """A passage between two rooms, or out of the mapped part."""

    id: str
    rooms: tuple[str, str | None]  # ids; None: nobody went through
    ends: FloatArray  # (2, 2) rows: where its jambs are
    is_drawn: bool = False  # by a person

    @property
    def width(self) -> float:
        """Map units."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))


@dataclass(frozen=True, slots=True, eq=False)
class PlanEdits:
    """What people made of a plan; kept apart from it, so that it holds for every later one of the same home."""

    doors_drawn: tuple[FloatArray, ...] = ()  # (2, 2) each: a line that parts a room
    doors_erased: tuple[FloatArray, ...] = ()  # (2, 2) each: a door that is none; both sides are one room
    names: Mapping[str, str] = field(default_factory=dict)  # of rooms, by id
    middles: Mapping[str, FloatArray] = field(default_factory=dict)  # (2,) by id: of rooms before others joined them


@dataclass(frozen=True, slots=True, eq=False)
class NameSuggestion:
    """A name that something seen speaks for. A person accepts it, or nobody does."""

    room: str  # id
    name: str
    source: SuggestionSource
    confidence: float  # 0..1
    reason: str  # a sentence for a person
    keyframe_index: int | None = None  # of the map: the picture that shows it
    corners_px: FloatArray | None = None  # (4, 2) where in that picture
    p_map: FloatArray | None = None  # (3,) where what speaks for it is; None: the room does, or nobody noted it


@dataclass(frozen=True, slots=True, eq=False)
class FloorPlan:
    """One floor. Cell [i, j] begins at `low` + (i, j) * `cell`."""

    R_ground_map: FloatArray  # (3, 3)
    low: FloatArray  # (2,)
    cell: float  # map units
    unit: float  # map units per metre; a guess where the map's scale is arbitrary
    state: npt.NDArray[np.uint8]  # (X, Y) UNSEEN, FREE or OCCUPIED
    room: npt.NDArray[np.int16]  # (X, Y) number in `rooms`, or NO_ROOM
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    walls: FloatArray  # (W, 2, 2) line segments
    room_of_place: Mapping[str, str] = field(default_factory=dict)  # place id -> room id

    def rooms_at(self, p_map: FloatArray) -> npt.NDArray[np.int16]:
        """(n,) numbers in `rooms` at positions (n, 3) of the map; NO_ROOM outside of every room."""
        index = np.floor(((p_map @ self.R_ground_map.T)[:, :2] - self.low) / self.cell).astype(np.int64)
        inside = np.all((index >= 0) & (index < self.room.shape), axis=1)
        found = np.full(len(p_map), NO_ROOM, dtype=np.int16)
        found[inside] = self.room[tuple(index[inside].T)]
        return found
