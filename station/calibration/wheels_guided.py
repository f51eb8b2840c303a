"""The estimate at the end of a guided measurement of the wheels: from the recording, as the command makes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.calibration.target import Target
from station.calibration.wheels import Factor, Wheels, calibrate_wheels
from station.datasets import open_dataset

if TYPE_CHECKING:  # a worker that draws imports it, not all that are forked
    from matplotlib.figure import Figure


def estimate_wheels(
    recording: Path, target: Target, plot: Path, progress: Callable[[float, str], None]
) -> dict[str, Any]:
    """What the wheels make of a command, and a plot of all moves. Raises DataError: a sensor was not recorded."""
    data = open_dataset(recording, needs_upright=False)
    done, total = 0, max(1, len(data.frame_times_ns))

    def step() -> None:
        nonlocal done
        done += 1
        progress(0.9 * done / total, "looking for the board")

    found = calibrate_wheels(data, target, step)
    progress(0.95, "drawing the moves")
    draw_moves(found).savefig(plot, format="png", dpi=110)
    return wheels_result(found)


def wheels_result(found: Wheels) -> dict[str, Any]:
    """As a JSON object; what was not measured is null."""
    return {
        "speed": _factor(found.speed),
        "turn": _factor(found.turn),
        "lag_s": found.lag_s,
        "lag_sigma_s": found.lag_sigma_s,
        "accepted": found.accepted,
        "reasons": list(found.reasons),
    }


def _factor(factor: Factor | None) -> dict[str, Any] | None:
    if factor is None:
        return None
    return {"value": factor.value, "sigma": factor.sigma, "scatter": factor.scatter, "moves": factor.moves}


def draw_moves(found: Wheels) -> Figure:
    """What came of each command: straight ways to the left, turns to the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    ways, turns = figure.subplots(1, 2)
    drives = [(move.linear_m, move.went_m) for move in found.moves if move.is_drive and move.went_m is not None]
    spins = [(move.angular_rad, move.turned_rad) for move in found.moves if move.is_turn]
    for axes, pairs, factor, name, unit in (
        (ways, drives, found.speed, "straight ways", "m"),
        (turns, spins, found.turn, "turns on the spot", "rad"),
    ):
        axes.axhline(0.0, color="0.8", linewidth=0.8)
        axes.plot(*zip(*pairs, strict=True) if pairs else ((), ()), "o", label="each move")
        reach = 1.1 * max((abs(commanded) for commanded, _ in pairs), default=1.0)
        if factor is not None:
            axes.plot((-reach, reach), (-reach * factor.value, reach * factor.value), label=f"{factor.value:.3f}")
        axes.plot((-reach, reach), (-reach, reach), linestyle=":", color="0.5", label="as commanded")
        axes.set(title=name, xlabel=f"commanded, {unit}", ylabel=f"achieved, {unit}")
        axes.legend()
    return figure
