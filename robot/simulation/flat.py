"""A furnished flat from a seed: rooms by recursive splitting, doors by a spanning tree, furniture along the walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot.simulation.building import DOOR_HEIGHT_M, Builder, Pose2, TexturePicker
from robot.simulation.furniture import PIECES, Piece, Site
from robot.simulation.walls import WallRun, build_wall, wall_boxes, wall_runs
from robot.simulation.world import WALL_HEIGHT_M, WALL_THICKNESS_M, Door, Room, World

MIN_SIDE_M = 2.6
DOOR_WIDTH_M = 0.9
_HALF_WALL = WALL_THICKNESS_M / 2

ROOM_KINDS: dict[str, tuple[str, ...]] = {
    "living room": ("sofa", "television", "bookshelf", "plant", "sideboard", "chair", "boxes", "person"),
    "bedroom": ("bed", "wardrobe", "sideboard", "basket", "person", "chair", "boxes"),
    "kitchen": ("counter", "fridge", "washer", "chair", "sideboard", "basket", "boxes"),
    "office": ("desk", "bookshelf", "bookshelf", "boxes", "chair", "plant", "person"),
    "child's room": ("bed", "boxes", "bookshelf", "boxes", "basket", "chair", "sideboard"),
    "workshop": ("desk", "boxes", "sideboard", "boxes", "wardrobe", "person", "basket"),
}
WALL_STYLES = ("wallpaper", "plaster", "brick", "tiled", "wallpaper", "plaster")


@dataclass(frozen=True, slots=True)
class FlatOptions:
    """How this visit to the flat differs from others."""

    rooms: tuple[int, int] = (3, 5)
    room_area_m2: tuple[float, float] = (10.5, 13.0)
    lookalike_rooms: bool = False  # two rooms differ in nothing but their pictures
    identical_twins: bool = False  # ... nor in these
    moved_chairs_seed: int | None = None  # chairs, boxes and baskets stand elsewhere
    light_seed: int | None = None  # rooms are lit differently


def make_flat(name: str, seed: int, options: FlatOptions) -> World:
    """Build the flat of a seed; options change only what they say."""
    rng = np.random.default_rng([seed, 1])
    cells, doors = _plan_with_twins(rng) if options.lookalike_rooms else _plan(rng, options)
    names = _room_names(rng, len(cells))
    if options.lookalike_rooms:
        names[2] = names[1] + " 2"
    rooms = tuple(
        Room(n, x0 + _HALF_WALL, y0 + _HALF_WALL, x1 - _HALF_WALL, y1 - _HALF_WALL)
        for n, (x0, y0, x1, y1) in zip(names, cells, strict=True)
    )
    builder = Builder()
    plain_room, plain_side = int(rng.integers(0, len(rooms))), int(rng.integers(0, 4))
    room_seeds = [int(s) for s in rng.integers(0, 2**31, len(rooms))]
    if options.lookalike_rooms:
        room_seeds[2] = room_seeds[1]
        plain_room = 0
    are_identical = options.lookalike_rooms and options.identical_twins
    for index, room in enumerate(rooms):
        featureless = plain_side if index == plain_room else -1
        pictures = 1 if are_identical and index == 2 else index
        furnish_room(builder, room, index, doors, room_seeds[index], featureless, options.moved_chairs_seed, pictures)
    jambs = [rng] * len(doors)
    if are_identical:
        jambs[:2] = [np.random.default_rng([room_seeds[1], 10]) for _ in range(2)]
    for door, of_door in zip(doors, jambs, strict=True):
        _build_jambs(builder, door, of_door)
    light = _light(options.light_seed, len(rooms))
    start_room = max(rooms, key=lambda r: (r.x1_m - r.x0_m) * (r.y1_m - r.y0_m))
    start = (*start_room.centre, 0.0)
    return World(name, seed, rooms, tuple(doors), tuple(builder.surfaces), tuple(builder.obstacles), start, light)


def _light(light_seed: int | None, count: int) -> tuple[float, ...]:
    if light_seed is None:
        return ()
    return tuple(float(v) for v in np.random.default_rng([light_seed, 3]).uniform(0.45, 1.35, count))


def _room_names(rng: np.random.Generator, count: int) -> list[str]:
    kinds = list(ROOM_KINDS)
    order = ["living room", *(kinds[int(i)] for i in rng.permutation(len(kinds)) if kinds[int(i)] != "living room")]
    return order[:count]


# --- floor plan ---------------------------------------------------------------------------------------------------

Cell = tuple[float, float, float, float]  # x0 y0 x1 y1 m, to the middle of the walls


def _plan(rng: np.random.Generator, options: FlatOptions) -> tuple[list[Cell], list[Door]]:
    low, high = options.rooms
    weights = np.array([0.5, 0.3, 0.2, 0.1, 0.1][: high - low + 1])
    count = low + int(rng.choice(len(weights), p=weights / weights.sum()))
    while True:
        cells = _split_area(rng, count, options.room_area_m2)
        doors = _place_doors(rng, cells) if cells else None
        if cells and doors is not None:
            return cells, doors


def _plan_with_twins(rng: np.random.Generator) -> tuple[list[Cell], list[Door]]:
    """A wide room, two equal rooms side by side behind it with doors at the same place, and one more at the end."""
    w, h, d, e = (float(v) for v in rng.uniform([2.8, 2.9, 2.9, 2.7], [3.3, 3.5, 3.4, 3.2]))
    cells = [(0.0, 0.0, 2 * w, d), (0.0, d, w, d + h), (w, d, 2 * w, d + h), (2 * w, 0.0, 2 * w + e, d)]
    x = float(rng.uniform(0.75, w - 0.75))
    doors = [
        Door(x, d, DOOR_WIDTH_M, "x", (0, 1)),
        Door(w + x, d, DOOR_WIDTH_M, "x", (0, 2)),
        Door(2 * w, float(rng.uniform(0.8, d - 0.8)), DOOR_WIDTH_M, "y", (0, 3)),
    ]
    return cells, doors


def _split_area(rng: np.random.Generator, count: int, room_area_m2: tuple[float, float]) -> list[Cell] | None:
    area = count * rng.uniform(*room_area_m2)
    aspect = rng.uniform(0.65, 1.0)
    width, depth = math.sqrt(area / aspect), math.sqrt(area * aspect)
    cells: list[Cell] = [(0.0, 0.0, width, depth)]
    while len(cells) < count:
        cells.sort(key=lambda c: (c[2] - c[0]) * (c[3] - c[1]))
        x0, y0, x1, y1 = cells.pop()
        f = rng.uniform(0.4, 0.6)
        if x1 - x0 >= y1 - y0:
            cut = x0 + f * (x1 - x0)
            cells += [(x0, y0, cut, y1), (cut, y0, x1, y1)]
        else:
            cut = y0 + f * (y1 - y0)
            cells += [(x0, y0, x1, cut), (x0, cut, x1, y1)]
    if min(min(x1 - x0, y1 - y0) for x0, y0, x1, y1 in cells) < MIN_SIDE_M:
        return None
    return sorted(cells)


def _shared_wall(a: Cell, b: Cell) -> tuple[str, float, float, float] | None:
    """Axis along the wall, its fixed coordinate, and the range both rooms have of it."""
    for axis, fixed in (("y", (a[2], b[0])), ("y", (a[0], b[2])), ("x", (a[3], b[1])), ("x", (a[1], b[3]))):
        if abs(fixed[0] - fixed[1]) < 1e-9:
            k = 1 if axis == "y" else 0
            low, high = max(a[k], b[k]), min(a[k + 2], b[k + 2])
            if high - low > DOOR_WIDTH_M + 0.5:
                return axis, fixed[0], low, high
    return None


def _place_doors(rng: np.random.Generator, cells: list[Cell]) -> list[Door] | None:
    """Doors of a random spanning tree, now and then one more; None when rooms stay unreachable."""
    edges = [(i, j) for i in range(len(cells)) for j in range(i) if _shared_wall(cells[i], cells[j])]
    group = list(range(len(cells)))
    doors = []
    for k in rng.permutation(len(edges)):
        i, j = edges[int(k)]
        is_needed = group[i] != group[j]
        if not is_needed and rng.random() > 0.3:
            continue
        group = [group[j] if g == group[i] else g for g in group]
        wall = _shared_wall(cells[i], cells[j])
        assert wall is not None
        axis, fixed, low, high = wall
        margin = DOOR_WIDTH_M / 2 + 0.2
        centre = float(rng.uniform(low + margin, high - margin))
        x, y = (fixed, centre) if axis == "y" else (centre, fixed)
        doors.append(Door(x, y, DOOR_WIDTH_M, axis, (j, i)))
    return doors if len(set(group)) == 1 else None


# --- one room -----------------------------------------------------------------------------------------------------


def furnish_room(
    builder: Builder,
    room: Room,
    index: int,
    doors: list[Door],
    seed: int,
    featureless_side: int = -1,
    moved_seed: int | None = None,
    pictures_of: int | None = None,
) -> None:
    """Walls, floor, ceiling, rug, furniture and pictures of one room; `pictures_of`: another one that has the same."""
    rng = np.random.default_rng([seed, 2])
    pick = TexturePicker(np.random.default_rng([seed, 4]))
    width, depth = room.x1_m - room.x0_m, room.y1_m - room.y0_m
    centre = Pose2(*room.centre, 0.0)
    kind = room.name.removesuffix(" 2")
    floor_kind = "floor_tiles" if kind == "kitchen" or rng.random() < 0.3 else "planks"
    builder.level(centre, (width, depth), 0.0, pick.new(floor_kind, width, depth, 300), index)
    builder.level(centre, (width, depth), WALL_HEIGHT_M, pick.new("ceiling", width, depth, 80), index, facing_up=False)
    rug_size = (min(width - 1.2, rng.uniform(1.3, 2.2)), min(depth - 1.2, rng.uniform(1.0, 1.8)))
    rug = Pose2(centre.x_m + rng.uniform(-0.3, 0.3), centre.y_m + rng.uniform(-0.3, 0.3), 0.0)
    builder.level(rug, rug_size, 0.004, pick.new("rug", *rug_size, 400), index)
    style = "tiled" if kind == "kitchen" else WALL_STYLES[int(rng.integers(0, len(WALL_STYLES)))]
    # Also of twins, no two pictures are the same, unless it is asked for.
    pictures = TexturePicker(np.random.default_rng([seed, 9, index if pictures_of is None else pictures_of]))
    deepest = 0.5 * min(width, depth) - 0.65 + 0.2  # m, of a piece: the robot passes between two of them
    furnisher = _Furnisher(builder, rng, pick, pictures, index, list(ROOM_KINDS[kind]), deepest, moved_seed)
    for side, run in enumerate(wall_runs(room, index, doors)):
        is_plain = side == featureless_side
        texture = pick.new("plain_wall" if is_plain else style, run.length_m, WALL_HEIGHT_M, 350)
        build_wall(builder, run, texture, index)
        builder.obstacles += wall_boxes(run, index)
        if not is_plain:
            furnisher.furnish(run)


def _build_jambs(builder: Builder, door: Door, rng: np.random.Generator) -> None:
    """The inner faces of a door opening, with a wooden threshold."""
    pick = TexturePicker(rng)
    wood = pick.new("wood", WALL_THICKNESS_M, DOOR_HEIGHT_M, 400)
    threshold = pick.new("wood", door.width_m, WALL_THICKNESS_M, 400)
    yaw = 0.0 if door.along == "x" else math.pi / 2
    pose = Pose2(door.x_m, door.y_m, yaw)
    h, t = door.width_m / 2, WALL_THICKNESS_M / 2
    room = door.rooms[0]
    builder.upright(pose.at(h, t), pose.at(h, -t), (0.0, DOOR_HEIGHT_M), wood, room)
    builder.upright(pose.at(-h, -t), pose.at(-h, t), (0.0, DOOR_HEIGHT_M), wood, room)
    builder.level(pose, (door.width_m, WALL_THICKNESS_M), DOOR_HEIGHT_M, threshold, room, facing_up=False)
    builder.level(pose, (door.width_m, WALL_THICKNESS_M), 0.0, threshold, room)


MOVABLE = {"chair", "boxes", "basket"}


@dataclass(frozen=True, slots=True, eq=False)
class _Furnisher:
    """Furnishes one room, wall by wall."""

    builder: Builder
    rng: np.random.Generator
    pick: TexturePicker
    pictures: TexturePicker
    room: int
    pieces: list[str]  # kinds that still have no place
    deepest_m: float
    moved_seed: int | None

    def furnish(self, run: WallRun) -> None:
        """Stand pieces side by side along the free parts of a wall, and hang pictures between and above them."""
        corner = 0.45  # keeps the pieces of two walls apart in the corners
        spans = []
        s = corner
        for low, high in [*run.openings, (run.length_m - corner, run.length_m - corner)]:
            if low - 0.15 - s > 0.4:
                spans.append((s, low - 0.15))
            s = max(s, high + 0.15)
        for low, high in spans:
            s = low + float(self.rng.uniform(0.0, 0.2))
            while fitting := [name for name in self.pieces if self._fits(name, high - s)]:
                name = fitting[int(self.rng.integers(0, len(fitting)))]
                if name not in MOVABLE:
                    self.pieces.remove(name)
                s += self._stand(PIECES[name], run, low, s, high) + self._gap()
            self._hang_pictures(run, low, high)

    def _gap(self) -> float:
        return float(self.rng.choice([self.rng.uniform(0.03, 0.12), self.rng.uniform(0.3, 0.7)], p=[0.6, 0.4]))

    def _fits(self, name: str, length_m: float) -> bool:
        return PIECES[name].width_m[0] <= length_m and PIECES[name].depth_m <= self.deepest_m

    def _stand(self, piece: Piece, run: WallRun, low: float, s: float, high: float) -> float:
        """Stand a piece at s of the free part low..high of a wall; returns its width."""
        width = float(min(self.rng.uniform(*piece.width_m), high - s))
        position = s + width / 2
        rng = np.random.default_rng(int(self.rng.integers(0, 2**31)))
        if self.moved_seed is not None and piece.name in MOVABLE:
            rng = np.random.default_rng([self.moved_seed, int(rng.integers(0, 2**31))])
            position += float(np.clip(rng.normal(0, 0.25), low + width / 2 - position, 0.1))
        pose = Pose2(*run.at(position), run.yaw_rad)
        piece.build(Site(self.builder, self.pick, rng, pose, width, piece.depth_m, self.room, piece.name))
        return width

    def _hang_pictures(self, run: WallRun, low: float, high: float) -> None:
        """Posters and pictures, low enough that a robot's camera sees some of them."""
        rng, s = self.rng, low
        off = 0.012  # the frame stands off the wall
        out = np.array([-off * math.sin(run.yaw_rad), off * math.cos(run.yaw_rad)])
        while s < high - 0.35:
            w, h = float(rng.uniform(0.3, min(0.8, high - s))), float(rng.uniform(0.3, 0.7))
            z0 = float(rng.uniform(0.18, 0.5) if rng.random() < 0.6 else rng.uniform(0.9, 1.5))
            left, right = ((out + run.at(end)).tolist() for end in (s, s + w))
            self.builder.upright(left, right, (z0, z0 + h), self.pictures.new("poster", w, h, 550), self.room)
            s += w + float(rng.uniform(0.1, 0.6))
