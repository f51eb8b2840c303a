"""The ukf backend against the truth: recorded sequences, rendered paths, simulated flats, consistency.

    python -m benchmarks.bench_slam datasets ../shared/data/euroc_v1_01_flight --start own --start given
    python -m benchmarks.bench_slam variants DATASET…          right/left Lie UKF, plain UKF, invariant EKF side by side
    python -m benchmarks.bench_slam wheels --flats 1           each piece of knowledge about wheels switched off in turn
    python -m benchmarks.bench_slam consistency --runs 50      NEES of the pose and NIS over synthetic runs
    python -m benchmarks.bench_slam points ../shared/data/euroc_v1_02_imu --seeds 0-19
                                                               a recorded IMU with projected points instead of images

Instead of recorded datasets, or beside them, `--flats` gives seeds of simulated ones (world `small`, mapping route).
One JSON line per run, failures too. Errors: root mean square of the position after alignment by position and yaw;
`live` is what the filter said at the time, `final` the navigation at the end of the drive.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds, render
from benchmarks.result import Figure, Run, add_results_option, work_folder
from shared.calibration import REFERENCE_CAMERA, Calibration, ImuNoise
from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from station.commands.slam import given_state
from station.datasets import open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error, path_length, relative_pose_error
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Trajectory
from station.motion.error_coordinates import ErrorKind, difference_group
from station.motion.imu_buffer import ImuBuffer
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.filter.config import FilterConfig
from station.slam.ukf.filter.constraints import WheelConfig
from station.slam.ukf.filter.filter import VioFilter
from station.slam.ukf.filter.state import PHI, XI_X, initial_state, retract
from station.slam.ukf.start.starter import ORIGIN, GivenState, Starter, WaitingFrame, state_from_given
from station.vision.camera_model import CameraModel
from tests.support.datasets import imu_of
from tests.support.synthetic_run import TruePath, observe, room_points, sine_path

VARIANTS = {
    "right Lie UKF": FilterConfig(),
    "left Lie UKF": FilterConfig(error=ErrorKind.LEFT),
    "plain UKF": FilterConfig(error=ErrorKind.PLAIN),
    "invariant EKF": FilterConfig(use_sigma_points=False),
}
FIGURES = ("nees_mean", "nees_in_95_band", "nis_per_degree", "rmse_m")
# Asked of the default filter on the recorded flight: metres, and seconds until its own start in motion.
BOUNDS: dict[tuple[str, str, str], dict[str, float]] = {
    ("euroc_v1_01_flight", "right Lie UKF", "own"): {"first_pose_s": 1.6, "ate_live_m": 0.025},
    ("euroc_v1_01_flight", "right Lie UKF", "given"): {"ate_live_m": 0.020},
}
WHEELS = {
    "all": WheelConfig(),
    "no zero velocity": WheelConfig(use_zero_velocity=False),
    "no non-holonomic": WheelConfig(use_non_holonomic=False),
    "no commanded speed": WheelConfig(use_commanded_speed=False),
    "none": WheelConfig(use_zero_velocity=False, use_non_holonomic=False, use_commanded_speed=False),
}


def run_dataset(path: Path, label: str, config: UkfConfig, start: str, seed: int = 0) -> dict[str, object]:
    """One drive, judged."""
    data = open_dataset(path, None, None, 1)
    row: dict[str, object] = {
        "dataset": path.name,
        "variant": label,
        "start": start,
        "frames": len(data.frame_times_ns),
    }
    camera = data.calibration.camera
    shift_ns = 0 if camera is None else round(1e9 * camera.middle_row_shift_s)
    live_t, live_T, frame_s = [], [], []
    cpu_begin = time.process_time()
    try:
        backend = UkfBackend(data.calibration, config, seed, given_state(data) if start == "given" else None)
        for event in data.events():
            if isinstance(event, ImuBatch):
                backend.add_imu(event)
            elif isinstance(event, DriveSample):
                backend.add_drive(event)
            elif isinstance(event, ImageFrame):
                begin = time.process_time()
                update = backend.add_frame(event)
                frame_s.append(time.process_time() - begin)
                if update.T_world_body is not None:
                    live_t.append(event.t_robot_ns + shift_ns)
                    live_T.append(update.T_world_body)
        nav = backend.finish()
    except RobotSystemError as exc:
        return row | {"failed": str(exc)}
    cpu = time.process_time() - cpu_begin
    row |= {
        "first_pose_s": round((live_t[0] - shift_ns - int(data.frame_times_ns[0])) * 1e-9, 2),
        "lost_s": round(nav.report.tracking_lost_s, 2),
        "keyframes": len(nav.keyframes),
        "landmarks": len(nav.landmarks),
        "cpu_ms_per_frame_p50_p99": [round(float(x), 1) for x in 1e3 * np.percentile(frame_s, [50, 99])],
        "data_s_per_cpu_s": round(nav.report.duration_s / cpu, 2),
        "messages": nav.report.messages,
    }
    truth = data.truth
    if truth is not None:
        true_path = Trajectory(truth.t_robot_ns, truth.T_world_body)
        for name, path_found in (("live", Trajectory(np.array(live_t), np.array(live_T))), ("final", nav.trajectory)):
            row[f"ate_{name}_m"] = round(absolute_trajectory_error(path_found, true_path).rmse_m, 4)
            scaled = absolute_trajectory_error(path_found, true_path, "sim3")
            row[f"scale_{name}"] = round(scaled.alignment.scale, 4)
        row["path_m"] = round(path_length(true_path), 2)
        for delta_s in (1.0, 5.0):
            if nav.report.duration_s > 1.5 * delta_s:
                relative = relative_pose_error(nav.trajectory, true_path, delta_s)
                row[f"rpe_{delta_s:.0f}s_m"] = round(relative.translation_rmse_m, 4)
    return row


def consistency_calibration() -> Calibration:
    """A wider lens than the reference robot's, and a global shutter: as in the authors' comparison."""
    noise = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
    camera = msgspec.structs.replace(REFERENCE_CAMERA, fx=458.0, fy=457.0, line_delay_s=0.0, time_shift_s=0.0)
    return Calibration(camera=camera, imu=noise)


def consistency_run(
    label: str, config: FilterConfig, calibration: Calibration, seed: int, duration_s: float
) -> dict[str, object]:
    """One synthetic run: how well the filter knows its own error."""
    assert calibration.imu is not None
    imu, truth = sine_path(calibration, seed, duration_s)
    frames = observe(calibration, truth, room_points(truth.x_world, seed), 1.0, seed, num_features=100)
    buffer = ImuBuffer(calibration.imu)
    buffer.add(imu)
    rng = np.random.default_rng(seed + 1000)
    sigma = np.array([0.01] * 3 + [0.05] * 3 + [0.01, 0.01, 1e-4] + [0.05] * 3 + [1e-4] * 3)
    state = initial_state(
        int(truth.t_ns[0]), truth.R_world_body[0], truth.v_world[0], truth.x_world[0],
        truth.bias_gyro[0], truth.bias_accel[0], np.diag(sigma),
    )  # fmt: skip
    vio = VioFilter(calibration, config, retract(config.error, state, -sigma * rng.normal(size=15)))
    nees, nis, dof, error = [], 0.0, 0, []
    for k, frame in enumerate(frames):
        result = vio.process_frame(buffer.segment(vio.state.t_imu_ns, int(truth.t_ns[k])), frame, k)
        nis, dof = nis + result.nis, dof + result.nis_dof
        s = vio.state
        phi, xi = difference_group(config.error, s.R, s.x[None], truth.R_world_body[k], truth.x_world[k][None])
        d = np.concatenate([phi, xi[0]])
        rows = np.r_[PHI, XI_X]
        nees.append(float(d @ np.linalg.solve(s.covariance[np.ix_(rows, rows)], d)))
        error.append(float(np.linalg.norm(s.x - truth.x_world[k])))
    return {
        "variant": label,
        "seed": seed,
        "nees_mean": round(float(np.mean(nees)), 2),
        "nees_in_95_band": round(float(np.mean(np.array(nees) < chi2.ppf(0.95, 6))), 3),
        "nis_per_degree": round(nis / max(dof, 1), 3),
        "rmse_m": round(float(np.sqrt(np.mean(np.square(error)))), 4),
        "nees": [round(x, 2) for x in nees],
    }


def points_run(
    path: Path, label: str, config: FilterConfig, seed: int, start: str, sigma_px: float = 1.0
) -> dict[str, object]:
    """A recorded IMU with points projected along the true path: own start or given, no images involved."""
    data = open_dataset(path, None, None, 1)
    truth, noise, camera = data.truth, data.calibration.imu, data.calibration.camera
    assert truth is not None and noise is not None and camera is not None
    imu = imu_of(data)
    t = data.frame_times_ns
    t = t[(t > truth.t_robot_ns[0]) & (t < truth.t_robot_ns[-1]) & (t > imu.t_robot_ns[0]) & (t < imu.t_robot_ns[-1])]
    at = np.clip(np.searchsorted(truth.t_robot_ns, t), 0, len(truth) - 1)
    T = truth.T_world_body[at]
    nothing = np.zeros((len(t), 3))
    true_path = TruePath(truth.t_robot_ns[at], T[:, :3, :3], T[:, :3, 3], nothing, nothing, nothing, nothing)
    frames = observe(data.calibration, true_path, room_points(T[:, :3, 3], seed), sigma_px, seed)
    buffer = ImuBuffer(noise)
    buffer.add(imu)
    times = true_path.t_ns
    row: dict[str, object] = {
        "dataset": path.name,
        "variant": label,
        "seed": seed,
        "start": start,
        "frames": len(frames),
    }
    vio: VioFilter | None = None
    starter = Starter(
        CameraModel.of(camera, config.sigma_px), noise, data.calibration.gravity, UkfConfig().start, config.error
    )
    if start == "given":
        assert truth.v_world is not None and truth.gyro_bias is not None and truth.accel_bias is not None
        i = at[0]
        given = GivenState(
            int(times[0]), T[0, :3, :3], truth.v_world[i], T[0, :3, 3], truth.gyro_bias[i], truth.accel_bias[i]
        )
        vio = VioFilter(data.calibration, config, state_from_given(given, config.error))
    found_t, found_T = [], []
    for k, frame in enumerate(frames):
        if vio is None:
            waiting = WaitingFrame(k, int(times[k]), frame)
            found = starter.try_start(waiting, buffer, is_resting(buffer, int(times[k]), frames, k), lambda _t: ORIGIN)
            if isinstance(found, str):
                row["waiting"] = found
                continue
            vio = VioFilter(data.calibration, config, found[0])
            row["first_pose_s"] = round((int(times[k]) - int(times[0])) * 1e-9, 2)
        else:
            vio.process_frame(buffer.segment(vio.state.t_imu_ns, int(times[k])), frame, k)
        found_t.append(int(times[k]))
        found_T.append(vio.state.T_world_body)
    if not found_t:
        return row | {"failed": "never started"}
    error = absolute_trajectory_error(Trajectory(np.array(found_t), np.array(found_T)), Trajectory(times, T))
    return row | {"ate_live_m": round(error.rmse_m, 4), "path_m": round(path_length(Trajectory(times, T)), 1)}


def is_resting(imu: ImuBuffer, t_ns: int, frames: tuple[object, ...], k: int) -> bool:
    """Standstill by the IMU alone: half a second without turning (the backend also asks the image)."""
    samples = imu.samples(t_ns - 500_000_000, t_ns)
    if k < 10 or len(samples) < 20 or not frames:
        return False
    gyro: FloatArray = samples.gyro_imu - samples.gyro_imu.mean(axis=0)
    return bool(gyro.std(axis=0).max() < 0.01 and samples.accel_imu.std(axis=0).max() < 0.1)


def simulate(seed: int, max_duration_s: float) -> Path:
    """The mapping drive in the small flat of this seed; rendered where it is missing."""
    folder = work_folder() / "drives"
    folder.mkdir(parents=True, exist_ok=True)
    ends = ["--max-duration", str(max_duration_s)] if max_duration_s else []
    cut = f"-{max_duration_s:g}s" if max_duration_s else ""
    return render(folder / f"small{seed}-mapping{cut}", seed, "small", "--route", "mapping", *ends)


def figures_of_drives(rows: list[dict[str, Any]]) -> list[Figure]:
    """Of each drive: its first pose, and the errors of its path, live and finished."""
    found = []
    for row in rows:
        case = [f"wheels: {row['variant']}" if row["variant"] in WHEELS else row["variant"], f"{row['start']} start"]
        case += [f"seed {row['seed']}"] if "seed" in row else []
        title = f"{row['dataset']}, {', '.join(case)}"
        if "failed" in row:
            found.append(Figure(f"{title}: error of the path", None, "m"))
            continue
        bounds = BOUNDS.get((row["dataset"], row["variant"], row["start"]), {})
        for key, what, unit in (
            ("first_pose_s", "first pose after", "s"),
            ("ate_live_m", "error of the live path", "m"),
            ("ate_final_m", "error of the finished path", "m"),
        ):
            is_claim = key == "ate_live_m" or row["variant"] not in WHEELS  # what wheels teach shows in the live path
            if key in row and is_claim and not (key == "first_pose_s" and row["start"] == "given"):
                found.append(Figure(f"{title}: {what}", row[key], unit, bounds.get(key)))
    return found


def figures_of_consistency(label: str, mean: dict[str, float], runs: int) -> list[Figure]:
    """How well a filter knows its own error, over all runs."""
    return [Figure(f"synthetic runs, {label}: NEES of the pose, mean (6 expected)", mean["nees_mean"], of=runs)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["datasets", "variants", "wheels", "consistency", "points"])
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--flats", default="", help="seeds of simulated flats to drive through: 1 or 0-3")
    parser.add_argument("--max-duration", type=float, default=0.0, help="of a simulated drive, in s; 0: to its end")
    parser.add_argument("--start", action="append", choices=["own", "given"])
    parser.add_argument("--seeds", default="0-0")
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--duration", type=float, default=20.0)
    parser.add_argument("--variant", action="append", choices=list(VARIANTS))
    add_results_option(parser, "slam")
    args = parser.parse_args()
    run = Run.begin()
    variants = {k: v for k, v in VARIANTS.items() if args.variant is None or k in args.variant}
    starts = args.start or ["own"]
    rows: list[dict[str, Any]] = []

    def tell(row: dict[str, Any]) -> None:
        rows.append(row)
        print(json.dumps(row, default=str), flush=True)

    if args.what == "consistency":
        calibration, figures = consistency_calibration(), []
        for seed in range(args.runs):
            for label, config in variants.items():
                row = consistency_run(label, config, calibration, seed, args.duration)
                tell({k: v for k, v in row.items() if k != "nees"})
        for label in variants:
            chosen = [r for r in rows if r["variant"] == label]
            mean = {key: round(float(np.mean([float(str(r[key])) for r in chosen])), 3) for key in FIGURES}
            print(json.dumps({"summary": label, "runs": len(chosen), **mean}))
            figures += figures_of_consistency(label, mean, len(chosen))
        run.write(args.results, figures)
        return 0
    simulated = [simulate(seed, args.max_duration) for seed in (parse_seeds(args.flats) if args.flats else [])]
    for path in [*args.paths, *simulated]:
        if args.what == "datasets":
            for start in starts:
                tell(run_dataset(path, "right Lie UKF", UkfConfig(), start))
        elif args.what == "variants":
            for label, config in variants.items():
                for start in starts:
                    tell(run_dataset(path, label, UkfConfig(filter=config), start))
        elif args.what == "wheels":
            for label, wheels in WHEELS.items():
                tell(run_dataset(path, label, UkfConfig(wheels=wheels), "own"))
        else:
            for start in starts:
                for label, config in variants.items():
                    for seed in parse_seeds(args.seeds):
                        tell(points_run(path, label, config, seed, start))
    run.write(args.results, figures_of_drives(rows))
    failed = sum("failed" in row for row in rows)
    print(f"{len(rows)} runs, {failed} failed", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    with threadpool_limits(limits=1):  # small matrices: more threads only wait for each other
        raise SystemExit(main())
