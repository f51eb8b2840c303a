"""The SLAM backends side by side on the same drives: position error, relative error, scale, first pose, CPU.

    python -m benchmarks.bench_smoothing DATASET… --v102 0-19 --flats 0-19 --backend ukf --backend smoothing

DATASET: recorded drives with truth. `--v102`: the real IMU of EuRoC V1_02, its camera rendered (hall = seed).
`--flats`: tours of simulated flats, 90 s, with wheels. One JSON line per run, failures too; errors as in bench_slam.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds, trajectory_of
from benchmarks.result import Figure, Run, add_results_option, work_folder
from benchmarks.slam_studies import flat_drive, v102_drive
from shared.errors import RobotSystemError
from station.datasets import open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error, path_length, relative_pose_error
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Trajectory
from station.slam.backends import make_backend

# Metres. Of the real flight and of the rendered V1_02; flats as a share of their path, %.
BOUNDS = {"flight": (0.016, 0.012), "v102": (0.035, 0.025)}


def judge(path: Path, group: str, name: str) -> dict[str, Any]:
    """One backend on one drive."""
    data = open_dataset(path, None, None, 1)
    row: dict[str, Any] = {"dataset": path.name, "group": group, "backend": name}
    camera = data.calibration.camera
    shift_ns = 0 if camera is None else round(1e9 * camera.middle_row_shift_s)
    live_t, live_T, frame_s = [], [], []
    begin = time.process_time()
    try:
        backend = make_backend(name, data.calibration, threads=1)
        for event in data.events():
            if isinstance(event, ImageFrame):
                frame_begin = time.process_time()
                update = backend.add_frame(event)
                frame_s.append(time.process_time() - frame_begin)
                if (T := update.T_map_body) is not None:
                    live_t.append(event.t_robot_ns + shift_ns)
                    live_T.append(T)
            elif isinstance(event, ImuBatch):
                backend.add_imu(event)
            elif isinstance(event, DriveSample):
                backend.add_drive(event)
        driven_s = time.process_time() - begin
        nav = backend.finish()
    except RobotSystemError as exc:
        return row | {"failed": str(exc)}
    truth = trajectory_of(data)
    relative = relative_pose_error(nav.trajectory, truth, 1.0)
    row |= {
        "ate_final_m": round(absolute_trajectory_error(nav.trajectory, truth).rmse_m, 4),
        "scale_final": round(absolute_trajectory_error(nav.trajectory, truth, "sim3").alignment.scale, 4),
        "rpe_1s_m": round(relative.translation_rmse_m, 4),
        "path_m": round(path_length(truth), 2),
        "lost_s": round(nav.report.tracking_lost_s, 2),
        "landmarks": len(nav.landmarks),
        "cpu_s_driving": round(driven_s, 1),
        "cpu_s_finish": round(time.process_time() - begin - driven_s, 1),
        "data_s": round(nav.report.duration_s, 1),
        "cpu_ms_per_frame_p50_p99": [round(float(x), 1) for x in 1e3 * np.percentile(frame_s, [50, 99])],
    }
    if live_t:
        live = Trajectory(np.array(live_t), np.array(live_T))
        row["ate_live_m"] = round(absolute_trajectory_error(live, truth).rmse_m, 4)
        row["first_pose_s"] = round((live_t[0] - shift_ns - int(data.frame_times_ns[0])) * 1e-9, 2)
    return row


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """Medians and the worst of each backend in each group; failures are said."""
    found = []
    for group, name in dict.fromkeys((row["group"], row["backend"]) for row in rows):
        mine = [row for row in rows if (row["group"], row["backend"]) == (group, name)]
        good = [row for row in mine if "failed" not in row]
        title = f"{group}, {name}"
        found.append(
            Figure(f"{title}: drives finished", len(good), at_least=len(mine) if name == "smoothing" else None)
        )
        bounds = BOUNDS.get(group, (None, None)) if name == "smoothing" else (None, None)
        for (key, what), bound in zip((("ate_live_m", "live"), ("ate_final_m", "final")), bounds, strict=True):
            errors = [row[key] for row in good if key in row]
            if errors:
                found.append(
                    Figure(f"{title}: {what} error, median", float(np.median(errors)), "m", bound, of=len(errors))
                )
                found.append(Figure(f"{title}: {what} error, worst", max(errors), "m"))
        if good:
            share = [100 * row["ate_final_m"] / row["path_m"] for row in good if row["path_m"] > 1.0]
            scale = [100 * abs(row["scale_final"] - 1) for row in good if row["path_m"] > 1.0]
            cpu = sum(row["cpu_s_driving"] for row in good) / sum(row["data_s"] for row in good)
            if share:
                found.append(Figure(f"{title}: final error by path, median", float(np.median(share)), "%"))
                found.append(Figure(f"{title}: scale error, median", float(np.median(scale)), "%"))
            found.append(Figure(f"{title}: CPU seconds per second of data while driving", round(cpu, 2)))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--v102", default="", help="seeds: 1 or 0-19")
    parser.add_argument("--flats", default="", help="seeds: 1 or 0-19")
    parser.add_argument("--backend", action="append", choices=["ukf", "smoothing", "sfm"])
    parser.add_argument("--scratch", type=Path, help="where drives are kept; usually in benchmarks/results/work")
    add_results_option(parser, "smoothing")
    args = parser.parse_args()
    run = Run.begin()
    scratch = args.scratch or work_folder() / "drives"
    scratch.mkdir(parents=True, exist_ok=True)
    drives = [("flight" if "flight" in path.name else path.name, path) for path in args.paths]
    drives += [("v102", v102_drive(scratch, seed)) for seed in (parse_seeds(args.v102) if args.v102 else [])]
    drives += [("flats", flat_drive(scratch, seed)) for seed in (parse_seeds(args.flats) if args.flats else [])]
    rows = []
    with threadpool_limits(1):
        for group, path in drives:
            for name in args.backend or ["ukf", "smoothing"]:
                rows.append(judge(path, group, name))
                print(json.dumps(rows[-1]), flush=True)
    run.write(args.results, figures(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
