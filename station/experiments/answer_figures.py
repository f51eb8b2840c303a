"""What answers of the current place look like over time, and whether their probabilities are what they claim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from shared.geometry import FloatArray, IntArray
from station.experiments.answers import JudgedAnswers
from station.experiments.calibration_curve import draw_calibration
from station.experiments.figures import save_figure
from station.experiments.plotting import FIRST, RIGHT, STYLE, WRONG
from station.model.place_answer import HijackEvent

OVER_TIME, CALIBRATION = "over_time.png", "calibration.png"
ROWS = ("lost", "unknown", "known")  # from below
KINDS = {"right": RIGHT, "wrong": WRONG, "known, not judged": FIRST, "unknown": "#E69F00", "lost": "#6B7280"}


def draw_answers(judged: JudgedAnswers, hijacks: Sequence[HijackEvent], title: str, folder: Path) -> None:
    """Write both figures; no calibration curve where nothing could be judged."""
    with plt.rc_context(STYLE):
        if judged.answers:
            draw_over_time(judged, hijacks, title, folder / OVER_TIME)
        if bins := judged.bins():
            draw_calibration([(title, bins)], folder / CALIBRATION)


def draw_over_time(judged: JudgedAnswers, hijacks: Sequence[HijackEvent], title: str, path: Path) -> None:
    """State, probability of the named place, and position error of every answer."""
    t_ns = np.array([answer.t_robot_ns for answer in judged.answers], dtype=np.int64)
    t_s, kinds = 1e-9 * (t_ns - t_ns[0]), kinds_of(judged)
    has_errors = bool(np.isfinite(judged.position_error_m).any())
    heights = (1.0, 1.6, 1.6) if has_errors else (1.0, 1.6)
    figure, axes = plt.subplots(
        len(heights), 1, figsize=(10, 2 * sum(heights)), sharex=True, layout="constrained", height_ratios=heights,
        squeeze=False,
    )  # fmt: skip
    _draw_states(axes[0, 0], t_s, judged, kinds)
    axes[0, 0].set_title(f"{title}: {_told(judged)}")
    _draw_probabilities(axes[1, 0], t_s, judged, kinds)
    if has_errors:
        _draw_position_errors(axes[2, 0], t_s, judged.position_error_m, kinds)
    for ax in axes[:, 0]:
        for event in hijacks:
            ax.axvline(1e-9 * (event.t_robot_ns - t_ns[0]), c="#8C6BB1", lw=1.0, ls="--", zorder=1)
    _legend(axes[0, 0], kinds, len(hijacks))
    axes[-1, 0].set_xlabel("time (s)")
    save_figure(figure, path)


def kinds_of(judged: JudgedAnswers) -> list[str]:
    """Of each answer the one of KINDS that it is."""
    known = np.where(judged.is_judged, np.where(judged.is_right, "right", "wrong"), "known, not judged")
    return [
        str(kind) if answer.state == "known" else answer.state
        for answer, kind in zip(judged.answers, known, strict=True)
    ]


def _told(judged: JudgedAnswers) -> str:
    summary = judged.summary()
    counts = f"{summary['answers']} answers, {summary['known']} known"
    if summary["truth"] == "none":
        return counts
    return f"{counts}: {summary['right']} right, {summary['wrong']} wrong"


def _rows_of(kinds: Sequence[str], kind: str) -> IntArray:
    return np.flatnonzero(np.array(kinds) == kind)


def _draw_states(ax: Axes, t_s: FloatArray, judged: JudgedAnswers, kinds: Sequence[str]) -> None:
    height = np.array([ROWS.index(answer.state) for answer in judged.answers])
    ax.plot(t_s, height, c="#D1D5DB", lw=0.8, zorder=1)
    for kind, colour in KINDS.items():
        rows = _rows_of(kinds, kind)
        ax.scatter(t_s[rows], height[rows], s=26, marker="|" if len(t_s) > 400 else "o", c=colour, zorder=3)
    ax.set_yticks(range(len(ROWS)), ROWS)
    ax.set_ylim(-0.5, len(ROWS) - 0.5)
    ax.set_ylabel("state")


def _draw_probabilities(ax: Axes, t_s: FloatArray, judged: JudgedAnswers, kinds: Sequence[str]) -> None:
    """Filled: of the place that is named; hollow: of the likeliest place while none is named."""
    for kind, colour in KINDS.items():
        for row in _rows_of(kinds, kind):
            answer = judged.answers[row]
            candidate = answer.place or (answer.alternatives[0] if answer.alternatives else None)
            if candidate is not None:
                face = colour if answer.place else "white"
                ax.scatter(t_s[row], candidate.probability, s=18, c=face, edgecolors=colour, linewidths=1.0, zorder=3)
    ax.set(ylabel="probability of the place\n(hollow: not named)", ylim=(-0.03, 1.03))


def _draw_position_errors(ax: Axes, t_s: FloatArray, error_m: FloatArray, kinds: Sequence[str]) -> None:
    for kind, colour in KINDS.items():
        rows = _rows_of(kinds, kind)
        ax.scatter(t_s[rows], error_m[rows], s=18, c=colour, zorder=3)
    finite = error_m[np.isfinite(error_m)]
    median = float(np.median(finite))
    ax.axhline(median, c="#9AA3AF", lw=1.0, zorder=1)
    ax.annotate(f"median {median:.3f} m", (1.0, median), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                fontsize=8, color="#6B7280")  # fmt: skip
    is_wide = finite.min() > 0 and finite.max() > 30 * median
    ax.set(ylabel="position error (m)", yscale="log" if is_wide else "linear")
    if not is_wide:
        ax.set_ylim(bottom=0.0)


def _legend(ax: Axes, kinds: Sequence[str], num_hijacks: int) -> None:
    for kind, colour in KINDS.items():
        if kind in kinds:
            ax.scatter([], [], c=colour, s=26, label=f"{kind} ({kinds.count(kind)})")
    if num_hijacks:
        ax.plot([], [], c="#8C6BB1", ls="--", lw=1.0, label=f"hijack noticed ({num_hijacks})")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
