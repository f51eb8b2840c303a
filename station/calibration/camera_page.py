"""A calibrated camera as a picture: residuals over the image, coverage, and the lens models side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.calibration.bundle import residuals
from station.calibration.camera import CameraFit, covered_cells

if TYPE_CHECKING:  # a worker that draws imports it, not all that are forked
    from matplotlib.figure import Figure

MAGNIFIED = 100.0  # residuals against the image


def write_camera_page(found: CameraFit, path: Path) -> None:
    """Write the picture as a PNG."""
    draw_camera_page(found).savefig(path, format="png", dpi=110)


def draw_camera_page(found: CameraFit) -> Figure:
    """Residuals over the image, its coverage, and how well each lens model foretells unseen images."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.2), layout="constrained")
    map_axes, cover_axes, lens_axes = figure.subplots(1, 3, width_ratios=(2.0, 1.4, 1.0))
    width, height = found.size
    uv = found.corners.uv_px
    rest = residuals(found.corners, found.fit)
    inside = found.fit.is_inlier
    map_axes.quiver(
        uv[inside, 0], uv[inside, 1], *(MAGNIFIED * rest[inside].T), np.linalg.norm(rest[inside], axis=1),
        angles="xy", scale_units="xy", scale=1.0, width=0.0015, cmap="viridis",
    )  # fmt: skip
    map_axes.plot(*uv[~inside].T, "x", color="tab:red", markersize=3, label="left out")
    map_axes.set(title=f"residuals x {MAGNIFIED:.0f}, rms {found.rms_px:.2f} px", xlim=(0, width), ylim=(height, 0))
    cover_axes.imshow(covered_cells(uv, found.size), extent=(0, width, height, 0), cmap="Greens", vmin=0, vmax=1.5)
    cover_axes.plot(*uv.T, ".", color="black", markersize=1)
    cover_axes.set(title=f"coverage {100 * found.coverage:.0f} %", xlim=(0, width), ylim=(height, 0))
    lens_axes.barh([trial.lens for trial in found.trials], [trial.validation_px for trial in found.trials])
    lens_axes.set(title="unseen images, px")
    return figure
