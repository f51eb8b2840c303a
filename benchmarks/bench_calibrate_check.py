"""`station calibrate check` on recordings without a target, told right calibrations and ones that were knocked.

    python -m benchmarks.bench_calibrate_check --seeds 210-217

By each seed a hand-held recording of another robot is rendered, by the first also a tour on wheels through a flat and
the flight V1_02, whose real IMU came without images, so that a hall is rendered along its true path; real EuRoC
recordings where this machine has them. Each is told the right calibration, one that was knocked in every way and in a
random direction, and each hand-held one another of which one quantity alone is wrong. One JSON line per recording and
knock. Of every quantity the check either claims to know it, and is within the bar or not, or says that it is not
observable.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.bench_mapping import parse_seeds, render
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from benchmarks.slam_studies import EUROC, v102_drive
from shared.calibration import CameraCalibration
from shared.geometry import so3_log
from station.calibration.camera_imu.start import Turns, match_turning
from station.calibration.targetless.check import CalibrationCheck, check_calibration
from station.calibration.targetless.recording import lively
from station.calibration.targetless.uncertainty import FLOOR_POSITION_M, FLOOR_ROTATION, FLOOR_SHIFT_S
from station.datasets import Dataset, open_dataset
from tests.support.hand_held import knocked, record_hand_held
from tests.support.paths import RECORDINGS

HAND, WHEELS, FLIGHT, REAL = "hand-held", "on wheels", "real IMU of V1_02", "real"
RECORDED = ("euroc_v1_01_flight", "euroc_v1_01_static")
DIRECTIONS = (
    5  # of knocks of each real recording, one of each that is rendered: an estimate hardly knows where it began
)
TURN_S = 0.1  # over which the turning of a truth is compared with a gyroscope
WHEELS_S = 35
UNTOUCHED, EVERYTHING = "nothing", "everything"
KNOCKS = {  # degrees, m, s
    UNTOUCHED: (0.0, 0.0, 0.0),
    EVERYTHING: (5.0, 0.03, 0.015),
    "rotation_deg": (5.0, 0.0, 0.0),
    "translation_m": (0.0, 0.03, 0.0),
    "time_shift_s": (0.0, 0.0, 0.015),
}
FLOORS = {
    "rotation_deg": float(np.degrees(FLOOR_ROTATION)), "translation_m": FLOOR_POSITION_M, "time_shift_s": FLOOR_SHIFT_S,
}  # fmt: skip
BARS = {"rotation_deg": ("rotation", "°", 0.5), "translation_m": ("position", "m", 0.015),
          "time_shift_s": ("time shift", "s", 1e-3)}  # fmt: skip


def on_truth(data: Dataset, camera: CameraCalibration) -> CameraCalibration:
    """What a camera that is rendered along a truth has: the truth's own turning differs a little from the IMU's.

    Of V1_02 by 1 ms and 0.1 degrees, as the gyroscope alone shows.
    """
    assert data.truth is not None and data.imu is not None
    origin_ns = data.imu.t_robot_ns[0]
    t_s, R = 1e-9 * (data.truth.t_robot_ns - origin_ns), data.truth.T_world_body[:, :3, :3]
    later = np.searchsorted(t_s, t_s + TURN_S)
    begin = np.flatnonzero(later < len(t_s))
    end = later[begin]
    turns = Turns(t_s[begin], t_s[end], so3_log(np.swapaxes(R[begin], 1, 2) @ R[end]))
    match = match_turning(turns, 1e-9 * (data.imu.t_robot_ns - origin_ns), data.imu.gyro_imu)
    T = camera.T_body_cam_matrix
    T[:3, :3] = match.R_body_cam @ T[:3, :3]
    shift_s = camera.time_shift_s + match.shift_s
    return msgspec.structs.replace(camera, T_body_cam=tuple(T.ravel().tolist()), time_shift_s=shift_s)


class Silent:
    def step(self, description: str, total: int | None = None) -> None: ...
    def advance(self) -> None: ...


def recordings(work: Path, seeds: list[int]) -> list[tuple[str, Path]]:
    """Each with its kind; rendered where it is missing."""
    found = []
    for seed in seeds:
        found.append((HAND, work / f"hand-{seed}"))
        if not found[-1][1].exists():
            record_hand_held(found[-1][1], seed)
    for seed in seeds[:1]:
        tour = ("--route", "tour", "--drive-seed", str(seed), "--max-duration", str(WHEELS_S))
        found.append((WHEELS, render(work / f"wheels-{seed}", seed, "home", *tour)))
        if EUROC.exists():
            found.append((FLIGHT, v102_drive(work, seed)))
    return found + [(REAL, RECORDINGS / name) for name in RECORDED if (RECORDINGS / name).exists()]


def knocks_of(kind: str, number: int) -> list[str]:
    """What each recording is told; of one quantity alone the hand-held ones take turns, since each costs as much."""
    alone = [list(BARS)[number % len(BARS)]] if kind == HAND else []
    return [UNTOUCHED, *[EVERYTHING] * (DIRECTIONS if kind == REAL else 1), *alone]


def checked(kind: str, path: Path, knock: str, direction: int) -> dict[str, Any]:
    data = open_dataset(path)
    true = data.calibration.camera
    assert true is not None
    told = msgspec.structs.replace(data.calibration, camera=knocked(true, direction, *KNOCKS[knock]))
    if kind == FLIGHT:
        true = on_truth(data, true)
    begin = time.process_time()
    found = check_calibration(lively(data, told, path), Silent())
    row: dict[str, Any] = {
        "kind": kind,
        "recording": path.name,
        "knocked": knock,
        "direction": direction,
        "accepted": found.is_accepted,
        "fits": found.fits,
        "cpu_s": time.process_time() - begin,
        "reasons": found.reasons,
        "misfits": [q.key for q in found.quantities if found.is_believed and q.is_surely_wrong],
    }
    return row | errors(found, true.T_body_cam_matrix, true.time_shift_s)


def errors(found: CalibrationCheck, T_true: Any, shift_s: float) -> dict[str, Any]:
    if found.solution is None:
        return {"observable": {}}
    camera = found.solution.estimate.camera
    T = camera.T_body_cam_matrix
    away = {
        "rotation_deg": np.degrees(so3_log(T_true[:3, :3].T @ T[:3, :3])),
        "translation_m": T[:3, 3] - T_true[:3, 3],
        "time_shift_s": np.array([camera.time_shift_s - shift_s]),
    }
    quantities = {q.key: q for q in found.quantities}
    return {
        "observable": {key: quantities[key].is_observable for key in away},
        "error": {key: float(np.linalg.norm(v)) for key, v in away.items()},
        "in_sigmas": {key: (v / quantities[key].sigma).tolist() for key, v in away.items()},
        "in_scatter": {
            key: (v / np.sqrt(quantities[key].sigma ** 2 - FLOORS[key] ** 2)).tolist() for key, v in away.items()
        },
    }


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """Of the estimates themselves, that are nearly the same whatever was told, those that began at a knock in all."""
    found = []
    knocked = [row for row in rows if row["knocked"] == EVERYTHING]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        of_kind = [row for row in knocked if row["kind"] == kind]
        for key, (what, unit, bar) in BARS.items():
            errors = [row["error"][key] for row in of_kind if row["observable"].get(key)]
            name, within = f"check without a target, {kind}: {what}", sum(error <= bar for error in errors)
            found.append(share(f"{name} claimed, within {bar:g} {unit}", within, len(of_kind)))
            found.append(share(f"{name} claimed, outside", len(errors) - within, len(of_kind), at_most=0.0))
            found.append(share(f"{name} said not observable", len(of_kind) - len(errors), len(of_kind)))
            found.append(Figure(f"{name}, largest error claimed", max(errors, default=None), unit))
    for key, what, bound in (
        ("in_sigmas", "within three sigmas", 97.0),
        ("in_scatter", "within three sigmas without the floors that are added", None),
    ):
        sigmas = [abs(z) for row in knocked for q, known in row["observable"].items() if known for z in row[key][q]]
        inside = sum(z < 3.0 for z in sigmas)
        found.append(share(f"check without a target: claimed numbers {what}", inside, len(sigmas), at_least=bound))
    return [*found, *_verdicts(rows)]


def _verdicts(rows: list[dict[str, Any]]) -> list[Figure]:
    """What was said of calibrations that are wrong, or right, or wrong in one quantity alone."""
    name = "check without a target:"
    right = [row for row in rows if row["knocked"] == UNTOUCHED]
    wrong = [row for row in rows if row["knocked"] != UNTOUCHED]
    spoken = [row for row in right if row["misfits"]]
    note = "; ".join(f"{row['recording']}: {', '.join(row['misfits'])}" for row in spoken)
    found = [
        share(f"{name} knocked calibrations said to fit", sum(row["fits"] is True for row in wrong), len(wrong),
              at_most=0.0),
        share(f"{name} right calibrations of which something is said not to fit", len(spoken), len(right), at_most=0.0,
              note=note),
        share(f"{name} right calibrations said to fit", sum(row["fits"] is True for row in right), len(right)),
    ]  # fmt: skip
    for key, (what, _, _) in BARS.items():
        alone = [row for row in rows if row["knocked"] == key]
        if not alone:
            continue
        noticed = sum(key in row["misfits"] for row in alone)
        others = sum(bool(set(row["misfits"]) - {key}) for row in alone)
        found.append(share(f"{name} only the {what} knocked: said not to fit", noticed, len(alone), at_least=100.0))
        found.append(share(f"{name} only the {what} knocked: anything else said not to fit", others, len(alone),
                           at_most=0.0))  # fmt: skip
    longest = max((row["cpu_s"] for row in rows), default=None)
    return [*found, Figure("check without a target: CPU seconds, longest", longest, "s")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="210-217", help="robots, one hand-held recording of each")
    add_results_option(parser, "calibrate_check")
    options = parser.parse_args()
    run = Run.begin()
    work = work_folder() / "calibration-check"
    work.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for number, (kind, path) in enumerate(recordings(work, parse_seeds(options.seeds))):
        for knock in knocks_of(kind, number):
            rows.append(checked(kind, path, knock, direction=len(rows)))
            print(json.dumps(rows[-1]), flush=True)
    run.write(options.results, figures(rows))


if __name__ == "__main__":
    main()
