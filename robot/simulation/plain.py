"""A plain home from a seed: bare walls, few pictures, equal doors and radiators, windows by day or lamps at night."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from robot.simulation.building import DOOR_HEIGHT_M, Builder, Pose2, TexturePicker
from robot.simulation.furniture import Site
from robot.simulation.plain_furniture import PLAIN_PIECES
from robot.simulation.plain_plan import Plan, PlannedRoom, draw_plan
from robot.simulation.textures import Glow, TextureSpec
from robot.simulation.walls import WallRun, build_wall, wall_boxes, wall_runs
from robot.simulation.world import WALL_THICKNESS_M, Door, Obstacle, Room, Surface, World

CEILING_M = 2.6
NIGHT_SHARE = 0.35  # of the homes
DOOR_ZONE_M = 0.8  # before a door nothing stands
PASSAGE_M = 0.95  # between what stands at opposite walls
PLACE_TRIES = 12
OFF_WALL_M = 0.012  # what hangs on a wall stands off it
LIGHTS_THEMSELVES = {"window_day", "window_night", "lamp_shade"}
STRIP_SHARE = 0.4  # of the walls have a power strip on the floor
MOVABLE = {"crate", "basket", "shoes", "pile"}

USES: dict[str, tuple[str, ...]] = {
    "hall": ("hall board", "shoes", "basket", "plant", "shoes"),
    "living room": ("sofa", "low board", "open shelf", "dresser", "table", "plant", "pile", "basket", "pile"),
    "kitchen": ("kitchen row", "fridge", "table", "crate", "pile", "basket", "crate"),
    "bedroom": ("bed", "wardrobe", "nightstand", "dresser", "pile", "basket", "shoes"),
    "guest room": ("bed", "dresser", "crate", "pile", "plant", "shoes"),
    "study": ("table", "open shelf", "wardrobe", "pile", "crate", "plant", "pile"),
}
FLOORS = ("laminate", "laminate", "carpet", "lino", "large_tiles")


@dataclass(frozen=True, slots=True)
class Lamp:
    """A light in a room, or the daylight of a window; a lamp behind a surface does not light it."""

    room: int
    p_world: tuple[float, float, float]  # m
    intensity: float  # m^2: share of full brightness at 1 m


@dataclass(frozen=True, slots=True)
class _Style:
    """What all rooms of one home have in common."""

    is_night: bool
    series_seed: int  # of doors, radiators, sockets and curtains
    wall_seed: int
    floor: str
    radiator_size_m: tuple[float, float]
    moved_seed: int | None


def make_plain(
    name: str,
    seed: int,
    needs_twins: bool,
    moved_seed: int | None = None,
    light_seed: int | None = None,
    identical_twins: bool = False,
) -> World:
    """Build the home of a seed. Twin rooms have the same shape, furniture and light; their pictures differ.

    `identical_twins`: those are the same, too.
    """
    rng = np.random.default_rng([seed, 21])
    plan = draw_plan(rng, needs_twins, name)
    style = _Style(
        is_night=bool(rng.random() < NIGHT_SHARE),
        series_seed=int(rng.integers(0, 2**31)),
        wall_seed=int(rng.integers(0, 2**31)),
        floor=str(rng.choice(FLOORS)),
        radiator_size_m=(float(rng.choice([0.8, 1.0, 1.2])), float(rng.choice([0.4, 0.6]))),
        moved_seed=moved_seed,
    )
    room_seeds = [int(s) for s in rng.integers(0, 2**31, len(plan.rooms))]
    if plan.twins is not None:
        room_seeds[plan.twins[1]] = room_seeds[plan.twins[0]]
    rooms = _rooms(plan)
    builder, lamps = Builder(), []
    for index, (room, planned) in enumerate(zip(rooms, plan.rooms, strict=True)):
        prints = plan.twins[0] if identical_twins and plan.twins is not None and index == plan.twins[1] else index
        furnisher = _Furnisher(builder, style, room, planned, index, plan.doors, room_seeds[index], prints)
        furnisher.furnish()
        lamps += furnisher.lamps
    for door in plan.doors:
        _build_frame(builder, door, style)
    for x0, y0, x1, y1 in plan.closed:
        builder.obstacles.append(
            Obstacle((x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2, 0.0, CEILING_M, "wall", 0)
        )
    ambient = 0.5 if style.is_night else 0.72
    surfaces = tuple(lit(surface, lamps, ambient) for surface in builder.surfaces)
    start = _start(plan, rooms)
    light = _room_light(style, light_seed, len(rooms))
    return World(name, seed, rooms, plan.doors, surfaces, tuple(builder.obstacles), start, light)


def _rooms(plan: Plan) -> tuple[Room, ...]:
    """The insides of the planned rooms; a second room of one use is called "… 2"."""
    half = WALL_THICKNESS_M / 2
    rooms: list[Room] = []
    for planned in plan.rooms:
        again = planned.part_of is None and any(room.name.removesuffix(" 2") == planned.use for room in rooms)
        x0, y0, x1, y1 = planned.cell
        name = planned.use + (" 2" if again else "")
        rooms.append(Room(name, x0 + half, y0 + half, x1 - half, y1 - half))
    return tuple(rooms)


def _start(plan: Plan, rooms: tuple[Room, ...]) -> tuple[float, float, float]:
    """In the middle of the room with the most doors: nothing stands there."""
    count = [sum(index in door.rooms for door in plan.doors) for index in range(len(rooms))]
    room = rooms[int(np.argmax(count))]
    return (*room.centre, 0.0)


def _room_light(style: _Style, light_seed: int | None, count: int) -> tuple[float, ...]:
    level = 0.6 if style.is_night else 1.0
    if light_seed is None:
        return () if not style.is_night else (level,) * count
    return tuple(level * float(v) for v in np.random.default_rng([light_seed, 3]).uniform(0.45, 1.35, count))


def lit(surface: Surface, lamps: list[Lamp], ambient: float) -> Surface:
    """The surface as the lamps of its room light it. What stands in between casts no shadow."""
    if surface.texture.kind in LIGHTS_THEMSELVES:
        return surface
    glows = [glow for lamp in lamps if lamp.room == surface.room and (glow := _glow(surface, lamp)) is not None]
    return replace(surface, texture=replace(surface.texture, ambient=ambient, glows=tuple(glows)))


def _glow(surface: Surface, lamp: Lamp) -> Glow | None:
    """The lamp's light in the texture's coordinates; None behind the surface."""
    to_lamp = np.array(lamp.p_world) - surface.origin
    distance = float(to_lamp @ surface.normal)
    if distance < 0.02:
        return None
    u, v = float(to_lamp @ np.array(surface.eu)) + surface.u0_m, float(to_lamp @ np.array(surface.ev)) + surface.v0_m
    return Glow(round(u, 3), round(v, 3), round(distance, 3), lamp.intensity)


def _build_frame(builder: Builder, door: Door, style: _Style) -> None:
    """The white lining of a door opening, the same at every door."""
    lining = TexturePicker.series("lacquer", style.series_seed, WALL_THICKNESS_M, DOOR_HEIGHT_M, 250)
    pose = Pose2(door.x_m, door.y_m, 0.0 if door.along == "x" else math.pi / 2)
    h, t, room = door.width_m / 2, WALL_THICKNESS_M / 2, door.rooms[0]
    builder.upright(pose.at(h, t), pose.at(h, -t), (0.0, DOOR_HEIGHT_M), lining, room)
    builder.upright(pose.at(-h, -t), pose.at(-h, t), (0.0, DOOR_HEIGHT_M), lining, room)
    sill = TexturePicker.series("lacquer", style.series_seed, door.width_m, WALL_THICKNESS_M, 250)
    builder.level(pose, (door.width_m, WALL_THICKNESS_M), DOOR_HEIGHT_M, sill, room, facing_up=False)
    builder.level(pose, (door.width_m, WALL_THICKNESS_M), 0.0, sill, room)


@dataclass(frozen=True, slots=True)
class _Box:
    """An upright rectangle of the floor plan, m."""

    x0: float
    y0: float
    x1: float
    y1: float

    def meets(self, other: _Box) -> bool:
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1


@dataclass(slots=True, eq=False)
class _Furnisher:
    """Puts together one room: shell, window, doors that stay closed, furniture, a lamp, few pictures."""

    builder: Builder
    style: _Style
    room: Room
    planned: PlannedRoom
    index: int
    doors: tuple[Door, ...]
    seed: int
    prints_of: int  # number of the room whose pictures it has: its own, but for identical twins
    lamps: list[Lamp] = field(default_factory=list)
    taken: list[_Box] = field(default_factory=list)  # footprints, door zones
    hung: list[list[tuple[float, float]]] = field(default_factory=lambda: [[] for _ in range(4)])  # m along each wall
    deepest_m: list[float] = field(default_factory=lambda: [0.0] * 4)  # of what stands at each wall

    def furnish(self) -> None:
        rng = np.random.default_rng([self.seed, 22])
        pick = TexturePicker(np.random.default_rng([self.seed, 23]))
        runs = wall_runs(self.room, self.index, self.doors)
        self._build_shell(runs, rng)
        for side, run in enumerate(runs):
            for low, high in run.openings:
                self.taken.append(self._footprint(run, low - 0.1, high + 0.1, DOOR_ZONE_M))
                self.hung[side].append((low - 0.15, high + 0.15))
        if self.planned.window_side is not None:
            self._build_window(self.planned.window_side, runs[self.planned.window_side], rng)
        if self.planned.use == "hall":
            self._build_closed_doors(runs, rng)
        for name in USES[self.planned.use]:
            self._stand(name, runs, rng, pick)
        if self.style.is_night:
            self._build_lamp(runs, rng)
        self._build_sockets(runs, rng)
        self._hang_small_things(runs, np.random.default_rng([self.seed, 25]))
        own = np.random.default_rng([self.seed, 24, self.prints_of])  # twins have other pictures
        self._hang_prints(runs, own)

    # --- the shell ------------------------------------------------------------------------------------------------

    def _build_shell(self, runs: list[WallRun], rng: np.random.Generator) -> None:
        width, depth = self.room.x1_m - self.room.x0_m, self.room.y1_m - self.room.y0_m
        centre = Pose2(*self.room.centre, 0.0)
        wall_seed = self.style.wall_seed + int(rng.integers(0, 2))  # two colours in a home at most
        floor = "large_tiles" if self.planned.use == "kitchen" and rng.random() < 0.5 else self.style.floor
        series = TexturePicker.series
        self.builder.level(centre, (width, depth), 0.0, series(floor, self.seed, width, depth, 200), self.index)
        ceiling = series("white_ceiling", self.seed, width, depth, 60)
        self.builder.level(centre, (width, depth), CEILING_M, ceiling, self.index, facing_up=False)
        if self.planned.use in ("living room", "bedroom") and rng.random() < 0.5:
            size = (min(width - 1.2, float(rng.uniform(1.2, 2.0))), min(depth - 1.2, float(rng.uniform(0.9, 1.5))))
            self.builder.level(centre, size, 0.004, series("plain_rug", self.seed, *size, 200), self.index)
        for run in runs:
            build_wall(
                self.builder, run, series("white_paint", wall_seed, run.length_m, CEILING_M, 200), self.index, CEILING_M
            )
            self.builder.obstacles += wall_boxes(run, self.index)

    def _build_window(self, side: int, run: WallRun, rng: np.random.Generator) -> None:
        """A window with curtains; below it a radiator unless it reaches the floor."""
        width = min(float(rng.uniform(1.1, 2.2)), run.length_m - 0.9)
        sill = float(rng.choice([0.04, 0.5, 0.8]))
        free = [
            s for s in np.linspace(width / 2 + 0.4, run.length_m - width / 2 - 0.4, 9) if self._is_open(side, s, width)
        ]
        if not free:
            return
        middle = float(free[int(rng.integers(0, len(free)))])
        low, high = middle - width / 2, middle + width / 2
        kind = "window_night" if self.style.is_night else "window_day"
        look = TexturePicker.series(kind, self.seed, width, 2.2 - sill, 200)
        self._hang(run, low, high, (sill, 2.2), look, OFF_WALL_M)
        curtain = TexturePicker.series("curtain", self.style.series_seed, 0.32, 2.25, 200)
        for a, b in ((low - 0.3, low + 0.02), (high - 0.02, high + 0.3)):
            self._hang(run, a, b, (0.05, 2.3), curtain, 0.06)
        self.hung[side].append((low - 0.3, high + 0.3))
        if not self.style.is_night:
            x, y = self._before(run, middle, -0.25)
            self.lamps.append(Lamp(self.index, (x, y, 1.3), 1.5))
        if sill > 0.3:
            radiator_w, radiator_h = min(self.style.radiator_size_m[0], width), min(self.style.radiator_size_m[1], sill)
            self._radiator(run, middle, radiator_w, radiator_h - 0.06)
            self.deepest_m[side] = 0.12
        self.taken.append(self._footprint(run, low, high, 0.15 if sill > 0.3 else DOOR_ZONE_M))

    def _radiator(self, run: WallRun, middle: float, width: float, height: float) -> None:
        front = TexturePicker.series("radiator", self.style.series_seed, width, height, 300)
        side = TexturePicker.series("lacquer", self.style.series_seed, 0.1, height, 250)
        pose = Pose2(*self._before(run, middle, 0.06), run.yaw_rad)
        self.builder.box(pose, (width, 0.1, height), 0.12, self.index, "radiator", front, side, side, has_back=False)

    def _build_closed_doors(self, runs: list[WallRun], rng: np.random.Generator) -> None:
        """Doors that lead elsewhere: equal leaves where the wall has room for one."""
        width = self.doors[0].width_m + 0.12
        leaf = TexturePicker.series("door_leaf", self.style.series_seed, width, DOOR_HEIGHT_M, 250)
        for side, run in enumerate(runs):
            for s in np.arange(width / 2 + 0.15, run.length_m - width / 2 - 0.1, 0.2):
                if self._is_open(side, float(s), width + 0.2) and rng.random() < 0.6:
                    low, high = float(s) - width / 2, float(s) + width / 2
                    self._hang(run, low, high, (0.0, DOOR_HEIGHT_M), leaf, OFF_WALL_M)
                    self.hung[side].append((low, high))
                    self.taken.append(self._footprint(run, low, high, 0.5))

    def _build_sockets(self, runs: list[WallRun], rng: np.random.Generator) -> None:
        """Up to three at a wall, a hand above the skirting board; all alike."""
        look = TexturePicker.series("socket", self.style.series_seed, 0.15, 0.08, 500)
        for side, run in enumerate(runs):
            for s in rng.uniform(0.2, run.length_m - 0.3, int(rng.integers(0, 4))):
                if self._is_open(side, float(s) + 0.08, 0.2):
                    self._hang(run, float(s), float(s) + 0.15, (0.26, 0.34), look, OFF_WALL_M)
                    self.hung[side].append((float(s), float(s) + 0.15))

    def _hang_small_things(self, runs: list[WallRun], rng: np.random.Generator) -> None:
        """A light switch beside each door, plugs and their cable at a skirting board, a clock or a board for notes."""
        series = TexturePicker.series
        switch = series("switch", self.style.series_seed, 0.08, 0.08, 500)
        strip, cable = series("power_strip", self.seed, 0.36, 0.06, 500), series("lacquer", self.seed, 0.008, 0.3, 400)
        socket = series("socket", self.style.series_seed, 0.15, 0.08, 500)
        for side, run in enumerate(runs):
            for _, high in run.openings:
                self._hang_if_open(side, run, high + 0.2, 1.05, switch)
            s = float(rng.uniform(0.3, run.length_m - 0.7))
            if rng.random() < STRIP_SHARE and self._is_open(side, s + 0.18, 0.36):
                self._hang(run, s, s + 0.36, (0.005, 0.065), strip, 0.03)
                self._hang(run, s + 0.05, s + 0.058, (0.065, 0.27), cable, OFF_WALL_M)
                self._hang(run, s, s + 0.15, (0.26, 0.34), socket, OFF_WALL_M)
                self.hung[side].append((s, s + 0.36))
        clock = series("clock", self.style.series_seed, 0.26, 0.26, 350)
        notes = series("note_board", self.seed, 0.5, 0.4, 300)
        for look, z0 in ((clock, 1.5), (notes, 0.75)):
            side = int(rng.integers(0, 4))
            middle = float(rng.uniform(0.4, 0.6)) * runs[side].length_m
            self._hang_if_open(side, runs[side], middle, z0, look)

    def _hang_if_open(self, side: int, run: WallRun, middle: float, z0: float, look: TextureSpec) -> None:
        """Hang something of its texture's size, its lower edge at z0, where the wall has room for it."""
        width = look.width_m
        if middle + width / 2 < run.length_m and self._is_open(side, middle, width):
            self._hang(run, middle - width / 2, middle + width / 2, (z0, z0 + look.height_m), look, OFF_WALL_M)
            self.hung[side].append((middle - width / 2, middle + width / 2))

    def _hang_prints(self, runs: list[WallRun], rng: np.random.Generator) -> None:
        """At most one picture on a wall, most walls have none."""
        for side, run in enumerate(runs):
            width, height, s, chance = (float(v) for v in rng.uniform([0.3, 0.3, 0.3, 0.0], [0.7, 0.6, 0.7, 1.0]))
            middle = s * run.length_m
            if chance < 0.75 and self._is_open(side, middle, width + 0.1):
                z0 = float(rng.choice([0.3, 0.55, 0.95]))
                look = TexturePicker.series("print", int(rng.integers(0, 2**31)), width, height, 350)
                self._hang(run, middle - width / 2, middle + width / 2, (z0, z0 + height), look, OFF_WALL_M)

    def _hang(
        self,
        run: WallRun,
        low: float,
        high: float,
        z_range: tuple[float, float],
        look: TextureSpec,
        off_m: float,
    ) -> None:
        self.builder.upright(self._before(run, low, off_m), self._before(run, high, off_m), z_range, look, self.index)

    # --- what stands ----------------------------------------------------------------------------------------------

    def _stand(self, name: str, runs: list[WallRun], rng: np.random.Generator, pick: TexturePicker) -> None:
        """Stand a piece at one of the walls where it leaves door and passage free; leave it out where nothing fits."""
        piece = PLAIN_PIECES[name]
        piece_rng = np.random.default_rng(int(rng.integers(0, 2**31)))
        if self.style.moved_seed is not None and name in MOVABLE:
            rng = np.random.default_rng([self.style.moved_seed, int(rng.integers(0, 2**31))])
        for _ in range(PLACE_TRIES):
            side = int(rng.integers(0, 4))
            run, width = runs[side], float(rng.uniform(*piece.width_m))
            if width + 0.1 > run.length_m:
                continue
            low = float(rng.uniform(0.03, run.length_m - width - 0.03))
            where = self._footprint(run, low - 0.03, low + width + 0.03, piece.depth_m)
            if any(where.meets(box) for box in self.taken) or not self._leaves_passage(side, piece.depth_m):
                continue
            pose = Pose2(*run.at(low + width / 2), run.yaw_rad)
            piece.build(Site(self.builder, pick, piece_rng, pose, width, piece.depth_m, self.index, name))
            self.taken.append(where)
            self.hung[side].append((low, low + width))
            self.deepest_m[side] = max(self.deepest_m[side], piece.depth_m)
            return

    def _leaves_passage(self, side: int, depth_m: float) -> bool:
        across = self.room.y1_m - self.room.y0_m if side in (0, 2) else self.room.x1_m - self.room.x0_m
        return across - depth_m - self.deepest_m[(side + 2) % 4] >= PASSAGE_M

    def _build_lamp(self, runs: list[WallRun], rng: np.random.Generator) -> None:
        """A standard lamp by a wall: its shade shines, its light makes a pool around it."""
        for _ in range(4 * PLACE_TRIES):
            side = int(rng.integers(0, 4))
            low = float(rng.uniform(0.1, runs[side].length_m - 0.4))
            where = self._footprint(runs[side], low, low + 0.3, 0.35)
            if not any(where.meets(box) for box in self.taken):
                self._standard_lamp(runs[side], low + 0.15, float(rng.choice([0.45, 0.75, 1.35])))
                self.taken.append(where)
                self.deepest_m[side] = max(self.deepest_m[side], 0.35)
                return

    def _standard_lamp(self, run: WallRun, s_m: float, shade_z_m: float) -> None:
        shade = TexturePicker.series("lamp_shade", self.style.series_seed, 0.28, 0.25, 250)
        metal = TexturePicker.series("lacquer", self.style.series_seed + 1, 0.22, shade_z_m, 250)
        pose = Pose2(*self._before(run, s_m, 0.18), run.yaw_rad)
        self.builder.box(pose, (0.22, 0.22, 0.03), 0.0, self.index, "lamp", metal, metal, metal)
        self.builder.box(pose, (0.03, 0.03, shade_z_m), 0.0, self.index, "lamp", metal, metal, metal, solid=False)
        self.builder.box(pose, (0.28, 0.28, 0.25), shade_z_m, self.index, "lamp", shade, shade, shade, solid=False)
        x, y = self._before(run, s_m, 0.3)
        self.lamps.append(Lamp(self.index, (x, y, shade_z_m + 0.12), 0.4))

    # --- where ----------------------------------------------------------------------------------------------------

    @staticmethod
    def _before(run: WallRun, s_m: float, off_m: float) -> tuple[float, float]:
        """A point off a wall, into the room."""
        x, y = run.at(s_m)
        return x - off_m * math.sin(run.yaw_rad), y + off_m * math.cos(run.yaw_rad)

    def _footprint(self, run: WallRun, low: float, high: float, depth_m: float) -> _Box:
        corners = np.array([self._before(run, s, off) for s in (low, high) for off in (0.0, depth_m)])
        return _Box(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())

    def _is_open(self, side: int, middle: float, width: float) -> bool:
        """Whether nothing hangs or stands at this part of a wall."""
        return all(middle + width / 2 < low or high < middle - width / 2 for low, high in self.hung[side])
