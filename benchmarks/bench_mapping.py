"""How good is a backend's map for places? Maps simulated flats, then looks for the pictures of a second drive in it.

    python -m benchmarks.bench_mapping --backend ukf --seeds 101-106 [--scratch DIR] [--step 1] [--rows FILE.jsonl]
        [--look-around 60 [--one-head]]

Per seed, as in the demo but without waiting for the clock: the mapping route through a flat of world `small`, the map
and its places, then 30 s of another route from a random spot, its pictures localised four times a second. Drives
are rendered where they are missing, with all imperfections on. The truth only judges: `ate` after alignment by position
and yaw; `localised`: share of the second drive's pictures with a verified pose; `position_m`: error of those poses
(median, 90 %, worst) after the map was laid on the truth; `right`: answers "known" that name the nearest place, ties
within 10 %.
With --look-around the camera's head turns so many degrees to both sides in both drives, by servos 3 degrees wrong:
those of one robot with --one-head, else each drive has its own, as where one robot maps and another asks.
One JSON line per seed, failures too; seeds that FILE (usually in benchmarks/results/work) already has are not run
again, so an interrupted run can go on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from shared.errors import RobotSystemError
from shared.geometry import FloatArray, inverse, transform
from station.config import BACKENDS
from station.datasets import Dataset, open_dataset
from station.demo.judge import is_right
from station.experiments.alignment import align_points
from station.experiments.trajectory_error import absolute_trajectory_error, path_length
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation, Trajectory
from station.model.place_map import PlaceMap
from station.motion.interpolation import interpolate_poses
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.making.build import build_map
from station.places.tracking.tracker import PlaceTracker
from station.slam.backends import make_backend
from station.slam.run import run_backend

LOOK_EVERY_NS = 250_000_000
SECOND_DRIVE_S = 30.0
MAX_OF_PATH_PERCENT = 0.3  # asked with a turning head


def render(out: Path, seed: int, world: str, *arguments: str) -> Path:
    """A simulated drive in the flat of this seed, made where it is missing."""
    if not out.exists():
        run_program("dataset", "--world", world, "--seed", str(seed), *arguments, "--out", str(out))
    return out


def run_program(*arguments: str) -> None:
    """Run robot-sim; raises CalledProcessError when it fails."""
    subprocess.run([sys.executable, "-m", "robot.simulation.cli", *arguments], check=True)


def trajectory_of(data: Dataset) -> Trajectory:
    """The truth as a trajectory."""
    truth = data.truth
    if truth is None:
        raise SystemExit(f"{data.path} has no truth; it cannot be judged")
    return Trajectory(truth.t_robot_ns, truth.T_world_body)


def map_navigation(path: Path, backend: str, step: int) -> tuple[Navigation, dict[str, Any]]:
    """The navigation of the mapping drive, and how far it is from the truth."""
    data = open_dataset(path, None, None, step)
    after = [0.0]
    nav = run_backend(
        make_backend(backend, data.calibration, 0, 1),
        data.events(),
        before_finish=lambda: after.append(time.process_time()),
    )
    truth = trajectory_of(data)
    free = absolute_trajectory_error(nav.trajectory, truth, "sim3")
    fixed = absolute_trajectory_error(nav.trajectory, truth, "yaw")
    return nav, {
        "path_m": round(path_length(truth), 1),
        "ate_m": round(fixed.rmse_m, 4),
        "ate_max_m": round(fixed.max_m, 4),
        "ate_sim3_m": round(free.rmse_m, 4),
        "rotation_deg": round(float(np.degrees(fixed.rotation_rmse_rad)), 2),
        "scale_error": round(1.0 / free.alignment.scale - 1.0, 4),
        "keyframes": len(nav.keyframes),
        "landmarks": len(nav.landmarks),
        "observations": len(nav.landmarks.observed_keyframe),
        "lost_s": round(nav.report.tracking_lost_s, 2),
        "cpu_s": round(nav.report.cpu_s, 1),
        "cpu_after_s": round(time.process_time() - after[-1], 1),
        "duration_s": round(nav.report.duration_s, 1),
        "messages": nav.report.messages,
    }


def second_drive(path: Path, backend: str, place_map: PlaceMap, T_truth_map: FloatArray) -> dict[str, Any]:
    """Pictures of another drive, looked for in the map as the station does it, judged by the truth."""
    data = open_dataset(path, None, None, 1)
    truth = trajectory_of(data)
    camera = data.calibration.camera
    assert camera is not None
    shift_ns = round(1e9 * camera.time_shift_s)
    tracker = PlaceTracker([place_map], data.calibration, Localizer([place_map], index=[make_index(place_map)]))
    live = make_backend(backend, data.calibration, 0, 1) if backend == "ukf" else None  # gives the odometry
    centroids = {p.id: transform(T_truth_map, p.centroid_map[None])[0] for p in place_map.places}
    looked = localised = 0
    errors: list[float] = []
    answers = {"right": 0, "wrong": 0, "not_known": 0}
    live_lost = 0
    next_look = 0
    for event in data.events():
        if isinstance(event, ImuBatch):
            tracker.on_imu(event)
        elif isinstance(event, DriveSample):
            tracker.on_drive(event)
        if live is not None:
            if isinstance(event, ImuBatch):
                live.add_imu(event)
            elif isinstance(event, DriveSample):
                live.add_drive(event)
            elif isinstance(event, ImageFrame):
                update = live.add_frame(event)
                if update.T_world_body is not None:
                    tracker.on_odometry(event.t_robot_ns + shift_ns, update.T_world_body, update.segment)
                live_lost += update.state == "lost"
        if not isinstance(event, ImageFrame) or event.t_robot_ns < next_look:
            continue
        next_look = event.t_robot_ns + LOOK_EVERY_NS
        attempt = tracker.on_frame(event)
        at = np.array([event.t_robot_ns + shift_ns], dtype=np.int64)
        T_true, known = interpolate_poses(truth, at)
        if not len(known):
            continue
        looked += 1
        if attempt is not None and attempt.candidates:
            localised += 1
            T_body_head = tracker.last_aim.T_body_head
            T = attempt.candidates[0].T_map_cam @ camera.T_cam_body_matrix @ inverse(T_body_head)
            errors.append(float(np.linalg.norm(transform(T_truth_map, T[None, :3, 3])[0] - T_true[0, :3, 3])))
        answer = tracker.answer(int(at[0]))
        if answer.state != "known" or answer.place is None:
            answers["not_known"] += 1
        else:
            answers["right" if is_right(answer.place.id, centroids, T_true[0, :3, 3]) else "wrong"] += 1
    return {
        "looked": looked,
        "localised": round(localised / max(looked, 1), 3),
        "position_m": [round(float(x), 3) for x in np.percentile(errors, [50, 90, 100])] if errors else None,
        **answers,
        "live_frames_lost": live_lost,
    }


def turning_head(seed: int, around: int, one_head: bool, scratch: Path) -> tuple[str, ...]:
    """Arguments of robot-sim for a head that turns so many degrees to both sides, by its own servos or the flat's."""
    if not one_head:
        return ("--look-around", str(around)) if around else ()
    config = scratch / f"head-{seed}.toml"
    config.write_text(f"[servos]\nseed = {seed}\n")
    return ("--look-around", str(around), "--config", str(config))


def run_seed(
    seed: int, world: str, backend: str, step: int, around: int, one_head: bool, scratch: Path
) -> dict[str, Any]:
    """One flat: map it, look for another drive in it."""
    row: dict[str, Any] = {
        "world": world, "seed": seed, "backend": backend, "step": step, "look_around": around, "one_head": one_head,
    }  # fmt: skip
    turning = turning_head(seed, around, one_head, scratch)
    name = f"{world}{seed}" + (f"-around{around}" if around else "") + ("-one-head" if one_head else "")
    first = render(
        scratch / f"{name}-mapping", seed, world, "--route", "mapping", "--drive-seed", str(seed), *turning,
    )  # fmt: skip
    second = render(
        scratch / f"{name}-second", seed, world, "--route", "second", "--drive-seed", str(seed + 1000),
        "--put-down", str(seed), "--fps", "10", "--max-duration", str(SECOND_DRIVE_S), *turning,
    )  # fmt: skip
    try:
        nav, figures = map_navigation(first, backend, step)
        row |= figures
        place_map = build_map(nav)
        row["places"] = len(place_map.places)
        truth = trajectory_of(open_dataset(first, None, None, 1))
        T_true, known = interpolate_poses(truth, nav.trajectory.t_robot_ns)
        laid = align_points(T_true[:, :3, 3], nav.trajectory.T_world_body[known, :3, 3], kind="sim3")
        row |= second_drive(second, backend, place_map, laid.T_target_source)
    except RobotSystemError as exc:
        row["failed"] = str(exc)
    return row


def parse_seeds(text: str) -> list[int]:
    """`101-106` or `3,5,8`."""
    seeds: list[int] = []
    for part in text.split(","):
        begin, _, end = part.partition("-")
        seeds.extend(range(int(begin), int(end or begin) + 1))
    return seeds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", action="append", choices=BACKENDS)
    parser.add_argument("--seeds", default="101-106")
    parser.add_argument("--world", default="small")
    parser.add_argument("--step", type=int, default=1, help="use every step-th picture of the mapping drive")
    parser.add_argument("--look-around", type=int, default=0, help="degrees to both sides that the head turns")
    parser.add_argument("--one-head", action="store_true", help="by the same servos in both drives")
    parser.add_argument("--scratch", type=Path, help="where drives are kept; usually in benchmarks/results/work")
    parser.add_argument("--rows", type=Path)
    add_results_option(parser, "mapping")
    arguments = parser.parse_args()
    if arguments.one_head and not arguments.look_around:
        parser.error("--one-head is a head that turns: give --look-around")
    run = Run.begin()
    scratch = arguments.scratch or work_folder() / "drives"
    scratch.mkdir(parents=True, exist_ok=True)
    kept = arguments.rows or work_folder() / "mapping.jsonl"
    kept.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    known = {(r["world"], r["seed"], r["backend"], r["step"], *head_of(r)): r for r in lines}
    rows = []
    for seed in parse_seeds(arguments.seeds):
        for backend in arguments.backend or ["ukf"]:
            options = arguments.step, arguments.look_around, arguments.one_head
            row = known.get((arguments.world, seed, backend, *options))
            if row is None:
                row = run_seed(seed, arguments.world, backend, *options, scratch)
                with kept.open("a") as file:
                    file.write(json.dumps(row, default=str) + "\n")
            print(json.dumps(row, default=str), flush=True)
            rows.append(row)
    run.write(arguments.results, figures(rows))
    return 1 if any("failed" in row for row in rows) else 0


def head_of(row: dict[str, Any]) -> tuple[int, bool]:
    """How far it turned, and whether both drives had the same; older rows do not say."""
    return row.get("look_around", 0), row.get("one_head", False)


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """Of each backend's maps: how true they are, and what a second drive gets from them."""
    found = []
    for backend in dict.fromkeys(row["backend"] for row in rows):
        mine = [row for row in rows if row["backend"] == backend]
        good = [row for row in mine if "failed" not in row]
        around, one_head = head_of(mine[0])
        turning = f", head turning by {around}°" + (", the same in both drives" if one_head else "") if around else ""
        title = f"map by {backend}, {len(mine)} flats{turning}"
        errors = [row["ate_m"] for row in good]
        of_path = [100 * row["ate_m"] / row["path_m"] for row in good]
        known = sum(row["right"] + row["wrong"] for row in good)
        looked = sum(row["looked"] for row in good)
        found += [
            Figure(f"{title}: error of its path, worst", max(errors, default=None), "m", of=len(good)),
            Figure(
                f"{title}: error of its path, worst, of its length",
                max(of_path, default=None),
                "%",
                at_most=MAX_OF_PATH_PERCENT if around else None,
                of=len(good),
            ),
            share(f"{title}: answers of a second drive that are known", known, looked),
            share(
                f"{title}: pictures of a second drive localised",
                sum(r["localised"] * r["looked"] for r in good),
                looked,
            ),
            share(f"{title}: answers of a second drive that are known: right", sum(r["right"] for r in good), known),
        ]
    return found


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        raise SystemExit(main())
