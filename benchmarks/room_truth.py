"""A floor plan beside the simulator's truth: rooms, doors, walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from benchmarks.room_flats import MappedRooms
from robot.simulation.world import Door, World
from shared.geometry import FloatArray, IntArray, inverse_sim3, transform
from station.model.floor_plan import FloorPlan

GRID_M = 0.05
DOOR_M = 0.3  # a door is found when a door of the plan has its middle so near
SAMPLE_M = 0.1  # along walls
RIGHT_IOU = 0.7  # two rooms run together overlap each of them less


@dataclass(frozen=True, slots=True)
class Judgement:
    """One flat."""

    rooms: int  # of the plan
    true_rooms: int
    iou: tuple[float, ...]  # of each true room with the room of the plan assigned to it; 0 without one
    doors: int
    true_doors: int
    doors_found: int
    wall_error_m: tuple[float, ...]  # of points along the plan's walls to the nearest true wall
    wall_missed_m: tuple[float, ...]  # of points along the true walls to the nearest wall of the plan
    certainty: tuple[float, ...]  # of each room of the plan, as the plan has it
    is_right: tuple[bool, ...]  # of each room of the plan: whether a true room overlaps it by RIGHT_IOU

    @property
    def is_count_right(self) -> bool:
        return self.rooms == self.true_rooms


def judge(mapped: MappedRooms, plan: FloorPlan) -> Judgement:
    """`plan` was made from `mapped`; it is laid on the truth by the motion that fits the trajectory best."""
    world, T = mapped.world, mapped.T_world_map
    names = true_rooms(world)
    true_at, p_world = _true_labels(world, names)
    found_at = plan.rooms_at(transform(inverse_sim3(T), p_world)).astype(np.int64)
    doors = true_doors(world)
    iou = _overlaps(true_at, found_at, len(names), len(plan.rooms))
    return Judgement(
        rooms=len(plan.rooms),
        true_rooms=len(names),
        iou=tuple(_assigned(iou).tolist()),
        doors=len(plan.doors),
        true_doors=len(doors),
        doors_found=_doors_found(doors, _on_world(plan, T, [door.ends.mean(axis=0) for door in plan.doors])),
        wall_error_m=tuple(_distances(_plan_walls(plan, T), _true_walls(world))),
        wall_missed_m=tuple(_distances(_true_walls(world), _plan_walls(plan, T))),
        certainty=tuple(room.certainty for room in plan.rooms),
        is_right=tuple((iou.max(axis=0, initial=0.0)[: len(plan.rooms)] >= RIGHT_IOU).tolist()),
    )


def true_rooms(world: World) -> list[str]:
    """Names: rectangles of one name are one room."""
    return list(dict.fromkeys(room.name for room in world.rooms))


def true_doors(world: World) -> list[Door]:
    """Openings within one room are no doors."""
    return [door for door in world.doors if world.rooms[door.rooms[0]].name != world.rooms[door.rooms[1]].name]


def _true_labels(world: World, names: list[str]) -> tuple[IntArray, FloatArray]:
    """Number of the true room of each point of a grid over the flat, -1 for none, and the points (n, 3)."""
    x0, y0, x1, y1 = world.bounds()
    x, y = (np.arange(low - 1.0, high + 1.0, GRID_M) for low, high in ((x0, x1), (y0, y1)))
    p = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    label = np.full(len(p), -1, dtype=np.int64)
    for room in world.rooms:
        inside = (p >= (room.x0_m, room.y0_m)).all(axis=1) & (p <= (room.x1_m, room.y1_m)).all(axis=1)
        label[inside] = names.index(room.name)
    return label, np.column_stack([p, np.zeros(len(p))])


def _overlaps(true_at: IntArray, found_at: IntArray, true_count: int, count: int) -> FloatArray:
    """(true_count, max(count, 1)) intersection over union of all pairs."""
    iou = np.zeros((true_count, max(count, 1)))
    for i in range(true_count):
        for j in range(count):
            both = int(np.count_nonzero((true_at == i) & (found_at == j)))
            either = int(np.count_nonzero((true_at == i) | (found_at == j)))
            iou[i, j] = both / max(either, 1)
    return iou


def _assigned(iou: FloatArray) -> FloatArray:
    """(true_count,) each true room's overlap with the room of the plan assigned to it, with the largest sum."""
    rows, columns = linear_sum_assignment(-iou)
    out = np.zeros(len(iou))
    out[rows] = iou[rows, columns]
    return out


def _doors_found(doors: list[Door], middles: FloatArray) -> int:
    if not doors or not len(middles):
        return 0
    true = np.array([(door.x_m, door.y_m) for door in doors])
    apart = np.linalg.norm(true[:, None] - middles[None], axis=2)
    rows, columns = linear_sum_assignment(apart > DOOR_M)
    return int(np.count_nonzero(apart[rows, columns] <= DOOR_M))


def _on_world(plan: FloorPlan, T: FloatArray, p: list[FloatArray]) -> FloatArray:
    """(n, 2) points of the plan in the world."""
    ground = np.array(p).reshape(-1, 2)
    return transform(T, np.column_stack([ground, np.zeros(len(ground))]) @ plan.R_ground_map)[:, :2]


def _plan_walls(plan: FloorPlan, T: FloatArray) -> FloatArray:
    ends = _on_world(plan, T, list(plan.walls.reshape(-1, 2))).reshape(-1, 2, 2)
    return _sampled(ends)


def _true_walls(world: World) -> FloatArray:
    """Points along the inner faces of all rooms, but for doors and openings."""
    points = []
    for room in world.rooms:
        a, b, c, d = room.x0_m, room.y0_m, room.x1_m, room.y1_m
        corners = np.array([[a, b], [c, b], [c, d], [a, d], [a, b]])
        points.append(_sampled(np.stack([corners[:-1], corners[1:]], axis=1)))
    p = np.concatenate(points)
    for door in world.doors:
        off = np.abs(p - (door.x_m, door.y_m))
        along, across = (0, 1) if door.along == "x" else (1, 0)
        p = p[~((off[:, along] <= door.width_m / 2) & (off[:, across] <= 0.1))]
    return p


def _sampled(segments: FloatArray) -> FloatArray:
    """Points SAMPLE_M apart along segments (n, 2, 2)."""
    points = [
        a + np.linspace(0, 1, max(2, round(float(np.linalg.norm(b - a)) / SAMPLE_M)))[:, None] * (b - a)
        for a, b in segments
    ]
    return np.concatenate(points) if points else np.zeros((0, 2))


def _distances(p: FloatArray, to: FloatArray) -> list[float]:
    if not len(p) or not len(to):
        return []
    return [float(d) for d in cKDTree(to).query(p)[0]]
