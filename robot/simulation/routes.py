"""Collision-free routes through a world: A* on a grid with clearance, joined and rounded."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import cast

import cv2
import numpy as np

from robot.simulation.body import ROUNDING_M, CollisionBoxes
from robot.simulation.world import Room, World
from shared.errors import ConfigError
from shared.geometry import FloatArray

CELL_M = 0.06
MARGIN_M = 0.06  # beyond the robot's radius
COMFORT_M = 0.35  # clearance beyond which more room is not worth a detour
SPACING_M = 0.05  # between points of a finished route
ROUTE_KINDS = ("mapping", "second", "local", "tour", "triangle_a", "triangle_b", "triangle_c")


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A path for the body's origin, to be driven in order of the rows."""

    kind: str
    points: FloatArray  # (N, 2) m, world
    start_yaw_rad: float

    @property
    def length_m(self) -> float:
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())


class FreeSpace:
    """Where the robot's centre may be."""

    def __init__(self, world: World, radius_m: float) -> None:
        self.world = world
        self.boxes = CollisionBoxes(world)
        self.keep_m = radius_m + MARGIN_M
        x0, y0, x1, y1 = world.bounds()
        self._origin = np.array([x0, y0])
        xs, ys = np.arange(x0, x1, CELL_M), np.arange(y0, y1, CELL_M)
        grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), -1)
        self.clearance = self.boxes.clearance(grid.reshape(-1, 2)).reshape(grid.shape[:2])
        self.is_free = self.clearance >= self.keep_m
        lack = np.clip((COMFORT_M + radius_m - self.clearance) / COMFORT_M, 0.0, 1.0)
        self._cost = 1.0 + 6.0 * lack**2
        self._keep_connected()
        self._free_cells = np.argwhere(self.is_free)  # (N, 2)
        self._free_points: FloatArray = self._origin + CELL_M * self._free_cells  # (N, 2) m, their centres

    def _keep_connected(self) -> None:
        """Forget pockets that the robot cannot reach: keep the largest region."""
        count, labels, stats, _ = cv2.connectedComponentsWithStats(self.is_free.astype(np.uint8), connectivity=4)
        if count > 1:
            self.is_free = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))

    def cell(self, p: FloatArray) -> tuple[int, int]:
        """The free cell nearest to a point."""
        if len(self._free_cells) == 0:
            raise ConfigError(f"world {self.world.name} with seed {self.world.seed} has no free floor")
        i, j = self._free_cells[np.argmin(((self._free_points - p) ** 2).sum(1))].tolist()
        return i, j

    def point(self, cell: tuple[int, int]) -> FloatArray:
        return cast(FloatArray, self._origin + CELL_M * np.array(cell))

    def nearest_free(self, p: FloatArray) -> FloatArray:
        """The free point nearest to p: p itself where that is free."""
        if self.boxes.clearance(p[None])[0] >= self.keep_m:
            return p
        return self.point(self.cell(p))

    def free_points_in(self, room: Room) -> FloatArray:
        """All free cell centres (N, 2) of a room."""
        points = self._free_points
        inside = (points >= (room.x0_m, room.y0_m)) & (points <= (room.x1_m, room.y1_m))
        return points[inside.all(1)]

    def random_spot(self, seed: int, room_name: str | None = None) -> tuple[float, float, float]:
        """x m, y m, yaw rad of a free place with some room around it. Raises ConfigError for an unknown room."""
        rooms = [r for r in self.world.rooms if room_name in (None, r.name)]
        if not rooms:
            names = ", ".join(r.name for r in self.world.rooms)
            raise ConfigError(f"no room is called {room_name!r}; there are {names}")
        rng = np.random.default_rng([seed, 16])
        points = np.concatenate([self.free_points_in(r) for r in rooms])
        roomy = points[self.boxes.clearance(points) > self.keep_m + 0.14]
        points = roomy if len(roomy) else points
        x, y = points[int(rng.integers(0, len(points)))]
        return float(x), float(y), float(rng.uniform(-math.pi, math.pi))

    def path(self, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Cheapest path (N, 2) between two points. Source: Hart, Nilsson and Raphael, 1968 (A*)."""
        columns = self.is_free.shape[1] + 2
        (i_last, j_last), first = self.cell(goal), self._number(self.cell(start))
        last = self._number((i_last, j_last))
        entering = self._cost_of_entering
        steps = [(i * columns + j, math.hypot(i, j)) for i, j in _NEIGHBOURS]
        best = [math.inf] * len(entering)
        best[first] = 0.0
        parent: dict[int, int] = {}
        queue = [(0.0, first)]
        closed: set[int] = set()
        while queue:
            _, cell = heapq.heappop(queue)
            if cell == last:
                break
            if cell in closed:
                continue
            closed.add(cell)
            for step, length in steps:
                cost = best[cell] + length * entering[cell + step]
                if cost < best[cell + step]:
                    best[cell + step] = cost
                    parent[cell + step] = cell
                    i, j = divmod(cell + step, columns)
                    heapq.heappush(queue, (cost + math.hypot(i - 1 - i_last, j - 1 - j_last), cell + step))
        if last != first and last not in parent:
            raise ConfigError(f"no way from {start} to {goal} in world {self.world.name}, seed {self.world.seed}")
        cells = [last]
        while cells[-1] != first:
            cells.append(parent[cells[-1]])
        return self._origin + CELL_M * (np.array([divmod(c, columns) for c in reversed(cells)]) - 1)

    def _number(self, cell: tuple[int, int]) -> int:
        """Of a cell in the grid with a rim around it, row by row."""
        return (cell[0] + 1) * (self.is_free.shape[1] + 2) + cell[1] + 1

    @cached_property
    def _cost_of_entering(self) -> list[float]:
        """Of each cell in the grid with a rim around it, as plain numbers: a path asks a hundred thousand times."""
        return np.pad(np.where(self.is_free, self._cost, math.inf), 1, constant_values=math.inf).ravel().tolist()

    def is_clear(self, points: FloatArray) -> bool:
        """Whether the robot fits at all points (N, 2)."""
        return bool((self.boxes.clearance(points) >= self.keep_m - 0.03).all())


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def plan_route(
    world: World, kind: str, seed: int = 0, radius_m: float = 0.21, start: tuple[float, float] | None = None
) -> Route:
    """Plan a route of a kind; another seed gives another route of the same kind.

    `mapping`: a loop through every room and back. `second`: every room in another order and the other way round.
    `local`: a loop in the room of the start. `tour`: each room both ways round. `triangle_a|b|c`: for the world `room`.
    With a start (x, y) m the route begins there.

    Raises:
        ConfigError: unknown kind, or no way through the world.
    """
    if kind not in ROUTE_KINDS:
        raise ConfigError(f"route {kind!r} is unknown; choose one of {', '.join(ROUTE_KINDS)}")
    space = FreeSpace(world, radius_m)
    rng = np.random.default_rng([world.seed, seed, sum(map(ord, kind))])
    if kind.startswith("triangle"):
        return _triangle(space, kind, start)
    order = _room_order(world, rng, start, is_reversed=kind == "second")
    if kind == "local":
        order = order[:1]
    turn = -1 if kind in ("second", "local") else 1
    stops: list[FloatArray] = [] if start is None else [np.array(start)]
    for k, room in enumerate(order):
        is_return = room in order[:k]
        scale = 0.55 if kind == "mapping" else float(rng.uniform(0.42, 0.6))
        shift = rng.normal(0, 0.08 if seed or kind != "mapping" else 0.02, 2)
        entry = stops[-1] if stops else np.array(world.start[:2])
        if not is_return:
            stops += _ring(space, world.rooms[room], entry, turn, scale, shift)
        if kind == "tour" and not is_return:
            stops += _ring(space, world.rooms[room], stops[-1], -turn, 0.8 * scale, -shift)[1:]
    stops.append(stops[0])
    return _finish(space, kind, stops)


def _room_order(
    world: World, rng: np.random.Generator, start: tuple[float, float] | None, is_reversed: bool
) -> list[int]:
    """Rooms in the order of a walk through the doors, with the way back."""
    neighbours: dict[int, list[int]] = {i: [] for i in range(len(world.rooms))}
    for door in world.doors:
        neighbours[door.rooms[0]].append(door.rooms[1])
        neighbours[door.rooms[1]].append(door.rooms[0])
    at = np.array(start or world.start[:2])
    first = int(np.argmin([np.hypot(*(np.clip(at, (r.x0_m, r.y0_m), (r.x1_m, r.y1_m)) - at)) for r in world.rooms]))
    if is_reversed and start is None:
        first = int(rng.integers(0, len(world.rooms)))
    walk: list[int] = []
    seen: set[int] = set()

    def visit(room: int) -> None:
        seen.add(room)
        walk.append(room)
        for other in sorted(neighbours[room], reverse=is_reversed):
            if other not in seen:
                visit(other)
                walk.append(room)

    visit(first)
    return walk


def _ring(
    space: FreeSpace, room: Room, entry: FloatArray, turn: int, scale: float, shift: FloatArray
) -> list[FloatArray]:
    """Stops around a room's middle, from the side of the entry on, so that the camera sweeps all walls."""
    free = space.free_points_in(room)
    centre = (free.min(0) + free.max(0)) / 2 + shift if len(free) else np.array(room.centre)
    half = scale * (free.max(0) - free.min(0)) / 2 if len(free) else np.array([0.3, 0.3])
    half = np.clip(half * 1.3, 0.3, 0.95)
    first = math.atan2((entry[1] - centre[1]) / half[1], (entry[0] - centre[0]) / half[0])
    angles = first + turn * np.linspace(0, 2 * np.pi, 9)
    ring = centre + np.column_stack([np.cos(angles), np.sin(angles)]) * half
    return [space.nearest_free(p) for p in ring]


def _triangle(space: FreeSpace, kind: str, start: tuple[float, float] | None) -> Route:
    """The thesis' taped triangles: b is a driven from another start and end, c crosses the room differently."""
    room = space.world.rooms[0]
    x, y = room.centre
    corners = {
        "triangle_a": [(-1.0, -0.8), (1.0, -0.8), (0.1, 0.95)],
        "triangle_b": [(-0.6, -0.75), (0.95, -0.85), (0.15, 0.9)],
        "triangle_c": [(-0.9, 0.85), (-0.15, -0.9), (1.0, 0.5)],
    }[kind]
    stops = [space.nearest_free(np.array([x + dx, y + dy])) for dx, dy in corners]
    stops.append(stops[0])
    if kind == "triangle_b":
        stops.append((stops[0] + stops[1]) / 2)
    return _finish(space, kind, stops if start is None else [np.array(start), *stops])


def _finish(space: FreeSpace, kind: str, stops: list[FloatArray]) -> Route:
    """Join the stops, cut corners off, space the points evenly."""
    pieces = [np.array(stops[:1])]
    for a, b in pairwise(stops):
        straight = _resample(np.array([a, b]))
        pieces.append(straight[1:] if space.is_clear(straight) else _pull_tight(space, space.path(a, b))[1:])
    points = _resample(np.concatenate(pieces))
    points = _smooth(space, points)
    ahead = points[min(8, len(points) - 1)] - points[0]
    return Route(kind, points, math.atan2(ahead[1], ahead[0]))


def _pull_tight(space: FreeSpace, path: FloatArray) -> FloatArray:
    """Replace detours of the grid by straight lines where they keep some comfort."""
    kept = [path[0]]
    i = 0
    while i < len(path) - 1:
        j = min(len(path) - 1, i + 14)
        while j > i + 1 and not space.is_clear(_resample(np.array([path[i], path[j]]))):
            j -= 1
        kept.append(path[j])
        i = j
    return np.array(kept)


def _resample(points: FloatArray) -> FloatArray:
    """Points SPACING_M apart along a polyline."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    keep = np.concatenate([[True], steps > 1e-9])
    points = points[keep]
    if len(points) < 2:
        return points
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    wanted = np.linspace(0.0, s[-1], max(2, int(s[-1] / SPACING_M) + 1))
    return np.column_stack([np.interp(wanted, s, points[:, 0]), np.interp(wanted, s, points[:, 1])])


def _smooth(space: FreeSpace, points: FloatArray) -> FloatArray:
    """Round the corners by local averaging, point by point, where the robot still fits."""
    enough = space.keep_m + 0.05
    clearance = space.boxes.clearance(points)  # at least; to the last bit where it is not surely enough
    for _ in range(60):
        moved = points.copy()
        moved[2:-2] = (points[:-4] + 4 * points[1:-3] + 6 * points[2:-2] + 4 * points[3:-1] + points[4:]) / 16
        moved_clearance = clearance - np.hypot(*(moved - points).T) - ROUNDING_M
        unsure = moved_clearance < enough
        moved_clearance[unsure] = space.boxes.clearance(moved[unsure])
        fits = moved_clearance >= np.minimum(enough, clearance)
        points = np.where(fits[:, None], moved, points)
        clearance = np.where(fits, moved_clearance, clearance)
    return _resample(points)
