"""The long studies of the ukf backend: one JSON line per run into a file, failures too; a rerun goes on where it ended.

    nice -n 19 python -m benchmarks.slam_studies v102 --seeds 0-19 --start own
    nice -n 19 python -m benchmarks.slam_studies v102 --seeds 0-19 --start given --all-variants
    nice -n 19 python -m benchmarks.slam_studies flats --seeds 0-19
    nice -n 19 python -m benchmarks.slam_studies wheels --seeds 0-4
    nice -n 19 python -m benchmarks.slam_studies consistency --seeds 0-49 --all-variants
    python -m benchmarks.slam_studies memory DATASET               ten minutes by driving the same recorded loop again
    python -m benchmarks.slam_studies speed [DATASET...]           on a quiet machine, pinned to one core; v102, seed 0
    python -m benchmarks.slam_studies tables                       medians and worst of everything in the file

v102: real IMU of EuRoC V1_02, the camera rendered along the true path (hall number = seed), all imperfections on.
flats: world `home`, route `tour`, 90 s, 20 frames per second. wheels: the same drives, each knowledge of wheels off.
Rendered drives are kept in --scratch; --discard deletes each after its run (a flat is 100 MB).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds, render, run_program
from benchmarks.bench_slam import FIGURES, VARIANTS, WHEELS, consistency_calibration, consistency_run, run_dataset
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from station.datasets import open_dataset
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.config import UkfConfig

EUROC = Path("../shared/data/euroc_v1_02_imu")
FLAT_S = 90.0
TITLES = {"v102": "EuRoC V1_02, real IMU and rendered pictures", "flats": "tours of simulated flats"}


class Results:
    """Append-only lines; knows what is there already."""

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self.rows: list[dict[str, Any]] = []
        if path.exists():
            self.rows = [json.loads(line) for line in path.read_text().splitlines()]
        self._known = {r["key"] for r in self.rows}

    def run(self, key: str, make: Callable[[], dict[str, Any]]) -> None:
        """Make and write the row of this key, unless it is there."""
        if key in self._known:
            return
        row = {"key": key, "study": key.split("/")[0], **make()}
        self.rows.append(row)
        with self._path.open("a") as file:
            file.write(json.dumps(row, default=str) + "\n")
        print(json.dumps({k: v for k, v in row.items() if k != "nees"}, default=str), flush=True)


def v102_drive(scratch: Path, seed: int) -> Path:
    """The rendered V1_02 of this seed."""
    out = scratch / f"v102-{seed}"
    if not out.exists():
        inside = EUROC / "mav0"
        states = inside / "state_groundtruth_estimate0" / "data.csv"
        camera = inside / "cam0" / "sensor.yaml"
        run_program("along", str(states), "--camera", str(camera), "--imu", str(inside / "imu0"),
                    "--seed", str(seed), "--out", str(out))  # fmt: skip
    return out


def flat_drive(scratch: Path, seed: int, world: str = "home") -> Path:
    """The 90 s tour of a flat."""
    return render(
        scratch / f"{world}{seed}-tour", seed, world, "--route", "tour", "--drive-seed", str(seed),
        "--max-duration", str(FLAT_S),
    )  # fmt: skip


def run_drives(results: Results, args: argparse.Namespace) -> None:
    """v102, flats, wheels: render, run, judge."""
    for seed in parse_seeds(args.seeds):
        drive = v102_drive if args.what == "v102" else flat_drive
        if args.what == "wheels":
            cases = {label: UkfConfig(wheels=wheels, map="tracks") for label, wheels in WHEELS.items()}
        else:
            chosen = VARIANTS if args.all_variants else {k: VARIANTS[k] for k in list(VARIANTS)[:1]}
            cases = {label: UkfConfig(filter=config) for label, config in chosen.items()}
        for label, config in cases.items():
            key = f"{args.what}/{seed}/{args.start}/{label}"
            results.run(key, partial(_judge, drive, args.scratch, seed, label, config, args.start))
        if args.discard:
            shutil.rmtree(drive(args.scratch, seed), ignore_errors=True)


def _judge(
    drive: Callable[[Path, int], Path], scratch: Path, seed: int, label: str, config: UkfConfig, start: str
) -> dict[str, Any]:
    return {"seed": seed, **run_dataset(drive(scratch, seed), label, config, start)}


def run_consistency(results: Results, args: argparse.Namespace) -> None:
    """NEES of the pose over time and NIS, feature-level simulation."""
    calibration = consistency_calibration()
    chosen = VARIANTS if args.all_variants else {k: VARIANTS[k] for k in list(VARIANTS)[:1]}
    for label, config in chosen.items():
        for seed in parse_seeds(args.seeds):
            key = f"consistency/{seed}/{label}"
            results.run(key, partial(consistency_run, label, config, calibration, seed, args.duration))


def run_memory(results: Results, path: Path, minutes: float) -> None:
    """Resident memory per minute while the same recorded drive comes again and again, shifted in time."""

    def measure() -> dict[str, Any]:
        data = open_dataset(path, None, None, 1)
        backend = UkfBackend(data.calibration)
        resident: list[float] = []
        lost = frames = 0
        shift = 0
        first = int(data.frame_times_ns[0])
        length = int(data.frame_times_ns[-1]) - first + 50_000_000
        while shift * 1e-9 < 60.0 * minutes:
            for event in data.events():
                if isinstance(event, ImuBatch):
                    inside = event.t_robot_ns < first + length
                    backend.add_imu(
                        ImuBatch(event.t_robot_ns[inside] + shift, event.gyro_imu[inside], event.accel_imu[inside])
                    )
                elif isinstance(event, DriveSample):
                    backend.add_drive(dataclasses.replace(event, t_robot_ns=event.t_robot_ns + shift))
                elif isinstance(event, ImageFrame):
                    frames += 1
                    moved = dataclasses.replace(event, index=frames, t_robot_ns=event.t_robot_ns + shift)
                    lost += backend.add_frame(moved).state == "lost"
                    now_s = (moved.t_robot_ns - first) * 1e-9
                    if now_s >= 60.0 * (len(resident) + 1):
                        resident.append(resident_mb())
            shift += length
        nav = backend.finish()
        return {
            "dataset": path.name,
            "minutes": round(shift / 60e9, 1),
            "resident_mb_per_minute": [round(x) for x in resident],
            "frames": frames,
            "frames_lost": lost,
            "keyframes": len(nav.keyframes),
            "landmarks": len(nav.landmarks),
        }

    results.run(f"memory/{path.name}", measure)


def resident_mb() -> float:
    """Resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def run_speed(results: Results, paths: list[Path], config: UkfConfig) -> None:
    """Realtime factor and time per frame, wall and CPU, pinned to one core; reading the files is counted."""
    os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[-1]})
    for path in paths:
        data = open_dataset(path, None, None, 1)
        events = list(data.events())
        backend = UkfBackend(data.calibration, config)
        wall, cpu = [], []
        wall_begin, cpu_begin = time.perf_counter(), time.process_time()
        for event in events:
            if isinstance(event, ImageFrame):
                a, b = time.perf_counter(), time.process_time()
                backend.add_frame(event)
                wall.append(time.perf_counter() - a)
                cpu.append(time.process_time() - b)
            elif isinstance(event, ImuBatch):
                backend.add_imu(event)
            elif isinstance(event, DriveSample):
                backend.add_drive(event)
        driven_wall, driven_cpu = time.perf_counter() - wall_begin, time.process_time() - cpu_begin
        nav = backend.finish()
        all_wall, all_cpu = time.perf_counter() - wall_begin, time.process_time() - cpu_begin
        duration = nav.report.duration_s
        row = {
            "dataset": path.name,
            "load_average": os.getloadavg()[0],
            "frames": len(wall),
            "wall_ms_p50_p99_max": [round(float(x) * 1e3, 1) for x in (*np.percentile(wall, [50, 99]), max(wall))],
            "cpu_ms_p50_p99_max": [round(float(x) * 1e3, 1) for x in (*np.percentile(cpu, [50, 99]), max(cpu))],
            "realtime_factor_wall": round(duration / all_wall, 2),
            "realtime_factor_cpu": round(duration / all_cpu, 2),
            "realtime_factor_cpu_while_driving": round(duration / driven_cpu, 2),
            "wall_while_driving_s": round(driven_wall, 2),
        }
        results.run(f"speed/{path.name}/{time.time():.0f}", partial(dict, row))


def tables(results: Results) -> None:
    """What is in the file, condensed."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in results.rows:
        if row["study"] in ("memory", "speed"):
            print(json.dumps({k: v for k, v in row.items() if k != "key"}))
            continue
        groups.setdefault(" ".join([row["study"], str(row.get("start", "")), str(row["variant"])]), []).append(row)
    for name, rows in groups.items():
        failed = [r.get("seed") for r in rows if "failed" in r]
        good = [r for r in rows if "failed" not in r]
        out: dict[str, Any] = {"group": name, "runs": len(rows), "failed_seeds": failed}
        if good and "nees" in good[0]:
            out |= {k: round(float(np.mean([r[k] for r in good])), 3) for k in FIGURES}
            n = min(len(r["nees"]) for r in good)
            mean = np.mean([r["nees"][:n] for r in good], axis=0)
            low, high = chi2.ppf([0.025, 0.975], 6 * len(good)) / len(good)
            out["mean_nees_in_band"] = round(float(np.mean((mean > low) & (mean < high))), 3)
            out["mean_nees_below_upper"] = round(float(np.mean(mean < high)), 3)
        elif good:
            for key in ("ate_live_m", "ate_final_m"):
                values = np.array([r[key] for r in good if key in r])
                if len(values):
                    out[key] = {"median": float(np.median(values)), "worst": float(values.max())}
            share = [100 * r["ate_final_m"] / r["path_m"] for r in good if "ate_final_m" in r]
            out["final_percent_of_path_median"] = round(float(np.median(share)), 3)
            scale = [100 * abs(r["scale_final"] - 1) for r in good if "scale_final" in r]
            out["scale_error_percent_median"] = round(float(np.median(scale)), 2)
            out["lost_s_worst"] = max(r.get("lost_s", 0.0) for r in good)
        print(json.dumps(out))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["v102", "flats", "wheels", "consistency", "memory", "speed", "tables"])
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--seeds", default="0-19")
    parser.add_argument("--start", choices=["own", "given"], default="own")
    parser.add_argument("--all-variants", action="store_true")
    parser.add_argument("--duration", type=float, default=20.0)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--map", choices=["auto", "tracks", "views"], default="auto")
    parser.add_argument("--discard", action="store_true")
    parser.add_argument("--scratch", type=Path, help="where drives are kept; usually in benchmarks/results/work")
    parser.add_argument("--rows", type=Path, help="a line per run; usually in benchmarks/results/work")
    add_results_option(parser, "slam_study")
    args = parser.parse_args()
    run = Run.begin()
    results = Results(args.rows or work_folder() / "slam.jsonl")
    args.scratch = args.scratch or work_folder() / "drives"
    args.scratch.mkdir(parents=True, exist_ok=True)
    if args.what in ("v102", "flats", "wheels"):
        run_drives(results, args)
    elif args.what == "consistency":
        run_consistency(results, args)
    elif args.what == "memory":
        for path in args.paths:
            run_memory(results, path, args.minutes)
    elif args.what == "speed":
        run_speed(results, args.paths or [v102_drive(args.scratch, 0)], UkfConfig(map=args.map))
    else:
        tables(results)
        return
    run.write(args.results, figures(results, args))


def figures(results: Results, args: argparse.Namespace) -> list[Figure]:
    """What is asked of the runs that were wanted now, and what was found."""
    study, seeds = args.what, parse_seeds(args.seeds)
    rows = [row for row in results.rows if row["study"] == study and row.get("seed", seeds[0]) in seeds]
    rows = [row for row in rows if row.get("start", args.start) == args.start]
    found = []
    if study in ("v102", "flats"):
        for variant in dict.fromkeys(row["variant"] for row in rows):
            mine = [row for row in rows if row["variant"] == variant]
            title = f"{TITLES[study]}, {args.start} start" + ("" if variant == "right Lie UKF" else f", {variant}")
            found += _figures_of_drives(study, title, mine)
    elif study == "wheels":
        for label in dict.fromkeys(row["variant"] for row in rows):
            errors = [row["ate_live_m"] for row in rows if row["variant"] == label and "ate_live_m" in row]
            found.append(
                Figure(
                    f"simulated flats, knowledge of wheels: {label}: error of the live path, median",
                    _median(errors),
                    "m",
                    of=len(errors),
                )
            )
    elif study == "consistency":
        for label in dict.fromkeys(row["variant"] for row in rows):
            nees = [row["nees_mean"] for row in rows if row["variant"] == label]
            found.append(
                Figure(
                    f"synthetic runs, {label}: NEES of the pose, mean (6 expected)", float(np.mean(nees)), of=len(nees)
                )
            )
    elif study == "memory":
        for row in rows:
            resident = row["resident_mb_per_minute"]
            grown = (resident[-1] - resident[0]) / (len(resident) - 1) if len(resident) > 1 else None
            found.append(Figure(f"memory that {row['minutes']:g} minutes of SLAM add", grown, "MB a minute"))
    else:
        for row in rows[-1:]:  # the last one: each is measured anew
            where = f"{row['dataset']}, one core"
            p99_ms = row["wall_ms_p50_p99_max"][1]
            found.append(
                Figure(f"{where}: seconds of data a second", row["realtime_factor_wall"], at_least=3, of=row["frames"])
            )
            found.append(Figure(f"{where}: time per picture, 99 %", p99_ms, "ms", at_most=50, of=row["frames"]))
    return found


def _figures_of_drives(study: str, title: str, rows: list[dict[str, Any]]) -> list[Figure]:
    good = [row for row in rows if "failed" not in row]
    lost_s = [row.get("lost_s", 0.0) for row in good]
    errors = [row["ate_final_m"] for row in good if "ate_final_m" in row]
    found = [share(f"{title}: followed to the end", len(good), len(rows), at_least=100)]
    if study == "v102":
        found.append(Figure(f"{title}: error of the path, median", _median(errors), "m", 0.10, of=len(errors)))
        found.append(Figure(f"{title}: error of the path, worst", max(errors, default=None), "m", 0.25, of=len(errors)))
    else:
        percent = [100 * row["ate_final_m"] / row["path_m"] for row in good if "ate_final_m" in row]
        scale = [100 * abs(row["scale_final"] - 1) for row in good if "scale_final" in row]
        found.append(
            Figure(f"{title}: error of the path, median", _median(percent), "% of its length", 1, of=len(percent))
        )
        found.append(Figure(f"{title}: error of the scale, median", _median(scale), "%", 3, of=len(scale)))
        found.append(Figure(f"{title}: longest time lost", max(lost_s, default=None), "s", 2, of=len(lost_s)))
    return found


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
