"""How well is an IMU's noise known from a recording at rest? Series of known noise, of several kinds and lengths.

    python -m benchmarks.bench_calibrate_imu --seeds 20

Four kinds of gyroscope and accelerometer (plain, quiet, flickering, and one whose flicker hides the random walk) at
100 Hz. One JSON line per recording, refused ones too. `3 sigmas` is an interval 1.53 times as wide as the printed one.
Limits from above, which any smaller value is within, are counted apart.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.result import Figure, Run, add_results_option, share
from station.calibration.imu.calibrate import ImuCalibration, calibrate_imu
from station.calibration.imu.noise_fit import Estimate
from station.calibration.imu.spectrum import spectrum_of
from tests.support.inertial_noise import (
    ACCEL,
    FLICKERING_ACCEL,
    FLICKERING_GYRO,
    GYRO,
    QUIET_ACCEL,
    QUIET_GYRO,
    TrueNoise,
    resting,
)

RATE_HZ = 100.0
MINUTES = (2.0, 8.0, 20.0)
HIDDEN_GYRO, HIDDEN_ACCEL = TrueNoise(2.6e-4, 2e-5, 2e-4), TrueNoise(2.26e-3, 2e-4, 1.8e-3)
MIXES = {
    "plain": (GYRO, ACCEL),
    "quiet": (QUIET_GYRO, QUIET_ACCEL),
    "flickering": (FLICKERING_GYRO, FLICKERING_ACCEL),
    "hidden walk": (HIDDEN_GYRO, HIDDEN_ACCEL),
}
THREE_SIGMAS = 3.0 / 1.96


def rows_of(mix: str, minutes: float, seed: int) -> list[dict[str, Any]]:
    """What was found of each figure of one recording."""
    gyro, accel = MIXES[mix]
    imu = resting(seed, 60 * minutes, RATE_HZ, gyro, accel)
    begin = time.perf_counter()
    found = calibrate_imu(imu)
    about = {"mix": mix, "minutes": minutes, "seed": seed, "seconds": round(time.perf_counter() - begin, 2)}
    if not found.accepted:
        return [about | {"refused": list(found.reasons)}]
    return [about | figure for figure in _figures(found, gyro, accel)]


def _figures(found: ImuCalibration, gyro: TrueNoise, accel: TrueNoise) -> list[dict[str, Any]]:
    assert found.gyro is not None and found.accel is not None
    judged = []
    for name, sensor, truth in (("gyro", found.gyro, gyro), ("accel", found.accel, accel)):
        for figure in ("density", "walk"):
            estimate: Estimate = getattr(sensor.noise, figure)
            judged.append({"figure": figure, "sensor": name, **_judged(estimate, getattr(truth, figure))})
    return judged


def _judged(estimate: Estimate, true: float) -> dict[str, Any]:
    low = estimate.value - THREE_SIGMAS * (estimate.value - estimate.low)
    high = estimate.value + THREE_SIGMAS * (estimate.high - estimate.value)
    return {
        "error": round(estimate.value / true - 1.0, 4),
        "known": estimate.is_known,
        "is_limit": estimate.low <= 0.0,  # from above only
        "within_interval": estimate.low <= true <= estimate.high,
        "within_3_sigmas": low <= true <= high,
    }


def least_sigma(noise: TrueNoise, minutes: float) -> float:
    """The smallest relative standard deviation that an unbiased estimate of the random walk can have (Cramer and Rao).

    Of three axes, by the likelihood of `noise_fit.py` at the true values, below a tenth of the rate. Who knows that
    there is no flicker knows more; only where there is some must it be estimated as well.
    """
    bands = spectrum_of([np.zeros(round(60 * minutes * RATE_HZ))], RATE_HZ, RATE_HZ / 10)
    theta = np.array([noise.density**2 * RATE_HZ, noise.instability**2, noise.walk**2 / RATE_HZ])
    share = (bands.design * theta / (bands.design @ theta)[:, None])[:, theta > 0.0]  # d log(expected) / d log(theta)
    information = 3 * share.T @ (0.5 * bands.dof[:, None] * share)
    return 0.5 * float(np.sqrt(np.linalg.inv(information)[-1, -1]))  # of the walk: half of its square's


def summary(rows: list[dict[str, Any]]) -> list[Figure]:
    """Against what the issue asks."""
    measured = [row for row in rows if "figure" in row]

    def chosen(figure: str, minutes: float, mixes: tuple[str, ...] = tuple(MIXES)) -> list[dict[str, Any]]:
        wanted = (figure, minutes)
        return [row for row in measured if (row["figure"], row["minutes"]) == wanted and row["mix"] in mixes]

    def worst(rows: list[dict[str, Any]]) -> float | None:
        return max((100 * abs(row["error"]) for row in rows), default=None)

    figures = [Figure("white noise after 2 minutes, largest error", worst(chosen("density", 2.0)), "%", at_most=5)]
    for mixes in (("plain", "quiet"), ("flickering",), ("hidden walk",)):
        walks = chosen("walk", 20.0, mixes)
        near = sum(abs(row["error"]) <= 0.2 for row in walks)
        title = f"random walk within 20 % after 20 minutes: {', '.join(mixes)}"
        figures.append(share(title, near, len(walks), at_least=100))
        figures.append(Figure(f"random walk after 20 minutes, largest error: {', '.join(mixes)}", worst(walks), "%"))
        least = max(least_sigma(noise, 20.0) for mix in mixes for noise in MIXES[mix])
        what = f"random walk after 20 minutes, least standard deviation of any unbiased estimate: {', '.join(mixes)}"
        figures.append(Figure(what, 100 * least, "%"))
        figures += _told(walks, ", ".join(mixes))
    for minutes in MINUTES:
        found = [row for row in measured if row["minutes"] == minutes]
        inside = sum(row["within_interval"] for row in found)
        figures.append(
            share(f"true value within the 95 % interval, {minutes:g} minutes", inside, len(found), at_least=95)
        )
    for is_limit, what in ((False, "true value within three sigmas, all lengths"), (True, "true value below a limit")):
        rows_so = [row for row in measured if row["is_limit"] == is_limit]
        inside = sum(row["within_3_sigmas"] for row in rows_so)
        figures.append(share(what, inside, len(rows_so), at_least=97))
    recordings = {(row["mix"], row["minutes"], row["seed"]): row for row in rows}
    refused = sum("refused" in row for row in recordings.values())
    figures.append(share("good recordings refused", refused, len(recordings), at_most=0))
    slowest = max((row["seconds"] for row in recordings.values()), default=None)
    figures.append(Figure("longest computation, 20 minutes at 100 Hz", slowest, "s"))
    return figures


def _told(walks: list[dict[str, Any]], mixes: str) -> list[Figure]:
    """Of what a recording claims to know, and of what it says to be hidden by flicker."""
    told, hidden = ([row for row in walks if row["known"] == known] for known in (True, False))
    near = sum(abs(row["error"]) <= 0.2 for row in told)
    inside = sum(row["within_interval"] for row in hidden)
    return [
        share(f"random walk after 20 minutes told: {mixes}", len(told), len(walks)),
        share(f"random walk after 20 minutes told, within 20 %: {mixes}", near, len(told), at_least=100),
        share(f"random walk after 20 minutes not told, true value within the interval: {mixes}", inside, len(hidden),
              at_least=95),
    ]  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="recordings of each kind and length")
    add_results_option(parser, "calibrate_imu")
    args = parser.parse_args()
    run = Run.begin()
    rows = []
    with threadpool_limits(1):
        for mix in MIXES:
            for minutes in MINUTES:
                for seed in range(args.seeds):
                    found = rows_of(mix, minutes, seed)
                    rows += found
                    print(*map(json.dumps, found), sep="\n", flush=True)
    run.write(args.results, summary(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
