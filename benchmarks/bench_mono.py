"""The mono backend (MonoSLAM) against the truth: projected points, rendered pictures, recorded ones, and its speed.

    python -m benchmarks.bench_mono [--points 0-19] [--rendered 0-9] [--seconds 10] [--recorded DATASET[:FIRST-LAST] …]

A person stands and moves a camera about (tests/support/mono.py), 30 pictures a second: among points that are seen with
1 px of noise, and in a furnished room that the simulator renders with blur, noise and JPEG. Errors: root mean square of
the camera's position after alignment by a similarity, in percent of the way.

NEES is of the camera's pose as given at each picture and seen from the first one that the backend began with, its
scale projected out, since nothing tells it: five degrees of freedom. Velocities and the map are not judged. Its band
holds 95 % of chi-square, both ends cut. The error of the way is of the navigation, which has the poses of the start as
they were known at its end.

The settings were chosen on seeds 100 to 120, 126 and 129. `--figure FILE` draws the search ellipses of the first
rendered sequence as they shrink. One JSON line per run.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds
from benchmarks.result import Figure, Run, add_results_option, share
from shared.errors import RobotSystemError
from shared.geometry import inverse
from station.datasets import open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error, path_length
from station.model.frames import ImageArray, ImageFrame
from station.model.navigation import Trajectory
from station.slam.backends import make_backend
from station.slam.mono.backend import MonoBackend
from station.slam.mono.config import MonoConfig
from station.slam.mono.filter import MonoFilter
from station.slam.run import run_backend
from station.vision.lens import Lens
from tests.support.mono import (
    NEES_DEGREES,
    RATE_HZ,
    PointFinder,
    hand_held_camera,
    hand_held_path,
    pose_nees,
    rendered,
)
from tests.support.synthetic_run import room_points

BAND = chi2.ppf([0.025, 0.975], NEES_DEGREES)
DIVERGED_DEG = 10.0  # of rotation after the alignment: a mirrored world may fit the way well
BACKENDS = ("mono", "ukf", "smoothing", "sfm")
PICTURED = (1, 4, 12, 28)  # frames of the figure
RED, GREEN = (60, 60, 230), (60, 200, 60)


def judged(seed: int, truth: Trajectory, found: Trajectory, nees: list[float]) -> dict[str, Any]:
    error = absolute_trajectory_error(found, truth, "sim3")
    values = np.array(nees)
    return {
        "seed": seed,
        "way": round(path_length(truth), 2),
        "ate_percent": round(100 * error.rmse_m / path_length(truth), 3),
        "rotation_deg": round(float(np.degrees(error.rotation_rmse_rad)), 2),
        "nees_median": round(float(np.median(values)), 2),
        "in_band": int(((values > BAND[0]) & (values < BAND[1])).sum()),
        "above_band": int((values >= BAND[1]).sum()),
        "judged": len(values),
    }


def points_run(seed: int, seconds: float) -> dict[str, Any]:
    """The filter alone, among points; its own settings, so nothing of the pictures' search takes part."""
    calibration, path = hand_held_camera(), hand_held_path(seed, seconds)
    assert calibration.camera is not None
    lens = Lens(calibration.camera)
    finder = PointFinder(lens, room_points(path.T_world_body[:, :3, 3], seed), 1.0, seed)
    mono = MonoFilter(lens, MonoConfig())
    T_first_world, found, nees = inverse(path.T_world_body[0]), [], []
    for k, T_world_cam in enumerate(path.T_world_body):
        finder.look_from(T_world_cam)
        result = mono.process(1.0 / RATE_HZ if k else 0.0, finder)
        found.append(mono.state.T_world_cam)
        found[len(found) - len(result.again) :] = [state.T_world_cam for state in result.again]
        if k > 1:
            nees.append(pose_nees(mono.state, T_first_world @ T_world_cam))
    return judged(seed, path, Trajectory(path.t_robot_ns, np.array(found)), nees)


def rendered_run(seed: int, seconds: float, figure: Path | None) -> dict[str, Any]:
    """The whole backend over rendered pictures."""
    calibration, path = hand_held_camera(), hand_held_path(seed, seconds)
    backend = MonoBackend(calibration)
    nees, cpu_ms, measured, pictures = [], [], [], []
    first = None  # picture: of the filter's world, where the backend found something to begin with
    for k, frame in enumerate(rendered(path, calibration, seed)):
        began = time.process_time()
        is_first_piece = backend.add_frame(frame).segment == 0
        cpu_ms.append(1e3 * (time.process_time() - began))
        if first is None and backend.filter is not None:
            first = k
        if first is not None and backend.last is not None and k > first + 1:
            truth = inverse(path.T_world_body[first]) @ path.T_world_body[k]
            mono = backend.filter if is_first_piece else None  # none: lost, which no band holds
            nees.append(np.inf if mono is None else pose_nees(mono.state, truth))
            measured.append(len(backend.last.expected.rows))
        if figure is not None and k in PICTURED:
            pictures.append(with_ellipses(frame, backend))
    if figure is not None:
        figure.parent.mkdir(parents=True, exist_ok=True)
        rows = [np.hstack(pictures[:2]), np.hstack(pictures[2:])]
        cv2.imwrite(str(figure), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 80])
    nav = backend.finish()
    return judged(seed, path, nav.trajectory, nees) | {
        "first": first,
        "lost_s": nav.report.tracking_lost_s,
        "pieces": int(nav.keyframes.segment[-1]) + 1,
        "landmarks": len(nav.landmarks),
        "measured": round(float(np.mean(measured)), 1),
        "cpu_ms": round(float(np.mean(cpu_ms)), 2),
        "cpu_ms_p99": round(float(np.percentile(cpu_ms, 99)), 2),
    }


def with_ellipses(frame: ImageFrame, backend: MonoBackend) -> ImageArray:
    """The picture with the ellipse that each feature was looked for in: green where it was found, red where not."""
    image = np.ascontiguousarray(frame.bgr()[::2, ::2])
    if backend.last is None:
        return image
    expected, found = backend.last.expected, set(backend.last.ids[: backend.last.num_found].tolist())
    for row, uv, S in zip(expected.rows, expected.uv_px / 2, expected.ellipses() / 4, strict=True):
        lengths, axes = np.linalg.eigh(S)
        box = (*uv.tolist(),), (*(2 * MonoConfig().gate_sigmas * np.sqrt(lengths)).tolist(),)
        angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
        colour = GREEN if int(backend.last.predicted.ids[row]) in found else RED
        cv2.ellipse(image, (*box, angle), colour, 1, cv2.LINE_AA)
    cv2.putText(image, f"picture {frame.index}", (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
    return image


def recorded_run(dataset: str, backend_name: str) -> dict[str, Any]:
    """A recorded sequence, judged by the camera's positions: an arbitrary scale says nothing of the IMU's place."""
    path, _, part = dataset.partition(":")
    first, last = map(int, part.split("-")) if part else (None, None)
    data = open_dataset(Path(path), first, last)
    name = f"{Path(path).name}{f', {part}' if part else ''}"
    row: dict[str, Any] = {"dataset": name, "backend": backend_name}
    try:
        nav = run_backend(make_backend(backend_name, data.calibration, 0, 1, data.intrinsics_known), data.events())
    except RobotSystemError as exc:
        return row | {"failed": str(exc)}
    assert data.truth is not None and data.calibration.camera is not None
    T_body_cam = data.calibration.camera.T_body_cam_matrix
    truth = Trajectory(data.truth.t_robot_ns, data.truth.T_world_body @ T_body_cam)
    found = Trajectory(nav.trajectory.t_robot_ns, nav.trajectory.T_world_body @ T_body_cam)
    error = absolute_trajectory_error(found, truth, "sim3")
    return row | {
        "ate_percent": round(100 * error.rmse_m / path_length(truth), 2),
        "ate_m": round(error.rmse_m, 4),
        "way_m": round(path_length(truth), 2),
        "rotation_deg": round(float(np.degrees(error.rotation_rmse_rad)), 1),
        "poses": len(error.t_robot_ns),
        "landmarks": len(nav.landmarks),
        "lost_s": nav.report.tracking_lost_s,
    }


def figures_of_runs(title: str, rows: list[dict[str, Any]]) -> list[Figure]:
    """Of the sequences of one kind, all of them."""
    errors = [row["ate_percent"] for row in rows]
    whole = sum(row["judged"] for row in rows)
    diverged = sum(row["rotation_deg"] > DIVERGED_DEG or row.get("pieces", 1) > 1 for row in rows)
    return [
        Figure(f"{title}: error of the way, worst", max(errors), "% of its length", at_most=2, of=len(rows)),
        Figure(f"{title}: error of the way, median", float(np.median(errors)), "% of its length", of=len(rows)),
        Figure(f"{title}: lost, or turned by more than {DIVERGED_DEG:g}°", diverged, at_most=0, of=len(rows)),
        share(f"{title}: NEES of the pose in its 95 % band", sum(r["in_band"] for r in rows), whole, at_least=80),
        share(f"{title}: NEES of the pose above that band", sum(r["above_band"] for r in rows), whole),
    ]


def figures_of_speed(rows: list[dict[str, Any]]) -> list[Figure]:
    mean_ms = float(np.mean([row["cpu_ms"] for row in rows]))
    features = float(np.mean([row["measured"] for row in rows]))
    return [
        Figure("MonoSLAM at 640×480, one core: pictures a second of CPU", 1e3 / mean_ms, at_least=25, of=len(rows)),
        Figure("MonoSLAM at 640×480: features looked for in a picture, mean", features, of=len(rows)),
    ]


def figures_of_recorded(rows: list[dict[str, Any]]) -> list[Figure]:
    return [
        Figure(
            f"{row['dataset']}, {row['backend']}: error of the camera's way after a similarity",
            row.get("ate_percent"), "% of its length", of=row.get("poses"),
        )
        for row in rows
    ]  # fmt: skip


def told(row: dict[str, Any]) -> dict[str, Any]:
    print(json.dumps(row), flush=True)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", default="", help="seeds of sequences of projected points: 0-19 or 1,4,7")
    parser.add_argument("--rendered", default="", help="seeds of rendered sequences")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a sequence")
    parser.add_argument("--recorded", nargs="*", default=[], help="datasets with true poses, all of them or a part")
    parser.add_argument("--figure", type=Path, help="where the picture of shrinking ellipses goes")
    add_results_option(parser, "mono")
    arguments = parser.parse_args()
    run = Run.begin()
    found: list[Figure] = []
    if arguments.points:
        rows = [told(points_run(seed, arguments.seconds)) for seed in parse_seeds(arguments.points)]
        found += figures_of_runs("MonoSLAM among points", rows)
    if arguments.rendered:
        rows = []
        for seed in parse_seeds(arguments.rendered):
            rows.append(told(rendered_run(seed, arguments.seconds, None if rows else arguments.figure)))
        found += figures_of_runs("MonoSLAM over rendered pictures", rows) + figures_of_speed(rows)
    recorded = [told(recorded_run(path, name)) for path in arguments.recorded for name in BACKENDS]
    run.write(arguments.results, found + figures_of_recorded(recorded))


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
