"""`station calibrate check` on recordings without a target, told a calibration that was knocked in five directions.

    python -m benchmarks.bench_calibrate_check --seeds 200-209

Real EuRoC flights where this machine has them, and hand-held recordings that are rendered, each of another robot. One
JSON line per recording and direction. A quantity counts where it is called observable.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from shared.geometry import so3_log
from station.calibration.targetless.check import CalibrationCheck, check_calibration
from station.commands.calibrate.check import lively
from station.datasets import open_dataset
from tests.support.hand_held import knocked, record_hand_held
from tests.support.paths import RECORDINGS

REAL = ("euroc_v1_01_flight", "euroc_v1_01_static")
DIRECTIONS = 5
BOUNDS = {"rotation_deg": ("rotation", "°", 0.5), "translation_m": ("position", "m", 0.015),
          "time_shift_s": ("time shift", "s", 1e-3)}  # fmt: skip


class Silent:
    def step(self, description: str, total: int | None = None) -> None: ...
    def advance(self) -> None: ...


def checked(path: Path, direction: int) -> dict[str, Any]:
    data = open_dataset(path)
    true = data.calibration.camera
    assert true is not None
    told = msgspec.structs.replace(data.calibration, camera=knocked(true, direction))
    begin = time.process_time()
    found = check_calibration(lively(data, told, path), Silent())
    row: dict[str, Any] = {
        "recording": path.name,
        "direction": direction,
        "accepted": found.is_accepted,
        "fits": found.fits,
        "cpu_s": time.process_time() - begin,
        "reasons": found.reasons,
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
    }


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    found = []
    for key, (what, unit, bound) in BOUNDS.items():
        known = [row["error"][key] for row in rows if row["observable"].get(key)]
        name = f"check without a target: {what}"
        found.append(share(f"{name} called observable", len(known), len(rows)))
        found.append(Figure(f"{name}, largest error where observable", max(known, default=None), unit, at_most=bound))
    within = [abs(z) < 3.0 for row in rows if "in_sigmas" in row for v in row["in_sigmas"].values() for z in v]
    found.append(share("check without a target: truth within three sigmas", sum(within), len(within), at_least=97.0))
    wrong = [row for row in rows if row["fits"] is True]
    found.append(share("check without a target: knocked calibrations said to fit", len(wrong), len(rows), at_most=0.0))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="200-209", help="robots, one hand-held recording of each")
    add_results_option(parser, "calibrate_check")
    options = parser.parse_args()
    run = Run.begin()
    work = work_folder() / "calibration-check"
    work.mkdir(parents=True, exist_ok=True)
    paths = [RECORDINGS / name for name in REAL if (RECORDINGS / name).exists()]
    for seed in parse_seeds(options.seeds):
        path = work / f"hand-{seed}"
        if not path.exists():
            record_hand_held(path, seed)
        paths.append(path)
    rows = []
    with threadpool_limits(1):
        for path in paths:
            for direction in range(DIRECTIONS):
                rows.append(checked(path, direction))
                print(json.dumps(rows[-1]), flush=True)
    run.write(options.results, figures(rows))


if __name__ == "__main__":
    main()
