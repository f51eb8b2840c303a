"""The thesis' figures 5.2 and 5.3: a navigation's orientation error and trajectory error over time, and its path."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from shared.geometry import FloatArray, IntArray
from station.experiments.evaluation import DRIFT_OVER_S, Evaluation
from station.experiments.figures import save_figure
from station.experiments.plotting import COLOURS, FIRST, SECOND, STYLE

ERRORS, PATH = "errors.png", "path.png"
MIN_BREAK_NS = 2_000_000_000  # a line is broken where nothing was compared for longer, and for three usual intervals
FEW = 200  # so few poses are marked one by one: of a single one between two gaps a line shows nothing


def draw_evaluation(evaluation: Evaluation, title: str, folder: Path) -> None:
    """Write both figures."""
    with plt.rc_context(STYLE):
        draw_errors(evaluation, title, folder / ERRORS)
        draw_path(evaluation, title, folder / PATH)


def draw_errors(evaluation: Evaluation, title: str, path: Path) -> None:
    """Orientation error above, position error below, with their parts along the truth's axes."""
    absolute = evaluation.absolute
    rpe = evaluation.relative
    drift = f", RPE over {DRIFT_OVER_S:.0f} s {rpe.translation_rmse_m:.3f} m" if rpe else ""
    rotation_deg = math.degrees(absolute.rotation_rmse_rad)
    figure, (above, below) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
    t_ns = absolute.t_robot_ns
    _draw_error(above, t_ns, np.degrees(absolute.turns_rad), FIRST, ("about x", "about y", "about z"))
    above.set(ylabel="orientation error (°)", title=f"{title}: orientation error, RMSE {rotation_deg:.2f}°")
    _draw_error(below, t_ns, absolute.offsets_m, SECOND, ("along x", "along y", "along z"))
    below.set(
        ylabel="position error (m)",
        xlabel="time (s)",
        title=f"position error after alignment ({evaluation.kind}), ATE {absolute.rmse_m:.3f} m{drift}",
    )
    save_figure(figure, path)


def _draw_error(ax: Axes, t_ns: IntArray, parts: FloatArray, colour: str, names: tuple[str, str, str]) -> None:
    t_s, broken = _broken(t_ns, parts)
    for k, name in enumerate(names):
        ax.plot(t_s, broken[:, k], c=COLOURS[k + 1], lw=0.8, alpha=0.75, label=name)
    ax.plot(t_s, np.linalg.norm(broken, axis=1), line_style(len(t_ns)), c=colour, lw=1.8, ms=4, label="size")
    ax.axhline(0.0, c="#9AA3AF", lw=0.7, zorder=1)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)


def _broken(t_ns: IntArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times in s from the first one, and values, with NaN put into gaps: no line is drawn across them."""
    t_s = 1e-9 * (t_ns - t_ns[0])
    intervals_ns = np.diff(t_ns)
    gaps = np.flatnonzero(intervals_ns > max(MIN_BREAK_NS, 3 * float(np.median(intervals_ns)))) + 1
    return np.insert(t_s, gaps, np.nan), np.insert(values, gaps, np.nan, axis=0)


def line_style(count: int) -> str:
    """Of matplotlib, for a line through so many poses."""
    return ".-" if count < FEW else "-"


def draw_path(evaluation: Evaluation, title: str, path: Path) -> None:
    """Estimate and truth along the axes of the truth's world: x against y, and x against z."""
    estimate, truth = evaluation.aligned, evaluation.truth
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    t = truth.t_robot_ns
    during = (t >= estimate.t_robot_ns[0]) & (t <= estimate.t_robot_ns[-1])
    p_truth, p_estimate = truth.T_world_body[during, :3, 3], estimate.T_world_body[:, :3, 3]
    for ax, (i, j) in zip(axes, ((0, 1), (0, 2)), strict=True):
        ax.plot(p_truth[:, i], p_truth[:, j], c="#6B7280", lw=1.4, label="truth")
        style = line_style(len(p_estimate))
        ax.plot(
            p_estimate[:, i],
            p_estimate[:, j],
            style,
            c=SECOND,
            lw=1.2,
            ms=4,
            label=f"estimate, aligned ({evaluation.kind})",
        )
        ax.scatter(*p_truth[0, [i, j]], s=40, c="white", edgecolors="#111827", zorder=5, label="begin")
        ax.set_aspect("equal", adjustable="datalim")
        ax.set(xlabel=f"{'xyz'[i]} (m)", ylabel=f"{'xyz'[j]} (m)")
    axes[0].set_title(title)
    axes[1].set_title(f"{len(evaluation.absolute.t_robot_ns)} poses compared, coverage {evaluation.coverage:.0%}")
    axes[0].legend(loc="best", fontsize=8)
    save_figure(figure, path)
