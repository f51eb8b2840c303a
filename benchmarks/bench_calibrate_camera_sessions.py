"""`station calibrate camera` over stills of a board that the simulator renders, against the true lens.

    python -m benchmarks.bench_calibrate_camera_sessions --seeds 0-19

Good sessions of a minute, each of another camera and hand, and each mistake that the simulator knows, once. One JSON
line per session, failures too. The truth lies within three of its sigmas, or it does not: counted over every number of
the lenses whose model is the true one. One in three cameras is wide, with an equidistant lens, of which the command
makes a radial-tangential one unless that does not fit: its focal lengths and centre are counted apart, and how far any
pixel lies beside where the true lens puts it is told of all of them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds
from benchmarks.calibration_sessions import calibrate, poor_sessions, refusals, session, truth_of
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from robot.simulation.calibration.kind import Kind
from shared.calibration import CameraCalibration
from station.calibration.camera_imu.unknowns import intrinsics_of
from station.vision.lens import Lens

FIRST_POOR_SEED = 5000
PIXELS = np.stack(np.meshgrid(np.linspace(0, 639, 33), np.linspace(0, 479, 25)), axis=-1).reshape(-1, 2)


def good(work: Path, seed: int) -> dict[str, Any]:
    """One camera: its errors, and each in sigmas."""
    folder = session(work, Kind.CAMERA, seed)
    found = calibrate(Kind.CAMERA, folder)
    row = {"seed": seed, **{key: found[key] for key in ("accepted", "reasons", "model", "rms_px", "cpu_s")}}
    if found["model"] is None:
        return row
    true = msgspec.convert(truth_of(folder)["calibration"]["camera"], CameraCalibration)
    fx, fy, cx, cy = found["intrinsics"]
    lens = msgspec.structs.replace(
        true, fx=fx, fy=fy, cx=cx, cy=cy, model=found["model"], distortion=tuple(found["distortion"])
    )
    beside = np.linalg.norm(Lens(lens).project(Lens(true).unproject(PIXELS)) - PIXELS, axis=1)
    away = intrinsics_of(lens) - intrinsics_of(true)
    in_sigmas = away / list(found["sigma"].values())
    is_true_model = lens.model == true.model
    return row | {
        "true_model": true.model,
        "focal_percent": float(100 * np.abs(away[:2] / [true.fx, true.fy]).max()),
        "centre_px": float(np.abs(away[2:4]).max()),
        "beside_px": float(np.percentile(beside, 95)),
        "in_sigmas": np.round(in_sigmas if is_true_model else in_sigmas[:4], 2).tolist(),
    }


ERRORS = {
    "focal_percent": ("focal length off", "%"),
    "centre_px": ("centre off", "px"),
    "beside_px": ("95 % of the image's pixels off by at most", "px"),
}


def figures(good: list[dict[str, Any]], poor: list[dict[str, Any]]) -> list[Figure]:
    known = [row for row in good if "in_sigmas" in row]
    found = []
    for is_true_model, lenses, bound in (
        (True, "lenses of the true model", 97.0),
        (False, "wide lenses taken for radial-tangential", None),
    ):
        rows = [row for row in known if (row["model"] == row["true_model"]) == is_true_model]
        found.append(share(f"camera: {lenses}", len(rows), len(good)))
        for key, (what, unit) in ERRORS.items():
            errors = [row[key] for row in rows]
            median = float(np.median(errors)) if errors else None
            found.append(Figure(f"camera: {lenses}: {what}, median", median, unit))
            found.append(Figure(f"camera: {lenses}: {what}, worst", max(errors, default=None), unit))
        sigmas = [abs(z) for row in rows for z in row["in_sigmas"]]
        inside = sum(z < 3.0 for z in sigmas)
        found.append(share(f"camera: {lenses}: within three sigmas", inside, len(sigmas), at_least=bound))
    refused = "; ".join(f"seed {row['seed']}: {' '.join(row['reasons'])}" for row in good if not row["accepted"])
    accepted = sum(row["accepted"] for row in good)
    found.append(share("camera: good recordings accepted", accepted, len(good), at_least=100.0, note=refused))
    longest = max((row["cpu_s"] for row in good), default=None)
    return [*found, *refusals(Kind.CAMERA, poor), Figure("camera: CPU seconds, longest", longest, "s")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-19", help="cameras, one good session of each")
    add_results_option(parser, "calibrate_camera_sessions")
    options = parser.parse_args()
    run = Run.begin()
    work = work_folder() / "calibration"
    work.mkdir(parents=True, exist_ok=True)
    rows = []
    with threadpool_limits(1):
        for seed in parse_seeds(options.seeds):
            rows.append(good(work, seed))
            print(json.dumps(rows[-1]), flush=True)
        run.write(options.results, figures(rows, poor_sessions(work, Kind.CAMERA, FIRST_POOR_SEED)))


if __name__ == "__main__":
    main()
