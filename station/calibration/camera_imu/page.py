"""Camera and IMU, calibrated, as a picture: what is left over in the image and over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.calibration.camera_imu.batch import Solution, within
from station.calibration.camera_imu.rows import camera_rows, inertial_rows

if TYPE_CHECKING:  # a worker that draws imports it, not all that are forked
    from matplotlib.figure import Figure

MAGNIFIED = 100.0  # residuals against the image


def write_camera_imu_page(found: Solution, path: Path) -> None:
    """Write the picture as a PNG."""
    draw_camera_imu_page(found).savefig(path, format="png", dpi=110)


def draw_camera_imu_page(found: Solution) -> Figure:
    """Residuals of the corners over the image; those of gyroscope and accelerometer over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.2), layout="constrained")
    map_axes, gyro_axes, accel_axes = figure.subplots(1, 3, width_ratios=(1.3, 1.0, 1.0))
    unknowns, problem = found.unknowns, found.problem
    corners = within(problem.corners, unknowns)
    rest = camera_rows(unknowns, corners).residual * corners.sigma_px
    shown = slice(None, None, max(1, len(rest) // 4000))
    camera = unknowns.camera
    map_axes.quiver(
        *corners.uv_px[shown].T, *(MAGNIFIED * rest[shown].T), np.linalg.norm(rest[shown], axis=1),
        angles="xy", scale_units="xy", scale=1.0, width=0.0015, cmap="viridis",
    )  # fmt: skip
    title = f"corners: residuals x {MAGNIFIED:.0f}, rms {found.rms_px:.2f} px"
    map_axes.set(title=title, xlim=(0, camera.width), ylim=(camera.height, 0))
    felt = problem.samples.between(unknowns.motion.start_s, unknowns.motion.end_s)
    left = inertial_rows(unknowns, felt).residual
    for axes, columns, sigma, name, unit in (
        (gyro_axes, slice(0, 3), felt.sigma_gyro, "gyroscope", "rad/s"),
        (accel_axes, slice(3, 6), felt.sigma_accel, "accelerometer", "m/s²"),
    ):
        axes.plot(felt.t_s, left[:, columns] * sigma, linewidth=0.5, label=("x", "y", "z"))
        axes.set(title=f"{name}: residuals, {unit}", xlabel="s")
    gyro_axes.legend(loc="upper right")
    return figure
