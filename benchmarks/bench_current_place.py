"""The current place in simulated flats: drives with a hijack in the middle, one room left unmapped.

    python -m benchmarks.bench_current_place [--world small] [--flats 3] [--drives 5] [--seed 0] [--out FILE.json]
        [--figure FILE.png] [--from FILE.json …] [--results FILE]

`--figure` draws the calibration curve of the drives; `--from` takes them from what earlier runs left by `--out`, and
drives nothing; no results are written then, since they would not be those of the present code.

Stand-in: the map's keyframe poses and landmark depths are the simulator's (depths with 1 % noise), so that the
figures are those of localisation and of the estimator, not of a SLAM backend. Drives, images, IMU, slip and hijacks are
the simulated robot's with all imperfections; the tracker sees only what a robot sends. Truth judges: a known answer is
right when the place is nearest to the true position, ties within 10 %; in the room left unmapped the right answer is
"unknown" (or "lost", counted apart). In a doorway both are right: answers in the unmapped room nearer than 0.5 m to
where the mapping drive went are left out of the unmapped ones, and counted.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.result import Figure, Run, add_results_option, share
from robot.simulation.atlas import default_cache_dir
from robot.simulation.body import Body
from robot.simulation.config import Faults, SimulationConfig
from robot.simulation.driver import RouteDriver
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer, unproject_pixels
from robot.simulation.routes import plan_route
from robot.simulation.sensors import ImuModel
from robot.simulation.trajectory import MotionHistory
from robot.simulation.world import World
from robot.simulation.worlds import make_world
from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse
from station.experiments.calibration_curve import calibration_bins, draw_calibration
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap
from station.places.localisation.localizer import Localizer
from station.places.making.build import build_map
from station.places.tracking.tracker import PlaceTracker
from station.vision.features import FeatureExtractor, to_floats

START_NS = 1_000_000_000
KEYFRAME_M, KEYFRAME_RAD = 0.2, 0.2
MERGE_M = 0.06
DOORWAY_M = 0.5


def no_faults(_t_s: float) -> Faults:
    return Faults()


class Robot:
    """A simulated robot on a route; `sense` yields what it would send."""

    def __init__(self, world: World, renderer: Renderer, calibration: Calibration, kind: str, seed: int) -> None:
        self.world, self._calibration = world, calibration
        self._config = SimulationConfig()
        assert calibration.camera is not None and calibration.imu is not None
        self._camera_calibration = calibration.camera
        self.route = plan_route(world, kind, seed)
        self.body = Body(world, self._config.body, (*self.route.points[0], self.route.start_yaw_rad), seed)
        self._imu = ImuModel(calibration.imu, self._config.imu, calibration.gravity, seed)
        self._camera = SimulatedCamera(renderer, calibration.camera, self._config.camera, seed)
        self.history = MotionHistory(keep_s=2.0)

    def sense(
        self,
        seconds: float,
        frame_period_s: float,
        hijack: tuple[float, FloatArray] | None,
        faults_at: Callable[[float], Faults] = no_faults,
    ) -> Iterator[Any]:
        """Yields ImuBatch, DriveSample, ImageFrame, and ("hijack", t_ns) when hands take the robot."""
        driver = RouteDriver(self.route)
        state, ticks, next_frame_s, index = self.body.state(), 0, 0.2, 0
        batch: list[tuple[int, FloatArray, FloatArray]] = []
        hijacked = False
        camera = self._camera_calibration
        while state.t_s < seconds and not (driver.is_done and hijack is None):
            self.history.append(state)
            t_ns = START_NS + round(state.t_s * 1e9)
            m = self._imu.measure(state)
            batch.append((t_ns, m.gyro_imu, m.accel_imu))
            if len(batch) == 10:
                yield ImuBatch(*(np.array(column) for column in zip(*batch, strict=True)))
                batch = []
            if state.t_s - next_frame_s > camera.line_delay_s * camera.height + 0.02:
                carried = self.history.carried(next_frame_s)
                exposure = self._camera.expose(self.history.pose, next_frame_s, faults_at(next_frame_s), carried)
                stamp = START_NS + round((next_frame_s - camera.time_shift_s) * 1e9)
                yield ImageFrame(index, stamp, round(exposure.exposure_s * 1e9), exposure.jpeg)
                index += 1
                next_frame_s += frame_period_s
            if ticks % 15 == 0 and state.t_s > 1.5 and not hijacked:
                command = driver.command(*self.body.pose, float(state.omega_body[2]))
                self.body.command(command.linear_m_s, command.angular_rad_s)
                yield DriveSample(t_ns, command.linear_m_s, command.angular_rad_s)
            elif ticks % 15 == 0 and hijacked and hijack is not None:
                # Put down, the driver looks around: turns on the spot.
                turning = 1.5 if state.t_s > hijack[0] + 5.0 else 0.0
                self.body.command(0.0, turning)
                yield DriveSample(t_ns, 0.0, turning)
            if hijack is not None and not hijacked and state.t_s >= hijack[0]:
                hijacked = True
                self.body.command(0.0, 0.0)
                self.body.hijack(*(float(v) for v in hijack[1]))
                yield "hijack", t_ns
            state = self.body.step()
            ticks += 1


def map_flat(world: World, renderer: Renderer, calibration: Calibration, seed: int, unmapped: str | None) -> PlaceMap:
    """A map along the mapping route with the simulator's poses and depths, without keyframes in one room."""
    camera = calibration.camera
    assert camera is not None
    robot = Robot(world, renderer, calibration, "mapping", seed)
    extractor, rays = FeatureExtractor(), unproject_pixels(camera)
    rng = np.random.default_rng(seed)
    T_body_cam = camera.T_body_cam_matrix
    poses: list[FloatArray] = []
    frames: list[ImageFrame] = []
    points: list[FloatArray] = []
    landmark, keyframe, uv_all = [], [], []
    previous: list[tuple[np.ndarray, list[int]]] = []  # descriptors and landmark numbers of the last keyframes
    for item in robot.sense(300.0, 0.25, None):
        if not isinstance(item, ImageFrame):
            continue
        middle = camera.line_delay_s * camera.height / 2
        T_body = robot.history.pose((item.t_robot_ns - START_NS) / 1e9 + camera.time_shift_s + middle)
        if unmapped is not None and world.room_at(*T_body[:2, 3]) == unmapped:
            continue
        T = T_body @ T_body_cam
        if poses:
            moved = inverse(poses[-1]) @ T
            turn = math.acos(float(np.clip((np.trace(moved[:3, :3]) - 1) / 2, -1, 1)))
            if np.linalg.norm(moved[:3, 3]) < KEYFRAME_M and turn < KEYFRAME_RAD:
                continue
        features = extractor.extract(item.grey())
        if len(features) < 30:
            continue  # a view of nothing
        at = np.clip(np.round(features.uv_px).astype(int), 0, [camera.width - 1, camera.height - 1])
        inverse_depth = renderer.render(T[None]).inverse_depth[at[:, 1], at[:, 0]]
        depth = 1.0 / np.maximum(inverse_depth, 1e-3) * rng.normal(1, 0.01, len(at))
        p = (rays[at[:, 1], :, at[:, 0]] * depth[:, None]) @ T[:3, :3].T + T[:3, 3]
        numbers = []
        mine = to_floats(features.descriptors)
        nearest = [np.argmax(mine @ descriptors.T, axis=1) for descriptors, _ in previous]
        for k in range(len(p)):
            number = -1
            if inverse_depth[k] > 0.1:
                for best, (_, ids) in zip(nearest[::-1], previous[::-1], strict=True):
                    j = int(best[k])
                    if ids[j] >= 0 and np.linalg.norm(points[ids[j]] - p[k]) < MERGE_M:
                        number = ids[j]
                        break
                if number < 0:
                    number = len(points)
                    points.append(p[k])
                landmark.append(number)
                keyframe.append(len(poses))
                uv_all.append(features.uv_px[k])
            numbers.append(number)
        previous = [*previous[-2:], (mine, numbers)]
        poses.append(T)
        frames.append(item)
    seen = np.bincount(landmark, minlength=len(points))
    keep = seen >= 2
    new_number = np.cumsum(keep) - 1
    observed = keep[np.array(landmark)]
    t = np.array([f.t_robot_ns for f in frames])
    T_all = np.stack(poses)
    count = int(keep.sum())
    return build_map(
        Navigation(
            id=f"truth-{world.name}-{world.seed}-{unmapped}",
            calibration=calibration,
            trajectory=Trajectory(t, T_all @ inverse(T_body_cam)),
            keyframes=Keyframes(
                np.arange(len(t)), t, T_all, tuple(f.encoded for f in frames), np.zeros(len(t), np.int64)
            ),
            landmarks=Landmarks(
                np.array(points)[keep],
                np.full((count, 3), 128, np.uint8),
                np.zeros((count, 3, 3)),
                new_number[np.array(landmark)[observed]],
                np.array(keyframe)[observed],
                np.array(uv_all)[observed],
            ),
            report=NavigationReport("simulator", len(t), 0.0, 0.0, 0.0, 0.0, count, 0.0, "metric", True, seed, {}, {}),
        )
    )


def unmapped_room(world: World) -> str:
    """The room that the mapping drive leaves out."""
    return world.rooms[world.seed % len(world.rooms)].name


def flat_to_drive(
    name: str, flat: int, calibration: Calibration, *, whole: bool
) -> tuple[World, Renderer, PlaceMap, Localizer]:
    """A flat, its renderer, a map of it (`whole`, or without its unmapped room), and the localiser of that map."""
    assert calibration.camera is not None
    world = make_world(name, flat)
    renderer = Renderer(world, calibration.camera, default_cache_dir())
    place_map = map_flat(world, renderer, calibration, flat, None if whole else unmapped_room(world))
    return world, renderer, place_map, Localizer([place_map])


def right_places(place_map: PlaceMap, T_world_body: FloatArray) -> set[str]:
    """Ids of the places nearest to the true position, ties within 10 %."""
    distance = np.linalg.norm([p.centroid_map - T_world_body[:3, 3] for p in place_map.places], axis=1)
    return {place_map.places[i].id for i in np.flatnonzero(distance <= 1.1 * distance.min())}


@dataclass(frozen=True, slots=True, eq=False)
class PlannedHijack:
    """When and where hands will put the robot down."""

    at_s: float
    target: FloatArray  # (3,) x, y, yaw in the world
    to_unmapped: bool


def planned_hijack(world: World, robot: Robot, unmapped: str, seed: int) -> PlannedHijack:
    """Somewhere on its route, at any yaw; every fourth drive ends in the unmapped room, where its route enters it."""
    rng = np.random.default_rng([world.seed, seed, 5])
    spots = robot.route.points
    in_unmapped = np.array([world.room_at(*p) == unmapped for p in spots])
    to_unmapped = bool(seed % 4 == 3 and in_unmapped.any())
    spot = spots[rng.choice(np.flatnonzero(in_unmapped if to_unmapped else ~in_unmapped))]
    at_s = float(rng.uniform(12, 20))
    return PlannedHijack(at_s, np.array([*spot, rng.uniform(-np.pi, np.pi)]), to_unmapped)


def judge_drive(
    world: World, renderer: Renderer, calibration: Calibration, place_map: PlaceMap, localizer: Localizer,
    unmapped: str, seed: int,
) -> dict[str, Any]:  # fmt: skip
    """One drive with a hijack; answers once per image."""
    robot = Robot(world, renderer, calibration, "second", seed)
    hijack = planned_hijack(world, robot, unmapped, seed)
    tracker = PlaceTracker([place_map], calibration, localizer)
    driven = place_map.navigation.keyframes.T_world_cam[:, :2, 3]
    rows: list[tuple[str, bool, float, bool, float | None, bool]] = []
    hijack_ns: int | None = None
    noticed: tuple[int, str, str] | None = None
    for item in robot.sense(hijack.at_s + 17.0, 0.4, (hijack.at_s, hijack.target)):
        if isinstance(item, ImuBatch):
            tracker.on_imu(item)
        elif isinstance(item, DriveSample):
            tracker.on_drive(item)
        elif isinstance(item, ImageFrame):
            tracker.on_frame(item)
            assert calibration.camera is not None
            t_ns = item.t_robot_ns + round(1e9 * calibration.camera.time_shift_s)  # the simulator's and the IMU's clock
            T = robot.history.pose((t_ns - START_NS) / 1e9)
            right = right_places(place_map, T)
            answer = tracker.answer(t_ns)
            since = None if hijack_ns is None else (t_ns - hijack_ns) / 1e9
            is_mapped = world.room_at(*T[:2, 3]) != unmapped
            in_doorway = not is_mapped and float(np.linalg.norm(driven - T[:2, 3], axis=1).min()) < DOORWAY_M
            place = answer.place
            rows.append(
                (answer.state, place is not None and place.id in right, place.probability if place else 0.0,
                 is_mapped, since, in_doorway)
            )  # fmt: skip
        else:
            hijack_ns = item[1]
        for event in tracker.take_events():
            noticed = noticed or (event.t_robot_ns, event.cue, event.reason)
    # The first seconds belong to no answer yet: the robot has seen one or two images.
    settled = [r for r in rows[5:] if r[4] is None or r[4] > 10.0]
    after = [r for r in rows if r[4] is not None and r[4] > 3.0]
    first_right = next((r[4] for r in after if r[0] == "known" and r[1]), None)
    return {
        "flat": world.seed,
        "drive": seed,
        "target": "unmapped" if hijack.to_unmapped else "mapped",
        "noticed_s": None if noticed is None or hijack_ns is None else (noticed[0] - hijack_ns) / 1e9,
        "cue": None if noticed is None else noticed[1],
        "right_after_s": first_right,
        "wrong_known_after": sum(r[0] == "known" and not (r[1] and (r[3] or r[5])) for r in after),
        "answers_after": len(after),
        "rows": [(r[0], bool(r[1]), float(r[2]), bool(r[3]), bool(r[5])) for r in settled],
    }


def summarise(drives: list[dict[str, Any]]) -> dict[str, Any]:
    rows = [r for d in drives for r in d["rows"]]
    mapped = [r for r in rows if r[3]]
    known = [r for r in mapped if r[0] == "known"]
    unmapped = [r for r in rows if not r[3] and not r[4]]
    to_mapped = [d for d in drives if d["target"] == "mapped"]
    probability = np.array([r[2] for r in known])
    correct = np.array([r[1] for r in known], dtype=float)
    bins = np.clip((probability * 10).astype(int), 0, 9)
    ece = sum(
        (bins == b).mean() * abs(correct[bins == b].mean() - probability[bins == b].mean()) for b in np.unique(bins)
    )
    return {
        "drives": len(drives),
        "answers_mapped": len(mapped),
        "precision_when_known": float(correct.mean()) if len(known) else None,
        "recall": float(sum(r[1] for r in known) / max(len(mapped), 1)),
        "answers_unmapped": len(unmapped),
        "answers_in_doorway": sum(r[4] for r in rows),
        "unmapped_unknown": float(np.mean([r[0] == "unknown" for r in unmapped])) if unmapped else None,
        "unmapped_known": float(np.mean([r[0] == "known" for r in unmapped])) if unmapped else None,
        "expected_calibration_error": float(ece),
        "hijacks_noticed_2s": float(np.mean([d["noticed_s"] is not None and 0 <= d["noticed_s"] <= 2 for d in drives])),
        "right_within_10s": float(
            np.mean([d["right_after_s"] is not None and d["right_after_s"] <= 12.0 for d in to_mapped])
        ) if to_mapped else None,
        "wrong_known_after_hijack": sum(d["wrong_known_after"] for d in drives)
        / max(1, sum(d["answers_after"] for d in drives)),
    }  # fmt: skip


def figures(drives: list[dict[str, Any]], summary: dict[str, Any]) -> list[Figure]:
    """What is asked of the current place."""
    rows = [r for d in drives for r in d["rows"]]
    known = sum(r[3] and r[0] == "known" for r in rows)
    to_mapped = sum(d["target"] == "mapped" for d in drives)
    answers_after = sum(d["answers_after"] for d in drives)
    mapped, unmapped = summary["answers_mapped"], summary["answers_unmapped"]

    def part(what: str, key: str, of: int, **bound: float) -> Figure:
        return share(what, (summary[key] or 0.0) * of, of, **bound)

    return [
        part("known in a mapped room: right", "precision_when_known", known, at_least=99),
        part("answers in mapped rooms: known and right", "recall", mapped, at_least=85),
        part("answers in a room that no map knows: unknown", "unmapped_unknown", unmapped, at_least=95),
        Figure("expected calibration error", summary["expected_calibration_error"], at_most=0.05, of=known),
        part("hijack noticed within 2 s", "hijacks_noticed_2s", len(drives), at_least=95),
        part("right place within 10 s after a hijack to a mapped room", "right_within_10s", to_mapped, at_least=90),
        part("known and wrong after a hijack", "wrong_known_after_hijack", answers_after, at_most=1),
    ]


def draw(drives: list[dict[str, Any]], path: Path) -> None:
    """The calibration curve: of answers "known" in mapped rooms, which the error in the summary is made of, and of all.

    In a doorway to the unmapped room an answer is judged like in a mapped one; beyond it every "known" is wrong.
    """
    known = [r for d in drives for r in d["rows"] if r[0] == "known"]
    mapped = calibration_bins((r[2], r[1]) for r in known if r[3])
    anywhere = calibration_bins((r[2], r[1] and (r[3] or r[4])) for r in known)
    draw_calibration([("mapped rooms", mapped), ("unmapped room included", anywhere)], path)


def drive_flats(name: str, flats: range, num_drives: int) -> list[dict[str, Any]]:
    """All drives through these flats, judged; each is told as it ends."""
    cv2.setNumThreads(1)
    calibration = simulated_calibration(SimulationConfig())
    assert calibration.camera is not None
    drives: list[dict[str, Any]] = []
    for flat in flats:
        world, renderer, place_map, localizer = flat_to_drive(name, flat, calibration, whole=False)
        unmapped = unmapped_room(world)
        print(f"flat {flat}: {len(place_map.navigation.keyframes)} keyframes, {len(place_map.places)} places, "
              f"{len(place_map.navigation.landmarks)} landmarks, without the {unmapped}", flush=True)  # fmt: skip
        for drive in range(1, num_drives + 1):
            result = judge_drive(world, renderer, calibration, place_map, localizer, unmapped, drive)
            drives.append(result)
            print(json.dumps({k: v for k, v in result.items() if k != "rows"}), flush=True)
    return drives


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", default="small")
    parser.add_argument("--flats", type=int, default=3)
    parser.add_argument("--drives", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--figure", type=Path, default=None, help="draw the calibration curve into this file")
    parser.add_argument(
        "--from", dest="earlier", nargs="+", type=Path, help="draw and count earlier runs, drive nothing"
    )
    add_results_option(parser, "current_place")
    a = parser.parse_args()
    run = Run.begin()
    if a.earlier:
        drives = [drive for path in a.earlier for drive in json.loads(path.read_text())["drives"]]
    else:
        drives = drive_flats(a.world, range(a.seed, a.seed + a.flats), a.drives)
    summary = summarise(drives)
    print(json.dumps(summary, indent=1))
    if not a.earlier:
        run.write(a.results, figures(drives, summary))
    if a.out:
        a.out.write_text(json.dumps({"summary": summary, "drives": drives}))
    if a.figure:
        draw(drives, a.figure)


if __name__ == "__main__":
    main()
