"""A room up to its walls: furniture hides much of them, but where a wall shows between two pieces it goes on behind.

Each of a room's four sides is a line that runs along it and may step in or out. Which of the lines that landmarks form,
and where it steps, is the cheapest path through the rows of the grid (Viterbi): free space of the room beyond the side
is dear, space of another room within it dearer, space that nobody saw is cheap, landmarks on the side are worth
something, and every step costs as much as half a square metre or so. So the side passes behind a cupboard and along a
niche, and follows the corner of an L.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray
from station.places.rooms.basins import Labels
from station.places.rooms.evidence import Ground
from station.places.space.space import Cells

BEHIND_M = 1.1  # a wall may lie so far behind what was seen to be free: behind a bed or a kitchen row
BESIDE_M = 0.3  # a landmark counts for a side from so far along it
LINE_BIN_M = 0.05
LINE_LANDMARKS = 6  # fewer in line make no wall
# Prices of a side, per square metre, metre and step.
LEFT_OUT = 4.0  # free space of the room that lies beyond its side
FOREIGN = 8.0  # space of another room within it
NEVER_SEEN = 0.5
ON_LINE = 0.35  # gained along landmarks
STEP = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A room's cells, and its walls as segments on the ground."""

    cells: Cells
    walls: FloatArray  # (W, 2, 2)


def outline_rooms(ground: Ground, labels: Labels, count: int) -> tuple[Labels, FloatArray]:
    """Labels of whole rooms, furniture and all, and the walls (W, 2, 2) around them."""
    outlines = [_outline(ground, labels, number) for number in range(1, count + 1)]
    out = labels.copy()
    claims = np.zeros(labels.shape, dtype=np.int32)
    for outline in outlines:
        claims += outline.cells
    for number, outline in enumerate(outlines, start=1):
        out[outline.cells & (claims == 1) & (labels == 0)] = number
    contested = (claims > 1) & (labels == 0)
    if contested.any():
        nearest = ndimage.distance_transform_edt(out == 0, return_distances=False, return_indices=True)
        out[contested] = out[tuple(nearest[:, contested])]
    walls = [outline.walls for outline in outlines if len(outline.walls)]
    return out, np.concatenate(walls) if walls else np.zeros((0, 2, 2))


def _outline(ground: Ground, labels: Labels, number: int) -> Outline:
    own = labels == number
    window = _window(own, round(ground.metres(BEHIND_M)) + 2)
    mine, foreign = own[window], (labels[window] > 0) & ~own[window]
    low = ground.low + ground.cell * np.array([s.start for s in window])
    marks = (ground.standing - low) / ground.cell  # cells from the window's corner
    marks = marks[np.all((marks >= 0) & (marks < mine.shape), axis=1)]
    marks = _seen_from(marks, mine, foreign)
    inside, walls = np.ones(mine.shape, dtype=np.bool_), []
    for axis in (0, 1):
        m, f = (mine, foreign) if axis == 0 else (mine.T, foreign.T)
        p = marks if axis == 0 else marks[:, ::-1]
        middle = np.arange(m.shape[0]) + 0.5
        sides = []
        for sign in (-1, 1):
            # The far side is the near one of the mirrored room.
            mirrored = (m, f, p) if sign < 0 else (m[::-1], f[::-1], np.column_stack([len(m) - p[:, 0], p[:, 1]]))
            side = _side(*mirrored, ground)
            sides.append(side if sign < 0 else len(m) - side)
        within = (middle[:, None] >= sides[0]) & (middle[:, None] <= sides[1])
        inside &= within if axis == 0 else within.T
        walls.append((axis, sides))
    cells = np.zeros(labels.shape, dtype=np.bool_)
    cells[window] = inside & ~foreign
    segments = [
        segment
        for axis, sides in walls
        for side in sides
        for segment in _segments(side, inside if axis == 0 else inside.T, axis)
    ]
    return Outline(cells, low + ground.cell * np.array(segments).reshape(-1, 2, 2))


def _window(own: Cells, margin: int) -> tuple[slice, slice]:
    spans = []
    for axis in (0, 1):
        found = np.flatnonzero(own.any(axis=1 - axis))
        spans.append(slice(max(int(found[0]) - margin, 0), min(int(found[-1]) + margin + 1, own.shape[axis])))
    return spans[0], spans[1]


def _seen_from(marks: FloatArray, mine: Cells, foreign: Cells) -> FloatArray:
    """The landmarks nearer to this room's free space than to another's."""
    if not foreign.any() or not len(marks):
        return marks
    index = tuple(marks.astype(np.int64).T)
    to_mine, to_foreign = ndimage.distance_transform_edt(~mine)[index], ndimage.distance_transform_edt(~foreign)[index]
    return np.asarray(marks[to_mine <= to_foreign])


def _side(mine: Cells, foreign: Cells, marks: FloatArray, ground: Ground) -> FloatArray:
    """(Y,) where the room ends towards x = 0 in each column of the window, in cells."""
    lines = _lines(mine, marks, ground)
    extent = np.where(mine.any(axis=0), mine.argmax(axis=0), -1)
    cost = np.zeros((len(lines), mine.shape[1]))
    cell_m = ground.cell / ground.unit
    before = np.concatenate([np.zeros((1, mine.shape[1])), np.cumsum(mine, axis=0)])
    others = np.concatenate([np.zeros((1, mine.shape[1])), np.cumsum(foreign, axis=0)])
    has = extent >= 0
    columns = np.flatnonzero(has)
    for k, line in enumerate(lines):
        at = int(np.clip(round(line), 0, len(mine)))
        left_out = before[at]  # free cells of the room on the wrong side
        hidden = np.zeros(mine.shape[1])
        hidden[columns] = np.maximum(extent[columns] - at, 0)
        strange = np.zeros(mine.shape[1])
        ends = np.maximum(extent[columns], at)
        strange[columns] = others[ends, columns] - others[at, columns]
        cost[k] = cell_m**2 * (LEFT_OUT * left_out + NEVER_SEEN * hidden + FOREIGN * strange)
    cost -= cell_m * ON_LINE * _support(lines, marks, mine.shape[1], ground)
    first, last = int(columns[0]), int(columns[-1]) + 1
    path = _cheapest(cost[:, first:last], STEP)
    side = np.empty(mine.shape[1])
    side[first:last] = lines[path]
    side[:first], side[last:] = side[first], side[last - 1]
    return side


def _lines(mine: Cells, marks: FloatArray, ground: Ground) -> FloatArray:
    """Where the side may run: where landmarks line up, and where the free space ends, so that there is always one."""
    extents = mine.argmax(axis=0)[mine.any(axis=0)]
    nearest, farthest = float(extents.min()) - ground.metres(BEHIND_M), float(np.percentile(extents, 90)) + 2.0
    x = marks[(marks[:, 0] >= nearest) & (marks[:, 0] <= farthest + ground.metres(0.2)), 0]
    found = [float(np.percentile(extents, q)) for q in (5, 50)]
    width = ground.metres(LINE_BIN_M)
    if len(x):
        bins = np.floor(x / width).astype(np.int64)
        count = np.bincount(bins, minlength=int(bins.max()) + 2)
        three = np.convolve(count, np.ones(3), "same")
        peak = (three >= LINE_LANDMARKS) & (three == ndimage.maximum_filter1d(three, 3))
        for b in np.flatnonzero(peak):
            near = x[np.abs(bins - b) <= 1]
            found.append(float(np.median(near)))
    return np.unique(np.round(found, 2))


def _support(lines: FloatArray, marks: FloatArray, width: int, ground: Ground) -> npt.NDArray[np.float64]:
    """(L, Y) whether landmarks lie on a line, there or a little beside."""
    out = np.zeros((len(lines), width))
    beside = 2 * round(ground.metres(BESIDE_M)) + 1
    for k, line in enumerate(lines):
        near = marks[np.abs(marks[:, 0] - line) <= ground.metres(0.06), 1].astype(np.int64)
        count = np.bincount(near[near < width], minlength=width)[:width]
        out[k] = ndimage.uniform_filter1d(count.astype(np.float64), beside) * beside >= 2.5
    return out


def _cheapest(cost: npt.NDArray[np.float64], step: float) -> npt.NDArray[np.int64]:
    """(Y,) the row of each column on the cheapest path through (L, Y); every change of rows costs a step."""
    total, back = cost[:, 0].copy(), []
    for column in cost.T[1:]:
        best = int(np.argmin(total))
        changes = total[best] + step < total
        back.append(np.where(changes, best, np.arange(len(total))))
        total = np.where(changes, total[best] + step, total) + column
    path = [int(np.argmin(total))]
    for came in reversed(back):
        path.append(int(came[path[-1]]))
    return np.array(path[::-1], dtype=np.int64)


def _segments(side: FloatArray, inside: Cells, axis: int) -> list[list[list[float]]]:
    """The straight parts of a side where the room is behind it, in cells of the window."""
    row = np.clip(np.floor(side).astype(np.int64), 0, len(inside) - 1)
    columns = np.arange(inside.shape[1])
    touches = np.zeros(inside.shape[1], dtype=np.bool_)
    for d in (-1, 0, 1):
        touches |= inside[np.clip(row + d, 0, len(inside) - 1), columns]
    found, begin = [], 0
    for end in range(1, len(side) + 1):
        if end == len(side) or side[end] != side[begin] or touches[end] != touches[begin]:
            if touches[begin] and end - begin >= 2:
                a, b = [float(side[begin]), float(begin)], [float(side[begin]), float(end)]
                found.append([a, b] if axis == 0 else [a[::-1], b[::-1]])
            begin = end
    return found
