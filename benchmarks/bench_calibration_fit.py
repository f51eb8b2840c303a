"""Is a wrong calibration noticed, and a right one left in peace? Drives through simulated flats, told other numbers.

    python -m benchmarks.bench_calibration_fit --flats 1-8                   mapping drives (rendered where missing)
    python -m benchmarks.bench_calibration_fit ../shared/data/euroc_v1_01_flight --told focal=0.95 focal=1

The pictures stay as they are; the filter is told a focal length that many times as long, or a camera mounted or timed
otherwise. One JSON line per drive and calibration, failures too: what the drive said of it, and how far the navigation
is from the truth.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds, render, trajectory_of
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from shared.calibration import Calibration
from shared.errors import RobotSystemError
from shared.geometry import so3_exp
from station.datasets import open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error
from station.slam.backends import make_backend
from station.slam.run import run_backend

TOLD = (
    "focal=1", "focal=0.95", "focal=0.97", "focal=0.98", "focal=1.02", "focal=1.03", "focal=1.05",
    "pitch_deg=3", "yaw_deg=3", "roll_deg=3", "shift_ms=15",
)  # fmt: skip
AXES = ("pitch_deg", "yaw_deg", "roll_deg")  # about the camera's own


def told_otherwise(calibration: Calibration, what: str) -> Calibration:
    """The calibration with one number of its camera other than it is."""
    camera = calibration.camera
    assert camera is not None
    name, _, text = what.partition("=")
    value = float(text)
    if name == "focal":
        camera = msgspec.structs.replace(camera, fx=value * camera.fx, fy=value * camera.fy)
    elif name == "shift_ms":
        camera = msgspec.structs.replace(camera, time_shift_s=camera.time_shift_s + 1e-3 * value)
    else:
        T = camera.T_body_cam_matrix
        T[:3, :3] = T[:3, :3] @ so3_exp(np.radians([value * (axis == name) for axis in AXES]))
        camera = msgspec.structs.replace(camera, T_body_cam=tuple(T.ravel().tolist()))
    return msgspec.structs.replace(calibration, camera=camera)


def drive(path: Path, told: str, step: int) -> dict[str, Any]:
    """One drive, followed with the calibration that is told."""
    data = open_dataset(path, None, None, step)
    row: dict[str, Any] = {"drive": path.name, "told": told, "step": step}
    try:
        nav = run_backend(make_backend("ukf", told_otherwise(data.calibration, told), 0, 1), data.events())
    except RobotSystemError as exc:
        return row | {"failed": str(exc)}
    truth = trajectory_of(data)
    free = absolute_trajectory_error(nav.trajectory, truth, "sim3")
    fit = nav.report.calibration_fit
    return row | {
        "ate_m": round(absolute_trajectory_error(nav.trajectory, truth, "yaw").rmse_m, 4),
        "scale_error": round(1.0 / free.alignment.scale - 1.0, 4),
        "lost_s": round(nav.report.tracking_lost_s, 2),
        "fit": None if fit is None else asdict(fit),
    }


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """Of each calibration that was told: how often the drive said that it does not fit."""
    found = []
    for told in dict.fromkeys(row["told"] for row in rows):
        fits = [row.get("fit") for row in rows if row["told"] == told]
        misfits = sum(fit is not None and fit["verdict"] == "does not fit" for fit in fits)
        title = f"told {told.replace('=', ' ')}: said not to fit"
        if told == "focal=1":
            found.append(share(title, misfits, len(fits), at_most=0))
            errors = [abs(fit["focal_scale"] - 1.0) for fit in fits if fit is not None]
            worst = 100 * max(errors) if errors else None
            found.append(Figure("right calibration: largest error of the focal length", worst, "%", at_most=1.0))
        else:
            is_borne = told in ("focal=0.98", "focal=1.02")
            found.append(share(title, misfits, len(fits), at_least=None if is_borne else 95))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--flats", default="", help="seeds of simulated flats to drive through: 1 or 1-8")
    parser.add_argument("--told", nargs="*", default=list(TOLD), help="what is told: focal=1.03, pitch_deg=2 …")
    parser.add_argument("--step", type=int, default=1, help="every so many-th picture only")
    add_results_option(parser, "calibration_fit")
    args = parser.parse_args()
    run = Run.begin()
    folder = work_folder() / "drives"
    folder.mkdir(parents=True, exist_ok=True)
    seeds = parse_seeds(args.flats) if args.flats else []
    paths = [*args.paths, *(render(folder / f"small{s}-mapping", s, "small", "--route", "mapping") for s in seeds)]
    rows = []
    with threadpool_limits(1):
        for path in paths:
            for told in args.told:
                rows.append(drive(path, told, args.step))
                print(json.dumps(rows[-1]), flush=True)
    run.write(args.results, figures(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
