"""`station calibrate camera-imu` over recordings that the simulator renders, against their truth.

    python -m benchmarks.bench_calibrate_camera_imu --seeds 0-19

Good recordings of 30 s, each of another robot, and each mistake that the simulator knows, once. One JSON line per
recording, failures too. The truth lies within three of its sigmas, or it does not: counted over rotation, position,
time shift, line delay and gravity of every robot.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds
from benchmarks.calibration_sessions import calibrate, poor_sessions, refusals, session, truth_of
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from robot.simulation.calibration.kind import Kind
from shared.geometry import FloatArray, so3_log

FIRST_POOR_SEED = 5000


def good(work: Path, seed: int) -> dict[str, Any]:
    """One robot: its errors, and each in sigmas."""
    folder = session(work, Kind.CAMERA_IMU, seed)
    found = calibrate(Kind.CAMERA_IMU, folder)
    row = {"seed": seed, **{key: found[key] for key in ("accepted", "reasons", "wall_s", "cpu_s")}}
    return row | errors(found, truth_of(folder)) if found["sigma"] else row


def errors(found: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    camera, sigma = truth["calibration"]["camera"], found["sigma"]
    T, T_true = np.array(found["T_body_cam"]), np.array(camera["T_body_cam"]).reshape(4, 4)
    up: FloatArray = np.array(truth["T_world_board"])[2, :3]
    turned = np.degrees(so3_log(T_true[:3, :3].T @ T[:3, :3]))
    moved = T[:3, 3] - T_true[:3, 3]
    shift, delay = (found[key] - camera[key] for key in ("time_shift_s", "line_delay_s"))
    fall = np.array(found["gravity"]) + truth["calibration"]["gravity"] * up
    in_sigmas = np.concatenate(
        [
            turned / sigma["rotation_deg"],
            moved / sigma["translation_m"],
            [shift / sigma["time_shift_s"], delay / sigma["line_delay_s"]],
            fall / sigma["gravity"],
        ]
    )
    return {
        "rotation_deg": float(np.linalg.norm(turned)),
        "position_mm": 1e3 * float(np.linalg.norm(moved)),
        "shift_ms": 1e3 * abs(shift),
        "delay_us": 1e6 * abs(delay),
        "rms_px": found["rms_px"],
        "in_sigmas": np.round(in_sigmas, 2).tolist(),
    }


BOUNDS = {  # median, worst
    "rotation_deg": ("rotation error", "°", 0.05, 0.1),
    "position_mm": ("position error", "mm", 1.5, 3.0),
    "shift_ms": ("time shift error", "ms", 0.1, 0.2),
    "delay_us": ("line delay error", "µs", 0.5, 0.5),
}


def figures(robots: list[dict[str, Any]], mistakes: list[dict[str, Any]]) -> list[Figure]:
    known = [row for row in robots if "in_sigmas" in row]
    found = []
    for key, (what, unit, median, worst) in BOUNDS.items():
        values = [row[key] for row in known]
        name = f"camera-imu: {what}"
        found.append(Figure(f"{name}, median", float(np.median(values)) if values else None, unit, at_most=median))
        found.append(Figure(f"{name}, worst", max(values, default=None), unit, at_most=worst))
    within = [abs(z) < 3.0 for row in known for z in row["in_sigmas"]]
    found.append(share("camera-imu: truth within three sigmas", sum(within), len(within), at_least=97.0))
    accepted = sum(row["accepted"] for row in robots)
    found.append(share("camera-imu: good recordings accepted", accepted, len(robots), at_least=100.0))
    found += refusals(Kind.CAMERA_IMU, mistakes) if mistakes else []
    longest = max((row["wall_s"] for row in robots), default=None)
    found.append(Figure("camera-imu: seconds by the clock for 30 s of recording, longest", longest, "s", at_most=30.0))
    longest = max((row["cpu_s"] for row in robots), default=None)
    return [*found, Figure("camera-imu: CPU seconds, longest", longest, "s")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-19", help="robots, one good recording of each")
    parser.add_argument("--no-poor", action="store_true", help="leave the poor recordings out")
    add_results_option(parser, "calibrate_camera_imu")
    options = parser.parse_args()
    run = Run.begin()
    work = work_folder() / "calibration"
    work.mkdir(parents=True, exist_ok=True)
    rows = []
    with threadpool_limits(2):  # as on a machine of two cores
        for seed in parse_seeds(options.seeds):
            rows.append(good(work, seed))
            print(json.dumps(rows[-1]), flush=True)
        mistakes = [] if options.no_poor else poor_sessions(work, Kind.CAMERA_IMU, FIRST_POOR_SEED)
    run.write(options.results, figures(rows, mistakes))


if __name__ == "__main__":
    main()
