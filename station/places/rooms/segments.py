"""Free space parted into rooms: basins that no door parts are one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from shared.geometry import FloatArray
from station.places.rooms.basins import Basins, Labels, Passage, find_basins
from station.places.rooms.evidence import Ground
from station.places.rooms.openings import Opening, cut_across, is_door
from station.places.space.space import Cells

NARROWEST_M = 0.3  # half the width of what can be a room, or a corridor
SMALLEST_M2 = 1.0  # a smaller room is none: a doorway between two doors
LINE_M = 0.15  # a drawn line parts this much free space


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """A door between two parts of the free space."""

    a: int
    b: int
    ends: FloatArray  # (2, 2) on the ground
    is_drawn: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    labels: Labels  # (X, Y) 1 to `count`, 0 elsewhere
    count: int
    gates: tuple[Gate, ...]


def part_rooms(ground: Ground, drawn: Sequence[FloatArray], erased: Sequence[FloatArray]) -> Segments:
    """Rooms that were entered; lines (2, 2) drawn by a person part them, doors erased by a person do not."""
    free = ground.free.copy()
    lines = [_line_cells(ground, line) for line in drawn]
    for cells in lines:
        free[cells] = False
    basins = find_basins(free, ground.metres(NARROWEST_M))
    groups = _Groups(basins, ground)
    open_ends: list[tuple[Passage, Opening]] = []
    for passage in basins.passages:
        opening = cut_across(free, passage, ground)
        is_erased = any(_is_same(ground, opening, line) for line in erased)
        if is_erased or not is_door(opening, groups.narrower(passage), ground):
            groups.join(passage.a, passage.b)
        else:
            open_ends.append((passage, opening))
    for passage, _ in open_ends:
        if min(groups.size(passage.a), groups.size(passage.b)) < SMALLEST_M2 * ground.metres(1.0) ** 2:
            groups.join(passage.a, passage.b)
    labels, number = groups.entered()
    gates = [
        _gate(number[groups.of(p.a)], number[groups.of(p.b)], cut_ends(ground, opening))
        for p, opening in open_ends
        if groups.of(p.a) != groups.of(p.b)
    ]
    gates += [gate for line, cells in zip(drawn, lines, strict=True) for gate in _drawn_gate(labels, line, cells)]
    return Segments(labels, max(number.values(), default=0), tuple(_without_repeats(gates)))


class _Groups:
    """Which basins are one room so far."""

    def __init__(self, basins: Basins, ground: Ground) -> None:
        self._basins, self._ground = basins, ground
        count = int(basins.labels.max(initial=0)) + 1
        self._parent = list(range(count))
        flat = basins.labels.ravel()
        self._size = np.bincount(flat, minlength=count)
        self._clearance = np.zeros(count)
        np.maximum.at(self._clearance, flat, basins.clearance.ravel())

    def of(self, basin: int) -> int:
        while self._parent[basin] != basin:
            self._parent[basin] = self._parent[self._parent[basin]]
            basin = self._parent[basin]
        return basin

    def join(self, a: int, b: int) -> None:
        a, b = sorted((self.of(a), self.of(b)))
        if a != b:
            self._parent[b] = a
            self._size[a] += self._size[b]
            self._clearance[a] = max(self._clearance[a], self._clearance[b])

    def size(self, basin: int) -> int:
        return int(self._size[self.of(basin)])

    def narrower(self, passage: Passage) -> float:
        return float(min(self._clearance[self.of(passage.a)], self._clearance[self.of(passage.b)]))

    def entered(self) -> tuple[Labels, dict[int, int]]:
        """Labels in the order in which the body first came, and each group's number; 0: nobody was there."""
        group = np.array([self.of(k) for k in range(len(self._parent))], dtype=np.int32)
        of_cell = group[self._basins.labels]
        visits = self._ground.visits
        visits = visits[np.all((visits >= 0) & (visits < of_cell.shape), axis=1)]
        met = of_cell[tuple(visits.T)]
        order = dict.fromkeys(met[met > 0].tolist())
        number = dict.fromkeys(set(group.tolist()), 0) | {g: k for k, g in enumerate(order, start=1)}
        table = np.array([number[g] if k else 0 for k, g in enumerate(group.tolist())], dtype=np.int32)
        return table[self._basins.labels], number


def _gate(a: int, b: int, ends: FloatArray) -> Gate:
    """The part that nobody entered, 0, comes last."""
    return Gate(min(a, b), max(a, b), ends) if min(a, b) else Gate(max(a, b), 0, ends)


def cut_ends(ground: Ground, opening: Opening) -> FloatArray:
    """(2, 2) the jambs of an opening, on the ground."""
    across = opening.at + 0.5
    ends = np.array([[across, opening.begin], [across, opening.end + 1.0]])
    return ground.low + ground.cell * (ends if opening.axis == 0 else ends[:, ::-1])


def _line_cells(ground: Ground, line: FloatArray) -> Cells:
    """Cells within half of LINE_M of a line."""
    x, y = (ground.low[k] + (np.arange(ground.free.shape[k]) + 0.5) * ground.cell for k in range(2))
    p = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1) - line[0]
    d = line[1] - line[0]
    length = max(float(d @ d), 1e-12)
    nearest = np.clip((p @ d) / length, 0.0, 1.0)
    return np.asarray(np.hypot(*np.moveaxis(p - nearest[..., None] * d, -1, 0)) <= 0.5 * LINE_M * ground.unit)


def _is_same(ground: Ground, opening: Opening, line: FloatArray) -> bool:
    """Whether this is the door that a person erased: their middles are nearer than half the door's width."""
    ends = cut_ends(ground, opening)
    apart = np.linalg.norm(ends.mean(axis=0) - line.mean(axis=0))
    return bool(apart <= 0.5 * max(np.linalg.norm(ends[1] - ends[0]), np.linalg.norm(line[1] - line[0])))


def _drawn_gate(labels: Labels, line: FloatArray, cells: Cells) -> list[Gate]:
    """The drawn line as a door between what lies on both its sides; none where that is one room still."""
    beside = ndimage.binary_dilation(cells, np.ones((3, 3)), iterations=2) & (labels > 0)
    met = np.bincount(labels[beside])
    met[:1] = 0
    both = np.argsort(-met, kind="stable")[:2]
    if len(both) < 2 or met[both[1]] == 0:
        return []
    a, b = sorted(both.tolist())
    return [Gate(a, b, line, is_drawn=True)]


def _without_repeats(gates: Sequence[Gate]) -> list[Gate]:
    """Two cuts through one doorway are one door: the narrower. A door between two parts nobody entered is none."""
    kept: list[Gate] = []
    for gate in sorted(gates, key=lambda g: (not g.is_drawn, float(np.linalg.norm(g.ends[1] - g.ends[0])))):
        if gate.a == gate.b:
            continue
        near = [
            other
            for other in kept
            if {other.a, other.b} == {gate.a, gate.b}
            and np.linalg.norm(other.ends.mean(axis=0) - gate.ends.mean(axis=0))
            < np.linalg.norm(gate.ends[1] - gate.ends[0])
        ]
        if not near:
            kept.append(gate)
    return kept
