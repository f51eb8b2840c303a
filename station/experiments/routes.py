"""A route as the thesis draws it: straight sections, how long each is, and the turns between them (figs. 5.6, 5.9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray

STEP_SHARE = 0.01  # of the route's size: smaller steps are the jitter of a robot at rest
CORNER_SHARE = 0.12  # of the route's size: what strays less from a straight line belongs to it
MAX_SECTIONS = 6  # a path with more winds: it has no sections worth measuring
BEND_ROUNDS = 5
ROUND_STEPS = (1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A path over the floor, cut at its corners. One that winds is a single section."""

    path: FloatArray  # (n, 2) without the jitter of standing still
    corner: IntArray  # (k + 1,) rows of the path where sections begin and end; its ends are the first and the last
    driven: FloatArray  # (n,) from the start to each row, along the path

    @property
    def length(self) -> FloatArray:
        """(k,) of each section, along the path."""
        return np.diff(self.driven[self.corner])

    @property
    def turn_deg(self) -> FloatArray:
        """(k - 1,) between one section and the next, counter-clockwise positive."""
        leg = np.diff(self.path[self.corner], axis=0)
        before, after = leg[:-1], leg[1:]
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        return np.degrees(np.arctan2(cross, (before * after).sum(axis=1)))

    def marks(self) -> tuple[FloatArray, FloatArray]:
        """(m,) round distances along the path, few enough to be read, and (m, 2) where they are reached."""
        total = float(self.driven[-1])
        if total <= 0:
            return np.zeros(0), np.zeros((0, 2))
        power = 10.0 ** np.floor(np.log10(total / MAX_SECTIONS))
        step = next(s * power for s in (*ROUND_STEPS, 10.0) if total / (s * power) <= MAX_SECTIONS)
        at = np.arange(1, int(total / step) + 1) * step
        return at, np.column_stack([np.interp(at, self.driven, self.path[:, axis]) for axis in (0, 1)])


def find_sections(position: FloatArray) -> Route:
    """The route of positions (N, 2), at least one, in the order of time."""
    size = float(np.linalg.norm(np.ptp(position, axis=0)))
    path = _without_jitter(position, STEP_SHARE * size)
    corner = _corners(path, CORNER_SHARE * size)
    if len(corner) > MAX_SECTIONS + 1:
        corner = corner[[0, -1]]
    corner = _at_the_bends(path, corner)
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    return Route(path, corner, driven)


def _without_jitter(position: FloatArray, step: float) -> FloatArray:
    """Positions at least `step` apart, and the last one."""
    kept = [0]
    for i in range(1, len(position)):
        if np.linalg.norm(position[i] - position[kept[-1]]) >= step or i == len(position) - 1:
            kept.append(i)
    return position[kept]


def _corners(path: FloatArray, reach: float) -> IntArray:
    """Rows between which the path stays within `reach` of a straight line.

    Source: Douglas and Peucker, Cartographica 10(2), 1973.
    """
    corners, pending = {0, len(path) - 1}, [(0, len(path) - 1)]
    while pending:
        a, b = pending.pop()
        if b - a < 2:
            continue
        distance = _distance_to_segment(path[a + 1 : b], path[a], path[b])
        if distance.max() > reach:
            middle = a + 1 + int(distance.argmax())
            corners.add(middle)
            pending += [(a, middle), (middle, b)]
    return np.array(sorted(corners), dtype=np.int64)


def _at_the_bends(path: FloatArray, corner: IntArray) -> IntArray:
    """Each inner corner moved to where the path is farthest from the line between its neighbours: a bend's middle."""
    moved = corner.copy()
    for _ in range(BEND_ROUNDS):
        for k in range(1, len(moved) - 1):
            a, b = moved[k - 1], moved[k + 1]
            moved[k] = a + 1 + int(_distance_to_segment(path[a + 1 : b], path[a], path[b]).argmax())
    return moved


def _distance_to_segment(p: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) of points (n, 2) to the straight piece from a to b."""
    along = b - a
    share = np.clip((p - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.linalg.norm(p - a - share[:, None] * along, axis=1)
