"""How well the clock estimate finds injected drift: runs of 30 s with 30 stamps a second and three kinds of jitter.

python -m benchmarks.bench_clock --runs 1000
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.result import FOLDER, RESULTS_HELP, Figure, Run
from shared.clock import RemoteClock
from tests.support.clock import S, feed

DRIFT_PPM = 5000.0
DRIFT_BOUND_PPM, CLOCK_BOUND_US = 20.0, 300.0
JITTER = {
    "exponential": "exponential, mean 2 ms",
    "uniform": "uniform, 0 to 5 ms",
    "spiky": "exponential, and one in ten late by 50 ms in the mean",
}


def main(
    runs: Annotated[int, typer.Option(help="Runs per kind of jitter.")] = 100,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "clock.json",
) -> None:
    """Print a table of the errors: seeds 0, 1, ... for the jitter, drift drawn from a generator seeded 123."""
    run = Run.begin()
    worst_drift, worst_clock = 0.0, 0.0
    rng = np.random.default_rng(123)
    print("| jitter | runs | drift error p50 / p99 / max ppm | clock error over the 30 s p50 / p99 / max µs |")
    print("| --- | --- | --- | --- |")
    for kind, description in JITTER.items():
        drift_errors, clock_errors = [], []
        for seed in range(runs):
            drift_ppm = rng.uniform(-DRIFT_PPM, DRIFT_PPM)
            clock = RemoteClock()
            feed(clock, drift_ppm, 0, kind, seed)
            fit = clock.fit
            assert fit is not None
            drift_errors.append(abs(fit.drift_ppm - drift_ppm))
            locals_ns = [second * S for second in range(31)]
            clock_errors.append(
                max(abs(fit.to_local_ns(round(t * (1 + drift_ppm * 1e-6))) - t) * 1e-3 for t in locals_ns)
            )
        drift = " / ".join(f"{value:.1f}" for value in np.percentile(drift_errors, [50, 99, 100]))
        error = " / ".join(f"{value:.0f}" for value in np.percentile(clock_errors, [50, 99, 100]))
        print(f"| {description} | {runs} | {drift} | {error} |")
        worst_drift, worst_clock = max(worst_drift, *drift_errors), max(worst_clock, *clock_errors)
    tried, kinds = len(JITTER) * runs, f"{len(JITTER)} kinds of jitter"
    run.write(
        results,
        [
            Figure(f"clock drift after 30 s, largest error, {kinds}", worst_drift, "ppm", DRIFT_BOUND_PPM, of=tried),
            Figure(f"clock over those 30 s, largest error, {kinds}", worst_clock, "µs", CLOCK_BOUND_US, of=tried),
        ],
    )


if __name__ == "__main__":
    typer.run(main)
