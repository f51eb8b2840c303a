"""The Allan deviation of a resting inertial unit with the noise that was fitted, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.calibration.imu.sensor import SensorNoise

if TYPE_CHECKING:  # a worker that draws imports it, not all that are forked
    from matplotlib.axes import Axes

AXIS_COLOURS = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}  # Okabe and Ito's: told apart by colour-blind readers


def draw_allan(gyro: SensorNoise, accel: SensorNoise, path: Path) -> None:
    """Write a PNG or SVG, by the path's suffix."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw(left, gyro, "gyroscope", "rad/s")
    _draw(right, accel, "accelerometer", "m/s²")
    figure.savefig(path)


def _draw(ax: Axes, sensor: SensorNoise, name: str, unit: str) -> None:
    for (axis, colour), curve in zip(AXIS_COLOURS.items(), sensor.curves, strict=True):
        ax.fill_between(curve.tau_s, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0)
        ax.plot(curve.tau_s, curve.deviation, color=colour, linewidth=1.2, label=axis)
    noise, tau = sensor.noise, sensor.curves[0].tau_s
    fitted = np.sqrt(noise.allan_variance(tau))
    ax.plot(tau, fitted, color="black", linewidth=1.5, linestyle="--", label="fitted")
    ax.plot(tau, noise.density.value / np.sqrt(tau), color="0.5", linewidth=0.8, linestyle=":")
    if noise.walk.is_known:
        ax.plot(tau, noise.walk.value * np.sqrt(tau / 3.0), color="0.5", linewidth=0.8, linestyle=":")
    ax.set(xscale="log", yscale="log", xlabel="averaging time in s", ylabel=f"Allan deviation in {unit}", title=name)
    ax.set_ylim(0.3 * fitted.min(), 3.0 * fitted.max())
    ax.grid(True, which="both", color="0.92")
    ax.legend(frameon=False)
