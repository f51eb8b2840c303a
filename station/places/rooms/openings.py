"""What is a door: where the free space narrows between two parts that are rooms each, and walls show beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.places.rooms.basins import Passage
from station.places.rooms.evidence import Ground
from station.places.space.space import Cells

SEARCH_M = 0.4  # a passage is cut this far before or behind its saddle at most
EQUAL_M = 0.1  # cuts that are so little longer are as good: the middle of them is taken
FLANK_M = 1.0  # of wall beside a passage is looked at
OFF_LINE_M = 0.15  # a wall is looked for so far from the line of the cut
THIN_M = 0.45  # a wall, and what a camera beside it does not see through; furniture is deeper
# A door, and an opening in a wall, which leaves some of the wall: widths, and shares of the narrower room's width.
DOOR_M, DOOR_SHARE = (0.45, 1.3), 0.75
OPENING_SHARE = 0.78
WALL_M = 0.3  # of thin wall beside a passage, seen from both its sides: furniture has no such back
MARKED_M = 0.2  # of what is beside a door must show landmarks; else nobody knows what narrows the passage


@dataclass(frozen=True, slots=True)
class Opening:
    """A passage, cut straight across. `axis` 0: the cut runs along y (j), 1: along x (i)."""

    axis: int
    at: int  # the cut's cell along `axis`
    begin: int  # its first and last free cell along the other axis
    end: int
    wall: int  # cells of thin wall beside both ends, in line with the cut
    marked: int  # cells there with landmarks

    @property
    def width(self) -> int:
        return self.end - self.begin + 1


def cut_across(free: Cells, standing: Cells, passage: Passage, ground: Ground) -> Opening:
    """The shortest straight cut through a passage, along either axis. `standing`: cells with landmarks."""
    cuts = [_shortest(free, standing, passage, axis, ground) for axis in (0, 1)]
    return min(cuts, key=lambda cut: cut.width)


def is_door(opening: Opening, clearance: float, ground: Ground) -> bool:
    """Whether rooms end here; `clearance` (cells): the largest of the narrower one of the two."""
    if opening.marked < ground.metres(MARKED_M):
        return False
    share = opening.width / (2 * clearance)
    has_wall = opening.wall >= ground.metres(WALL_M)
    if opening.width > ground.metres(DOOR_M[1]):
        return has_wall and share <= OPENING_SHARE
    return opening.width >= ground.metres(DOOR_M[0]) and (has_wall or share <= DOOR_SHARE)


def _shortest(free: Cells, standing: Cells, passage: Passage, axis: int, ground: Ground) -> Opening:
    free, standing = (free, standing) if axis == 0 else (free.T, standing.T)
    at, along = passage.at if axis == 0 else passage.at[::-1]
    reach = round(ground.metres(SEARCH_M))
    rows = [row for row in range(max(at - reach, 0), min(at + reach + 1, len(free))) if free[row, along]]
    ends = {row: _run(free[row], along) for row in rows}
    shortest = min(end - begin for begin, end in ends.values())
    good = [row for row in rows if ends[row][1] - ends[row][0] <= shortest + ground.metres(EQUAL_M)]
    middle = min(good, key=lambda row: (abs(row - np.mean(good)), row))
    begin, end = ends[middle]
    beside = np.concatenate([edge + step * _steps(ground) for edge, step in ((begin, -1), (end, 1))])
    beside = beside[(beside >= 0) & (beside < free.shape[1])]
    wall = int(np.count_nonzero(_is_thin(free[:, beside], middle, ground)))
    off = round(ground.metres(OFF_LINE_M)) + 1
    marked = int(np.count_nonzero(standing[max(middle - off, 0) : middle + off + 1, beside].any(axis=0)))
    return Opening(axis, middle, begin, end, wall, marked)


def _steps(ground: Ground) -> np.ndarray:
    return np.arange(1, round(ground.metres(FLANK_M)) + 1)


def _run(row: Cells, at: int) -> tuple[int, int]:
    """First and last cell of the free run that holds this one."""
    taken = np.flatnonzero(~row)
    left, right = taken[taken < at], taken[taken > at]
    return (int(left[-1]) + 1 if len(left) else 0), (int(right[0]) - 1 if len(right) else len(row) - 1)


def _is_thin(columns: Cells, row: int, ground: Ground) -> Cells:
    """(n,) whether something thin crosses each column (X, n) near this row, with free space before and behind it."""
    off, thin = round(ground.metres(OFF_LINE_M)), round(ground.metres(THIN_M))
    window = columns[max(row - off - thin, 0) : row + off + thin + 1]
    first = max(row - off, 0) - max(row - off - thin, 0)
    near = ~window[first : first + 2 * off + 1]
    found = np.zeros(columns.shape[1], dtype=np.bool_)
    for k in np.flatnonzero(near.any(axis=0)):
        free = np.flatnonzero(window[:, k])
        at = first + int(np.argmax(near[:, k]))
        before, behind = free[free < at], free[free > at]
        found[k] = len(before) > 0 and len(behind) > 0 and behind[0] - before[-1] - 1 <= thin
    return found
