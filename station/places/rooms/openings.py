"""What is a door: a narrow passage with wall on both its sides, seen from both sides of that wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.places.rooms.basins import Passage
from station.places.rooms.evidence import Ground
from station.places.space.space import Cells

SEARCH_M = 0.4  # a passage is cut this far before or behind its saddle at most
EQUAL_M = 0.1  # cuts that are so little longer are as good: the middle of them is taken
FLANK_M = 1.5  # of wall beside a passage is looked at
THIN_M = 0.45  # a wall, and what a camera beside it does not see through; furniture is deeper
SOLID_M = 0.3  # less than this beside a passage, and it leads around something that stands in the room
NARROW_M = 1.3  # a door; beyond, an opening in a wall
NARROW_WALL_M, WIDE_WALL_M = 0.3, 0.4  # thin wall beside it, on both its sides together
WIDE_SHARE = 0.78  # of the width of the narrower room: an opening in a wall leaves some of the wall


@dataclass(frozen=True, slots=True)
class Opening:
    """A passage, cut straight across. `axis` 0: the cut runs along y (j), 1: along x (i)."""

    axis: int
    at: int  # the cut's cell along `axis`
    begin: int  # its first and last free cell along the other axis
    end: int
    solid: tuple[int, int]  # cells of what is not free beside both ends, in line with the cut
    wall: int  # cells of thin wall among them

    @property
    def width(self) -> int:
        return self.end - self.begin + 1


def cut_across(free: Cells, passage: Passage, ground: Ground) -> Opening:
    """The shortest straight cut through a passage, along either axis."""
    cuts = [_shortest(free if axis == 0 else free.T, passage, axis, ground) for axis in (0, 1)]
    return min(cuts, key=lambda cut: cut.width)


def is_door(opening: Opening, clearance: float, ground: Ground) -> bool:
    """Whether rooms end here; `clearance` (cells): the largest of the narrower one of the two."""
    if min(opening.solid) < ground.metres(SOLID_M):
        return False
    if opening.width <= ground.metres(NARROW_M):
        return opening.wall >= ground.metres(NARROW_WALL_M)
    return opening.wall >= ground.metres(WIDE_WALL_M) and opening.width <= WIDE_SHARE * 2 * clearance


def _shortest(free: Cells, passage: Passage, axis: int, ground: Ground) -> Opening:
    at, along = passage.at if axis == 0 else passage.at[::-1]
    reach = round(ground.metres(SEARCH_M))
    rows = [row for row in range(max(at - reach, 0), min(at + reach + 1, len(free))) if free[row, along]]
    ends = {row: _run(free[row], along) for row in rows}
    shortest = min(end - begin for begin, end in ends.values())
    good = [row for row in rows if ends[row][1] - ends[row][0] <= shortest + ground.metres(EQUAL_M)]
    middle = min(good, key=lambda row: (abs(row - np.mean(good)), row))
    begin, end = ends[middle]
    before, behind = (_flank(free, middle, edge, step, ground) for edge, step in ((begin, -1), (end, 1)))
    return Opening(axis, middle, begin, end, (before[0], behind[0]), before[1] + behind[1])


def _run(row: Cells, at: int) -> tuple[int, int]:
    """First and last cell of the free run that holds this one."""
    taken = np.flatnonzero(~row)
    left, right = taken[taken < at], taken[taken > at]
    return (int(left[-1]) + 1 if len(left) else 0), (int(right[0]) - 1 if len(right) else len(row) - 1)


def _flank(free: Cells, row: int, edge: int, step: int, ground: Ground) -> tuple[int, int]:
    """Cells in line with the cut, from its edge on, until it is free again, and how many of them are of a thin wall."""
    most, thin = round(ground.metres(FLANK_M)), ground.metres(THIN_M)
    columns = edge + step * np.arange(1, most + 1)
    columns = columns[(columns >= 0) & (columns < free.shape[1])]
    is_free = free[row, columns]
    columns = columns[: int(np.argmax(is_free))] if is_free.any() else columns
    reach = int(np.ceil(thin)) + 1
    window = free[max(row - reach, 0) : row + reach + 1, columns]
    middle = row - max(row - reach, 0)
    above = np.argmax(window[middle::-1], axis=0)
    below = np.argmax(window[middle:], axis=0)
    is_bounded = window[: middle + 1].any(axis=0) & window[middle:].any(axis=0)
    return len(columns), int(np.count_nonzero(is_bounded & (above + below - 1 <= thin)))
