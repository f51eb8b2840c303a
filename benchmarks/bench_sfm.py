"""Structure from motion against the truth: simulated flats by seed, or recorded datasets by path.

    python -m benchmarks.bench_sfm --seeds 0-9                       mapping drives in ten flats (made where missing)
    python -m benchmarks.bench_sfm ../shared/data/euroc_v1_01_keyframes
    python -m benchmarks.bench_sfm ../shared/data/redkitchen --first 0 --last 398

One JSON line per drive: errors after alignment by yaw (metric, gravity-aligned navigations) and by a similarity, the
scale's error, CPU seconds while driving and after the drive has ended. Failures are printed like successes.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_mapping import parse_seeds, render
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from shared.errors import RobotSystemError
from station.datasets import open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error, path_length
from station.slam.backends import make_backend
from station.slam.run import run_backend


def judge(path: Path, first: int | None, last: int | None, backend_name: str, threads: int) -> dict[str, object]:
    """Run one drive and compare it with its truth."""
    data = open_dataset(path, first, last)
    backend = make_backend(backend_name, data.calibration, 0, threads, data.intrinsics_known)
    marks = [(time.process_time(), time.perf_counter())]
    row: dict[str, object] = {"dataset": path.name, "frames": len(data.frame_times_ns)}
    try:
        nav = run_backend(
            backend, data.events(), before_finish=lambda: marks.append((time.process_time(), time.perf_counter()))
        )
    except RobotSystemError as exc:
        return row | {"failed": str(exc)}
    marks.append((time.process_time(), time.perf_counter()))
    row |= {
        "duration_s": round(nav.report.duration_s, 1),
        "keyframes": len(nav.keyframes),
        "landmarks": len(nav.landmarks),
        "scale": nav.report.scale,
        "lost_s": round(nav.report.tracking_lost_s, 1),
        "cpu_driving_s": round(marks[1][0] - marks[0][0], 1),
        "cpu_after_s": round(marks[2][0] - marks[1][0], 1),
        "wall_after_s": round(marks[2][1] - marks[1][1], 1),
        "loops": nav.report.config.get("loops"),
        "scales": nav.report.config["scale_and_gravity"],
        "messages": nav.report.messages,
    }
    truth = data.truth
    if truth is not None:
        free = absolute_trajectory_error(nav.trajectory, truth, "sim3")
        row |= {
            "path_m": round(path_length(truth), 1),
            "ate_sim3_m": round(free.rmse_m, 4),
            "rotation_sim3_deg": round(float(np.degrees(free.rotation_rmse_rad)), 2),
        }
        if nav.is_metric and nav.is_gravity_aligned:
            fixed = absolute_trajectory_error(nav.trajectory, truth, "yaw")
            row |= {
                "ate_yaw_m": round(fixed.rmse_m, 4),
                "ate_yaw_max_m": round(fixed.max_m, 4),
                "scale_error": round(1.0 / free.alignment.scale - 1.0, 4),
            }
    return row


def simulate(seed: int, folder: Path, max_duration_s: float) -> Path:
    """The mapping drive in the flat of this seed; rendered where it is missing."""
    ends = ["--max-duration", str(max_duration_s)] if max_duration_s else []
    cut = f"-{max_duration_s:g}s" if max_duration_s else ""
    return render(folder / f"home{seed}-mapping{cut}", seed, "home", "--route", "mapping", *ends)


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """Of the drives together; one that failed has no navigation."""
    good = [row for row in rows if "failed" not in row]
    found = [share("navigations that structure from motion made", len(good), len(rows))]
    for key, what, unit, factor in (
        ("ate_yaw_m", "error of the path after position and yaw", "m", 1.0),
        ("scale_error", "error of the scale", "%", 100.0),
    ):
        values = [factor * abs(row[key]) for row in good if key in row]
        if values:
            worst = f"structure from motion, {what}, worst"
            found.append(Figure(worst, max(values), unit, of=len(values)))
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="*", type=Path)
    parser.add_argument("--seeds", default="", help="flats to simulate: 0-9 or 1,4,7")
    parser.add_argument("--max-duration", type=float, default=0.0, help="of a simulated drive, in s; 0: to its end")
    parser.add_argument("--scratch", type=Path, help="where simulated drives are kept; usually benchmarks/results/work")
    parser.add_argument("--first", type=int)
    parser.add_argument("--last", type=int)
    parser.add_argument("--backend", default="sfm")
    parser.add_argument("--threads", type=int, default=-1)
    add_results_option(parser, "sfm")
    arguments = parser.parse_args()
    run = Run.begin()
    seeds = parse_seeds(arguments.seeds) if arguments.seeds else []
    scratch = arguments.scratch or work_folder() / "drives"
    scratch.mkdir(parents=True, exist_ok=True)
    rows = []
    for path in chain(arguments.datasets, (simulate(seed, scratch, arguments.max_duration) for seed in seeds)):
        rows.append(judge(path, arguments.first, arguments.last, arguments.backend, arguments.threads))
        print(json.dumps(rows[-1]), flush=True)
    run.write(arguments.results, figures(rows))


if __name__ == "__main__":
    main()
