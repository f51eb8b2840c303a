"""Are a robot's wheels measured right? Simulated drives before a board, other wheels, lens and board pose per seed.

    python -m benchmarks.bench_calibrate_wheels --seeds 0-19

One JSON line per recording: what was measured beside what is true, good recordings first, then those with a mistake,
which must be refused. Nothing is kept.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_mapping import parse_seeds
from benchmarks.calibration_sessions import poor_row, refusals
from benchmarks.result import Figure, Run, add_results_option, share
from robot.simulation.calibration.conduct import POOR
from robot.simulation.calibration.kind import Kind
from robot.simulation.calibration.sessions import record_session
from shared.errors import DataError
from station.calibration.target_file import read_target
from station.calibration.wheels import GYRO_SIGMA, WAY_SIGMA, Wheels, calibrate_wheels
from station.commands.calibrate.wheels import report
from station.datasets import open_dataset

FULL_SPEED_M_S, TRACK_M = 0.6, 0.25  # what the simulated robot drove with
QUANTITIES = {"full_speed_m_s": 0.01, "track_m": 0.01, "lag_s": None}  # largest relative error asked for


def measure(seed: int, poor: str | None, folder: Path) -> dict[str, Any]:
    """One recording, made and measured."""
    truth = record_session(Kind.WHEELS, folder, seed, poor).truth["wheels"]
    true = {
        "full_speed_m_s": FULL_SPEED_M_S * truth["linear_efficiency"],
        "track_m": TRACK_M * truth["linear_efficiency"] / truth["yaw_efficiency"],
        "lag_s": truth["lag_s"],
    }
    row: dict[str, Any] = {"seed": seed, "poor": poor, "true": true}
    try:
        found = calibrate_wheels(open_dataset(folder), read_target(folder / "target.yaml"))
    except DataError as exc:
        return row | {"accepted": False, "reasons": [str(exc).replace(str(folder), "the recording")]}
    return row | report(found, FULL_SPEED_M_S, TRACK_M) | {"scatter": _scatter(found)}


def _scatter(found: Wheels) -> dict[str, float]:
    """Standard deviations by the scatter of the moves alone: the simulator lacks the errors that all moves share.

    The assumed sigmas of focal length, board and gyroscope, squared, were added to these.
    """
    if found.speed is None or found.turn is None:
        return {}
    way, turn = (
        math.sqrt((factor.sigma / factor.value) ** 2 - shared**2)
        for factor, shared in ((found.speed, WAY_SIGMA), (found.turn, GYRO_SIGMA))
    )
    speed_m_s = FULL_SPEED_M_S * found.speed.value
    return {
        "full_speed_m_s": way * speed_m_s,
        "track_m": math.hypot(way, turn) * TRACK_M * found.speed.value / found.turn.value,
    }


def figures(good: list[dict[str, Any]], poor: list[dict[str, Any]]) -> list[Figure]:
    found = []
    for name, bound in QUANTITIES.items():
        rows = [row for row in good if row[name] is not None]
        errors = np.array([abs(row[name] - row["true"][name]) for row in rows])
        relative = 100 * errors / [row["true"][name] for row in rows]
        at_most = None if bound is None else 100 * bound
        found.append(Figure(f"{name}, median error", float(np.median(relative)), "%"))
        found.append(Figure(f"{name}, largest error", float(relative.max()), "%", at_most=at_most))
        inside = int(np.sum(errors <= 3 * np.array([row["sigma"][name] for row in rows])))
        found.append(share(f"{name} within three of its sigmas", inside, len(rows), at_least=97))
        if bound is not None:
            inside = int(np.sum(errors <= 3 * np.array([row["scatter"][name] for row in rows])))
            found.append(share(f"{name} within three sigmas by the moves' scatter alone", inside, len(rows)))
    found.append(share("good recordings accepted", sum(row["accepted"] for row in good), len(good), at_least=100))
    return found + refusals(Kind.WHEELS, [poor_row(Kind.WHEELS, row["poor"], row) for row in poor])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-19", help="of good recordings: 1 or 0-19")
    parser.add_argument("--poor-seed", type=int, default=0, help="of the recordings with a mistake, one of each kind")
    add_results_option(parser, "calibrate_wheels")
    args = parser.parse_args()
    run = Run.begin()
    wanted = [(seed, None) for seed in parse_seeds(args.seeds)]
    rows = []
    with threadpool_limits(1), tempfile.TemporaryDirectory() as scratch:
        for number, (seed, poor) in enumerate([*wanted, *((args.poor_seed, poor) for poor in POOR[Kind.WHEELS])]):
            rows.append(measure(seed, poor, Path(scratch) / str(number)))
            print(json.dumps(rows[-1]), flush=True)
    run.write(args.results, figures(rows[: len(wanted)], rows[len(wanted) :]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
