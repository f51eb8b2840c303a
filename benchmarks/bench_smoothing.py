"""The SLAM backends side by side on the same drives: position error, relative error, scale, first pose, CPU.

    python -m benchmarks.bench_smoothing DATASET… --v102 0-19 --flats 0-19 --backend ukf --backend smoothing

DATASET: recorded drives with truth. `--v102`: the real IMU of EuRoC V1_02, its camera rendered (hall = seed).
`--flats`, `--plain`: tours of simulated flats and plain homes, 90 s, with wheels. One JSON line per run, failures too;
errors as in bench_slam.

Between two frames the backend does what it leaves for idle moments, as in the station, on a core of its own by CPU
time: a frame waits for what was begun before it came.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from station.slam.backend import SlamBackend
from station.slam.backends import make_backend

# Of smoothing, the median of a group; None: nothing is asked.
LIVE_M = {"flight": 0.016, "v102": 0.035}
FINAL_M = {"flight": 0.012, "v102": 0.025}
FINAL_OF_PATH = {"flats": 0.06, "plain": 0.3}  # %
SCALE = {"flats": 0.3}  # %
LOST_S = {"flats": 1.0}  # in every drive
FRAME_MS = 40.0  # 99 % of the frames


class Core:
    """One core that does nothing else; its clock goes by what was computed, and by what was waited for."""

    def __init__(self) -> None:
        self.now_s = 0.0

    @contextmanager
    def working(self) -> Iterator[Callable[[], float]]:
        """Gives what tells how long it took, once it has."""
        begin_s = time.process_time()
        took_s: list[float] = []
        yield lambda: took_s[0]
        took_s.append(time.process_time() - begin_s)
        self.now_s += took_s[0]

    def idle_until(self, t_s: float, backend: SlamBackend) -> None:
        """What waits for idle moments, one thing after the other while there is time."""
        is_more = True
        while self.now_s < t_s and is_more:
            with self.working():
                is_more = backend.catch_up()
        self.now_s = max(self.now_s, t_s)


def judge(path: Path, group: str, name: str) -> dict[str, Any]:
    """One backend on one drive."""
    data = open_dataset(path, None, None, 1)
    row: dict[str, Any] = {"dataset": path.name, "group": group, "backend": name}
    camera = data.calibration.camera
    shift_ns = 0 if camera is None else round(1e9 * camera.middle_row_shift_s)
    live_t, live_T, frame_s, late_s = [], [], [], []
    begin = time.process_time()
    core = Core()
    try:
        backend = make_backend(name, data.calibration, threads=1)
        for event in data.events():
            if isinstance(event, ImageFrame):
                came_s = 1e-9 * (event.t_robot_ns - int(data.frame_times_ns[0]))
                core.idle_until(came_s, backend)
                with core.working() as took_s:
                    update = backend.add_frame(event)
                frame_s.append(took_s())
                late_s.append(core.now_s - came_s)
                if (T := update.T_map_body) is not None:
                    live_t.append(event.t_robot_ns + shift_ns)
                    live_T.append(T)
            elif isinstance(event, ImuBatch):
                with core.working():
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
        "late_ms_p50_p99": [round(float(x), 1) for x in 1e3 * np.percentile(late_s, [50, 99])],
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
        asked = name == "smoothing"
        title = f"{group}, {name}"
        found.append(Figure(f"{title}: drives finished", len(good), at_least=len(mine) if asked else None))
        for key, what, bounds in (("ate_live_m", "live", LIVE_M), ("ate_final_m", "final", FINAL_M)):
            errors = [row[key] for row in good if key in row]
            if errors:
                bound = bounds.get(group) if asked else None
                found.append(
                    Figure(f"{title}: {what} error, median", float(np.median(errors)), "m", bound, of=len(errors))
                )
                found.append(Figure(f"{title}: {what} error, worst", max(errors), "m"))
        if good:
            share = [100 * row["ate_final_m"] / row["path_m"] for row in good if row["path_m"] > 1.0]
            scale = [100 * abs(row["scale_final"] - 1) for row in good if row["path_m"] > 1.0]
            cpu = sum(row["cpu_s_driving"] for row in good) / sum(row["data_s"] for row in good)
            if share:
                of_path, of_scale = (bounds.get(group) if asked else None for bounds in (FINAL_OF_PATH, SCALE))
                found.append(Figure(f"{title}: final error by path, median", float(np.median(share)), "%", of_path))
                found.append(Figure(f"{title}: scale error, median", float(np.median(scale)), "%", of_scale))
            lost = max(row["lost_s"] for row in good)
            found.append(Figure(f"{title}: lost, longest", lost, "s", LOST_S.get(group) if asked else None))
            frame, late = (
                float(np.median([row[key][1] for row in good]))
                for key in ("cpu_ms_per_frame_p50_p99", "late_ms_p50_p99")
            )
            found.append(Figure(f"{title}: CPU of a frame, 99 %", frame, "ms", FRAME_MS if asked else None))
            found.append(Figure(f"{title}: a frame's pose after it came, 99 %", late, "ms"))
            found.append(Figure(f"{title}: CPU seconds per second of data while driving", round(cpu, 2)))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--v102", default="", help="seeds: 1 or 0-19")
    parser.add_argument("--flats", default="", help="seeds: 1 or 0-19")
    parser.add_argument("--plain", default="", help="seeds: 1 or 0-19")
    parser.add_argument("--backend", action="append", choices=["ukf", "smoothing", "sfm"])
    parser.add_argument("--scratch", type=Path, help="where drives are kept; usually in benchmarks/results/work")
    add_results_option(parser, "smoothing")
    args = parser.parse_args()
    run = Run.begin()
    scratch = args.scratch or work_folder() / "drives"
    scratch.mkdir(parents=True, exist_ok=True)
    drives = [("flight" if "flight" in path.name else path.name, path) for path in args.paths]
    drives += [("v102", v102_drive(scratch, seed)) for seed in (parse_seeds(args.v102) if args.v102 else [])]
    for group, world, seeds in (("flats", "home", args.flats), ("plain", "plain", args.plain)):
        drives += [(group, flat_drive(scratch, seed, world)) for seed in (parse_seeds(seeds) if seeds else [])]
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
