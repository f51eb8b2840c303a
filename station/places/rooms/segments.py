"""Free space parted into rooms: rectangles that no wall parts are one, and so are those whose door a person erased."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray
from station.places.rooms.borders import Exit, Passage, find_borders, find_exits, rectangles_at, walls_of
from station.places.rooms.evidence import Ground
from station.places.rooms.lengths import DOOR_M
from station.places.rooms.rectangles import Rectangle, find_rectangles
from station.places.rooms.sides import Sides, weigh_sides
from station.places.rooms.standing import standing_sides
from station.places.rooms.surfaces import PIECE_M, SIDES, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells, distance_to

Labels = npt.NDArray[np.int32]  # (X, Y) 0: no room
DRAWN_M = 0.15  # a drawn line parts this much free space
DOOR_MIDDLE_M = 0.5 * sum(DOOR_M)  # the width of a door that the body passed and nobody saw


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """A door between two rooms, by their labels; 0 is none: what nobody went into."""

    a: int
    b: int
    ends: FloatArray  # (2, 2) on the ground, map units
    is_drawn: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    labels: Labels  # (X, Y) 1 to `count`, 0 elsewhere
    count: int
    gates: tuple[Gate, ...]
    walls: FloatArray  # (W, 2, 2) on the ground, map units
    certainty: tuple[float, ...]  # of each label from 1 on: that it is one room, and all of it


def part_rooms(
    ground: Ground,
    surfaces: Surfaces | None,
    model: WallModel,
    drawn: Sequence[FloatArray],
    erased: Sequence[FloatArray],
) -> Segments:
    """Rooms that were entered; lines (2, 2) drawn by a person part them, doors erased by a person do not."""
    layout = _lay_out(surfaces, model)
    is_erased = [any(_is_same(p.ends * ground.unit, line) for line in erased) for p in layout.passages]
    gone = [(p.a, p.b) for p, is_none in zip(layout.passages, is_erased, strict=True) if is_none]
    room_of = _rooms_of(len(layout.edges), [*layout.joined, *gone])
    grid = (ground.low, ground.cell, ground.unit, ground.free.shape)
    lines = [line_cells(line, *grid) for line in drawn]
    exits = [e for e in layout.exits if not any(_is_same(e.ends * ground.unit, line) for line in erased)]
    known = ground.space.ending_at(e.ends * ground.unit for e in exits).known
    parted = parted_along(_labels(ground, known, layout.edges, room_of), lines)
    number = _in_order_of_entering(ground, parted)
    labels, count = number[parted], int(number.max(initial=0))
    gates = [_gate_of(labels, ground, p) for p in layout.passages if room_of[p.a] != room_of[p.b]]
    gates += [_exit_gate(labels, ground, e) for e in exits]
    gates += [gate for line, cells in zip(drawn, lines, strict=True) for gate in _drawn_gate(labels, line, cells)]
    found = _without_repeats([gate for gate in gates if gate is not None])
    certainty = np.ones(count)  # what a person drew is sure
    for label, lead in _leads(layout, room_of).items():
        if label < len(number) and number[label]:
            certainty[number[label] - 1] = 1.0 / (1.0 + np.exp(-lead / model.lead))
    return Segments(labels, count, tuple(found), layout.walls * ground.unit, tuple(certainty.tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Rectangles, and what lies between them. Lengths are metres on the ground."""

    edges: FloatArray  # (n, 4) of the rectangles
    joined: tuple[tuple[int, int], ...]  # pairs that nothing parts
    passages: tuple[Passage, ...]
    exits: tuple[Exit, ...]
    leads: tuple[tuple[int, float], ...]  # nats: of what was decided about a rectangle before the contrary
    walls: FloatArray  # (W, 2, 2)


def _lay_out(surfaces: Surfaces | None, model: WallModel) -> _Layout:
    """The likeliest rectangles; none without evidence."""
    if surfaces is None:
        return _Layout(np.zeros((0, 4)), (), (), (), (), np.zeros((0, 2, 2)))
    sides = weigh_sides(surfaces, model)
    packed = find_rectangles(surfaces, sides, model)
    edges = standing_sides(packed.rectangles, surfaces, sides, model)
    borders = find_borders(packed.rectangles, edges, surfaces, sides, model)
    unseen = _passed_unseen(surfaces, sides, packed.rectangles, edges, borders.passages)
    passages = (*borders.passages, *unseen)
    leads = (*enumerate(packed.lead), *((k, lead) for pair, lead in borders.lead.items() for k in pair))
    walls = walls_of(packed.rectangles, edges, surfaces, sides, borders.joined)
    exits = find_exits(packed.rectangles, edges, surfaces, sides, model)
    return _Layout(edges, borders.joined, passages, exits, leads, walls)


def _leads(layout: _Layout, room_of: Sequence[int]) -> dict[int, float]:
    """Label of each room as `_labels` gives them -> nats: the least lead of all that was decided about it."""
    if not len(layout.edges):
        return {1: 0.0}  # one room for want of evidence
    least: dict[int, float] = {}
    for k, lead in layout.leads:
        label = room_of[k] + 1
        least[label] = min(least.get(label, np.inf), lead)
    return least


def _passed_unseen(
    surfaces: Surfaces, sides: Sides, rectangles: Sequence[Rectangle], edges: FloatArray, known: Sequence[Passage]
) -> list[Passage]:
    """Where the body went from one rectangle into another and no border shows a gap: it passed all the same.

    What lies between them is thicker than a wall, since furniture hides one face of it. The door is in the other.
    """
    path = surfaces.seen.path
    at = rectangles_at(edges, path)
    inside = np.flatnonzero(at >= 0)
    pairs = {frozenset((p.a, p.b)) for p in known}
    found = []
    for begin, end in itertools.pairwise(inside.tolist()):
        a, b = int(at[begin]), int(at[end])
        if a != b and frozenset((a, b)) not in pairs:
            pairs.add(frozenset((a, b)))
            ways = ((a, path[begin : begin + 2]), (b, path[[end, end - 1]]))
            _, ends = max(
                (_crossed_wall(surfaces, sides, rectangles[r], edges[r], *way) for r, way in ways), key=lambda w: w[0]
            )
            found.append(Passage(a, b, ends))
    return found


def _crossed_wall(
    surfaces: Surfaces, sides: Sides, r: Rectangle, its_edges: FloatArray, inner: FloatArray, outer: FloatArray
) -> tuple[float, FloatArray]:
    """Nats for a wall beside where the body crossed a side of a rectangle, and a door there (2, 2) m."""
    beyond = [sign * (its_edges[k] - outer[axis]) for k, (axis, sign) in enumerate(SIDES)]
    k = int(np.argmax(beyond))
    axis, _ = SIDES[k]
    step = outer[axis] - inner[axis]
    share = 0.0 if step == 0.0 else float(np.clip((its_edges[k] - inner[axis]) / step, 0.0, 1.0))
    middle = inner + share * (outer - inner)
    middle[axis] = its_edges[k]
    along = np.array([0.0, 0.5 * DOOR_MIDDLE_M] if axis == 0 else [0.5 * DOOR_MIDDLE_M, 0.0])
    odds = sides.odds[SIDES[k]][r.plane(SIDES[k])]
    away = np.abs(surfaces.low[1 - axis] + PIECE_M * (np.arange(len(odds)) + 0.5) - middle[1 - axis])
    beside = (away > 0.5 * DOOR_MIDDLE_M) & (away < 1.5 * DOOR_MIDDLE_M) & np.isfinite(odds)
    return float(odds[beside].sum()), np.stack([middle - along, middle + along])


def _rooms_of(count: int, joined: Iterable[tuple[int, int]]) -> list[int]:
    """The least rectangle of each one's room."""
    room = list(range(count))
    for a, b in joined:
        low, high = sorted((room[a], room[b]))
        room = [low if of == high else of for of in room]
    return room


def _labels(ground: Ground, known: Cells, edges: FloatArray, room_of: Sequence[int]) -> Labels:
    """Rectangles, and free space beside them that the map knows: of the nearest. Without a rectangle it is one room."""
    shape = ground.free.shape
    index = np.indices(shape).reshape(2, -1).T
    of = rectangles_at(edges, (ground.low + (index + 0.5) * ground.cell) / ground.unit)
    table = np.array([*(room + 1 for room in room_of), 0], dtype=np.int32)
    labels = table[of].reshape(shape)
    beside = ground.free & known & (labels == 0)
    if not len(edges):
        return np.asarray(beside, dtype=np.int32)
    nearest = ndimage.distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
    labels[beside] = labels[tuple(nearest[:, beside])]
    return labels


def parted_along(labels: Labels, lines: Sequence[Cells]) -> Labels:
    """Rooms fall apart along drawn lines: parts beside a line are rooms of their own."""
    out = labels.copy()
    for cells in lines:
        beside = _beside(cells)
        for room in np.unique(out[cells & (out > 0)]):
            parts, _ = ndimage.label((out == room) & ~cells)
            met = [int(part) for part in np.unique(parts[beside]) if part]
            met.sort(key=lambda part: -int((parts == part).sum()))
            for part in met[1:]:
                out[parts == part] = out.max() + 1
    return out


def _in_order_of_entering(ground: Ground, labels: Labels) -> Labels:
    """(labels + 1,) each label's number, in the order in which the body first came; parts never entered come last."""
    visits = ground.visits[np.all((ground.visits >= 0) & (ground.visits < labels.shape), axis=1)]
    met = labels[tuple(visits.T)]
    order = dict.fromkeys([*met[met > 0].tolist(), *np.unique(labels[labels > 0]).tolist()])
    number = np.zeros(int(labels.max(initial=0)) + 1, dtype=np.int32)
    number[list(order)] = np.arange(1, len(order) + 1)
    return number


def _gate_of(labels: Labels, ground: Ground, passage: Passage) -> Gate | None:
    """Between the rooms to both sides of a passage; none where that is one."""
    ends = passage.ends * ground.unit
    d = (ends[1] - ends[0])[::-1] * [1.0, -1.0]
    d *= 0.4 * ground.unit / max(float(np.linalg.norm(d)), 1e-12)
    sides = ground.cells_of(ends.mean(axis=0) + np.array([d, -d])).clip(0, np.array(labels.shape) - 1)
    a, b = sorted(int(label) for label in labels[tuple(sides.T)])
    return Gate(a, b, ends) if a and a != b else None


def _exit_gate(labels: Labels, ground: Ground, exit: Exit) -> Gate | None:
    """Out of the room before an exit, which may be a part of what the rectangle was."""
    ends = exit.ends * ground.unit
    middle = ends.mean(axis=0) + 0.4 * ground.unit * exit.inwards
    x, y = ground.cells_of(middle[None])[0].clip(0, np.array(labels.shape) - 1)
    label = int(labels[x, y])
    return Gate(label, 0, ends) if label else None


def line_cells(
    line: FloatArray, low: FloatArray, cell: float, unit: float, shape: tuple[int, ...], wide_m: float = DRAWN_M
) -> Cells:
    """Cells within half of `wide_m` of a line (2, 2)."""
    x, y = (low[k] + (np.arange(shape[k]) + 0.5) * cell for k in range(2))
    return np.asarray(distance_to(line, np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)) <= 0.5 * wide_m * unit)


def _is_same(ends: FloatArray, line: FloatArray) -> bool:
    """Whether this is the door that a person erased: their middles are nearer than half the door's width."""
    apart = np.linalg.norm(ends.mean(axis=0) - line.mean(axis=0))
    return bool(apart <= 0.5 * max(np.linalg.norm(ends[1] - ends[0]), np.linalg.norm(line[1] - line[0])))


def _beside(cells: Cells) -> Cells:
    """These cells and two more all around."""
    return np.asarray(ndimage.binary_dilation(cells, np.ones((3, 3)), iterations=2), dtype=np.bool_)


def _drawn_gate(labels: Labels, line: FloatArray, cells: Cells) -> list[Gate]:
    """The drawn line as a door between what lies on both its sides; none where that is one room still."""
    beside = _beside(cells) & ~cells & (labels > 0)
    met = np.bincount(labels[beside])
    met[:1] = 0
    both = np.argsort(-met, kind="stable")[:2]
    if len(both) < 2 or met[both[1]] == 0:
        return []
    a, b = sorted(both.tolist())
    return [Gate(a, b, line, is_drawn=True)]


def _without_repeats(gates: Sequence[Gate]) -> list[Gate]:
    """Two gaps of one doorway are one door: the wider, or what a person drew there."""
    kept: list[Gate] = []
    for gate in sorted(gates, key=lambda g: (not g.is_drawn, -float(np.linalg.norm(g.ends[1] - g.ends[0])))):
        near = [
            other
            for other in kept
            if {other.a, other.b} == {gate.a, gate.b}
            and np.linalg.norm(other.ends.mean(axis=0) - gate.ends.mean(axis=0))
            < np.linalg.norm(other.ends[1] - other.ends[0])
        ]
        if not near:
            kept.append(gate)
    return kept
