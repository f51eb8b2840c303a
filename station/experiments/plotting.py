"""How the figures of an experiment look: style, colours, axes and labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import matplotlib as mpl

mpl.use("Agg")  # files only: no display is needed, and none is opened

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shared.geometry import FloatArray
from station.model.frames import ImageArray, decode_picture
from station.model.place_map import Place

# Okabe and Ito's colours first: told apart by colour-blind readers, too; then as many as a flat may need.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#8C6BB1", "#B8A800",
           "#7F3B08", "#1B7837", "#A50026", "#4575B4", "#F768A1", "#525252", "#66C2A4", "#FC8D62")  # fmt: skip
FIRST, SECOND, NOISE_COLOUR, RIGHT, WRONG = "#1F4E9E", "#D1382C", "#C9CDD3", "#1B8A4B", "#C62828"
STYLE: dict[Any, Any] = {  # Any: the library lists every key as a literal
    "font.family": "DejaVu Sans", "font.size": 9, "axes.titlesize": 10, "axes.titleweight": "bold",
    "axes.edgecolor": "#9AA3AF", "axes.labelcolor": "#374151", "xtick.color": "#6B7280", "ytick.color": "#6B7280",
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#EEF0F3",
    "axes.axisbelow": True, "legend.frameon": False, "figure.dpi": 110, "savefig.bbox": "tight",
}  # fmt: skip
VIEWS = {"above": (0, 1), "in front": (0, 2)}


def short(place: Place) -> str:
    """The number of a place that was named by number; else its name."""
    tail = place.name.rpartition(" ")[2]
    return tail if tail.isdecimal() else place.name


def limits(clouds: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Corners that hold nearly all points: single far outliers must not shrink the rest to a dot."""
    p = np.concatenate([c[np.isfinite(c).all(axis=1)] for c in clouds])
    if not len(p):
        return np.full(3, -1.0), np.full(3, 1.0)
    low, high = np.percentile(p, 1, axis=0), np.percentile(p, 99, axis=0)
    margin = 0.08 * float((high - low).max()) + 1e-6
    return low - margin, high + margin


def frame(ax: Axes, limits: tuple[FloatArray, FloatArray], axes: tuple[int, int], unit: str) -> None:
    i, j = axes
    ax.set_xlim(limits[0][i], limits[1][i])
    ax.set_ylim(limits[0][j], limits[1][j])
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlabel(f"{'xyz'[i]} ({unit})")
    ax.set_ylabel(f"{'xyz'[j]} ({unit})")


def legend_below(figure: Figure, ax: Axes, markerscale: float = 1.0) -> None:
    figure.legend(*ax.get_legend_handles_labels(), loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=3,
                  markerscale=markerscale, columnspacing=1.6)  # fmt: skip


def label(ax: Axes, at: FloatArray, text: str, colour: str) -> None:
    ax.annotate(
        text, (float(at[0]), float(at[1])), ha="center", va="center", fontsize=8, fontweight="bold", color="white",
        bbox={"boxstyle": "round,pad=0.25", "fc": colour, "ec": "white", "lw": 1.0}, zorder=6, annotation_clip=True,
    )  # fmt: skip


def decode_rgb(encoded: bytes) -> ImageArray | None:
    """(H, W, 3) pixels of a JPEG or PNG; None where the file is none."""
    try:
        return decode_picture(encoded, cv2.IMREAD_COLOR)[..., ::-1]
    except ValueError:
        return None


def without_axes(ax: Axes) -> None:
    """A panel for a picture: no ticks, no grid, a grey ground where the picture is missing."""
    ax.set_xticks([])
    ax.set_yticks([])
    ax.grid(visible=False)
    ax.set_facecolor("#F3F4F6")
