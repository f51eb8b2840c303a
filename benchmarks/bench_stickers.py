"""Does a sticker that is seen once name its room? Rendered views of flats, each with one sticker somewhere on a wall.

    python -m benchmarks.bench_stickers --tries 100

The robot drives by (up to 0.3 m/s and 0.3 rad/s) at 1.5 m, up to 40 degrees oblique; one picture with lens blur, motion
blur, noise and JPEG is a whole map, whose scale and pose are right within 1 %. Through the reference robot's camera
(33 degrees) and one of 60 degrees. Names are the flats' rooms; long ones are tried apart. One JSON line per row.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from benchmarks.result import Figure, Run, add_results_option, share
from robot.simulation.config import SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.stickers import glued, spots_in
from robot.simulation.world import World
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT, CameraCalibration
from shared.geometry import FloatArray, inverse, se3, so3_exp, transform, yaw_rotation
from shared.room_sticker import CODE_SIDE_M
from station.model.floor_plan import FREE, NO_ROOM, FloorPlan, Room
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap
from station.places.naming.stickers import stickers_in
from station.vision.lens import Lens

CELL_M = 0.05
OBLIQUE_RAD = math.radians(40)
LONG_NAMES = ("Guest room upstairs", "Schlafzimmer der Kinder", "Laundry and storage")
WIDE_FOCAL_PX = 320 / math.tan(math.radians(30))
TILT_RAD = math.radians(3)
SETTLING = 8  # pictures until auto-exposure has settled


def true_plan(world: World) -> FloorPlan:
    """The floor plan that perfect sensors would give."""
    x0, y0, x1, y1 = world.bounds()
    shape = math.ceil((x1 - x0) / CELL_M), math.ceil((y1 - y0) / CELL_M)
    x, y = (low + CELL_M * (np.arange(n) + 0.5) for low, n in zip((x0, y0), shape, strict=True))
    number = np.full(shape, NO_ROOM, np.int16)
    rooms = []
    for k, room in enumerate(world.rooms):
        inside = ((x > room.x0_m) & (x < room.x1_m))[:, None] & ((y > room.y0_m) & (y < room.y1_m))[None]
        number[inside] = k
        rooms.append(Room(f"room-{k}", f"Room {k + 1}", float(inside.sum() * CELL_M**2), np.array(room.centre)))
    state = np.where(number == NO_ROOM, 2, FREE).astype(np.uint8)
    return FloorPlan(
        np.eye(3), np.array([x0, y0]), CELL_M, 1.0, state, number, tuple(rooms), (), np.zeros((0, 2, 2))
    )  # fmt: skip


def map_of_one(camera: CameraCalibration, encoded: bytes, T_world_cam: FloatArray) -> PlaceMap:
    """A map that is one picture."""
    t = np.zeros(1, np.int64)
    none = np.zeros(0, np.int64)
    return PlaceMap(
        "map-sticker", "One picture",
        Navigation(
            "one", msgspec.structs.replace(REFERENCE_ROBOT, camera=camera),
            Trajectory(t, T_world_cam[None] @ inverse(camera.T_body_cam_matrix)),
            Keyframes(t, t, T_world_cam[None], (encoded,), t),
            Landmarks(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3, 3)), none, none, np.zeros((0, 2))),
            NavigationReport("simulator", 1, 0.0, 0.0, 0.0, 0.0, 0, 0.0, "metric", True, 0, {}, {}),
        ), (), (), {},
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A sticker on a wall, and where a robot drives by."""

    world: World  # with the sticker, its last surface
    room: int
    T_world_body: FloatArray
    speed_m_s: float
    rate_rad_s: float

    def pose(self, t_s: float) -> FloatArray:
        step = np.array([self.speed_m_s * t_s, 0.0, 0.0])
        return self.T_world_body @ se3(yaw_rotation(self.rate_rad_s * t_s), step)


def any_view(world: World, room: int, rng: np.random.Generator, distance_m: float, name: str) -> View:
    """A sticker somewhere in a room, on a wall or a piece of furniture, and a pose that looks about at it."""
    spots = spots_in(world, room)
    while True:
        spot = spots[int(rng.integers(len(spots)))]
        middle = spot.corners().mean(axis=0)
        stand = middle + distance_m * (yaw_rotation(float(rng.uniform(-OBLIQUE_RAD, OBLIQUE_RAD))) @ spot.normal)
        if not world.room_at(*stand[:2]):
            continue
        looks = math.atan2(*(middle - stand)[1::-1]) + float(rng.uniform(-0.12, 0.12))
        tilt = so3_exp(np.array([0.0, float(rng.uniform(-TILT_RAD, TILT_RAD)), 0.0]))
        T = se3(yaw_rotation(looks) @ tilt, np.array([*stand[:2], 0.25]))
        T[:2, 3] -= (T[:3, :3] @ REFERENCE_CAMERA.T_body_cam_matrix[:3, 3])[:2]
        shown = replace(world, surfaces=(*world.surfaces, glued(spot, name or world.rooms[room].name)))
        return View(shown, room, T, float(rng.uniform(0, 0.3)), float(rng.uniform(-0.3, 0.3)))


def is_whole(view: View, bare: Renderer, T_world_cam: FloatArray) -> bool:
    """Whether a picture shows all of the sticker's code: nothing stands before it, no border of the picture cuts it."""
    page = view.world.surfaces[-1]
    rim = (page.width_m - CODE_SIDE_M) / 2
    u, v = (a.ravel() for a in np.meshgrid(*2 * [rim + np.linspace(0.0, CODE_SIDE_M, 9)]))
    p = np.array(page.origin) + u[:, None] * np.array(page.eu) + v[:, None] * np.array(page.ev)
    p_cam = transform(inverse(T_world_cam), p)
    uv = Lens(bare.camera).project(p_cam[:, :2] / p_cam[:, 2:])
    if not Lens(bare.camera).is_inside(uv, 8.0).all():
        return False
    x, y = np.round(uv).astype(int).T
    return bool((bare.render(T_world_cam[None]).inverse_depth[y, x] < 1 / p_cam[:, 2]).all())


def attempt(world: World, camera: CameraCalibration, rng: np.random.Generator, distance_m: float, name: str) -> str:
    """One sticker somewhere in a flat, seen once from that far: "right", "wrong" or "nothing"."""
    room = int(rng.integers(len(world.rooms)))
    # Of the other rooms nothing is painted, which takes most of the time: doors lead into the dark.
    furnished = replace(world, surfaces=tuple(s for s in world.surfaces if s.room == room))
    bare = Renderer(furnished, camera)
    while True:
        view = any_view(furnished, room, rng, distance_m, name)
        T_world_cam = view.pose(camera.middle_row_shift_s - camera.time_shift_s) @ camera.T_body_cam_matrix
        if is_whole(view, bare, T_world_cam):
            break
    config = SimulationConfig()
    device = SimulatedCamera(Renderer(view.world, camera), camera, config.camera, int(rng.integers(2**31)))
    for _ in range(SETTLING):
        exposure = device.expose(view.pose, 0.0, config.faults)
    T_world_cam[:3, 3] += rng.normal(0, 0.01 * distance_m, 3)
    found = stickers_in(map_of_one(camera, exposure.jpeg, T_world_cam), true_plan(world))
    if not found:
        return "nothing"
    expected = (f"room-{view.room}", name or world.rooms[view.room].name)
    return "right" if [(s.room, s.name) for s in found] == [expected] else "wrong"


def row(
    seeds: range, camera: CameraCalibration, distance_m: float, names: tuple[str, ...] = ("",), first: int = 0
) -> Counter[str]:
    """A try in a flat of each seed, with the flat's own room names or the given ones."""
    outcome: Counter[str] = Counter()
    for k, seed in enumerate(seeds):
        rng = np.random.default_rng([seed, first, 41])
        world = make_world(("home", "small", "plain")[k % 3], seed)
        outcome[attempt(world, camera, rng, distance_m, names[k % len(names)])] += 1
    return outcome


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", type=int, default=100, help="of each row at 1.5 m; a fifth of it elsewhere")
    parser.add_argument("--first", type=int, default=8000, help="seed of the first flat")
    add_results_option(parser, "stickers")
    args = parser.parse_args()
    run = Run.begin()
    wide = msgspec.structs.replace(REFERENCE_CAMERA, fx=WIDE_FOCAL_PX, fy=WIDE_FOCAL_PX, distortion=(0.0,) * 4)
    figures: list[Figure] = []
    few = max(1, args.tries // 5)
    for label, camera in (("33 degrees", REFERENCE_CAMERA), ("60 degrees", wide)):
        for distance_m, names, tries, bound in (
            (1.5, ("",), args.tries, 95), (1.5, LONG_NAMES, few, None), (1.0, ("",), few, None),
            (2.0, ("",), few, None), (2.5, ("",), few, None),
        ):  # fmt: skip
            outcome = row(range(args.first, args.first + tries), camera, distance_m, names)
            kind = "a long name" if names[0] else "its room named"
            what = f"{label}, {distance_m} m"
            print(json.dumps({"row": f"{what}, {kind}", **outcome}), flush=True)
            figures.append(share(f"{what}: {kind}", outcome["right"], tries, at_least=bound))
            figures.append(share(f"{what}: {kind}, wrong", outcome["wrong"], tries, at_most=0))
    run.write(args.results, figures)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
