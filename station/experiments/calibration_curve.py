"""The curve behind a calibration error: of the answers given with a probability, the share that was right."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

BINS = 10  # as many as the expected calibration error is made of
CERTAINTY_Z = 1.96  # of the shares' intervals: 95 %


@dataclass(frozen=True, slots=True)
class Bin:
    """Answers of about one probability."""

    count: int
    probability: float  # mean of what was claimed
    right: int

    @property
    def share(self) -> float:
        return self.right / self.count

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share, with 95 %: a few right answers prove little."""
        return wilson_interval(self.right, self.count)


def wilson_interval(count: int, of: int) -> tuple[float, float]:
    """Where the true share lies with 95 % (Wilson, JASA 22, 1927); anywhere from 0 to 1 where nothing was tried.

    Trials count as independent of each other here; answers of one drive are not, so it is wider in truth.
    """
    if of == 0:
        return 0.0, 1.0
    share, z2 = count / of, CERTAINTY_Z**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = CERTAINTY_Z / (1 + z2 / of) * math.sqrt(share * (1 - share) / of + z2 / (4 * of * of))
    # Where all or none are right the interval ends there; the sums above round to a hair beside it.
    return min(max(0.0, middle - half), share), max(min(1.0, middle + half), share)


def calibration_bins(answers: Iterable[tuple[float, bool]]) -> tuple[Bin, ...]:
    """Of (probability, whether it was right): the bins of a tenth that hold any, lowest probability first."""
    held: list[list[tuple[float, bool]]] = [[] for _ in range(BINS)]
    for probability, right in answers:
        held[min(max(int(probability * BINS), 0), BINS - 1)].append((probability, right))
    return tuple(
        Bin(len(those), math.fsum(p for p, _ in those) / len(those), sum(right for _, right in those))
        for those in held
        if those
    )


def calibration_error(bins: Sequence[Bin]) -> float:
    """Expected calibration error: how far shares and probabilities lie apart, weighed by the answers; 0 without any."""
    total = sum(b.count for b in bins)
    return math.fsum(b.count * abs(b.share - b.probability) for b in bins) / total if total else 0.0


def draw_calibration(curves: Sequence[tuple[str, Sequence[Bin]]], path: Path) -> None:
    """Each named curve with its intervals and, below, how many answers each point rests on (log scale)."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(
        2, 1, figsize=(6.4, 6.0), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    above.plot([0, 1], [0, 1], ":", color="grey", label="as claimed")
    width = 0.8 / BINS / max(1, len(curves))
    for k, (name, bins) in enumerate(curves):
        label = f"{name}: {sum(b.count for b in bins)} answers, error {calibration_error(bins):.3f}"
        x, share = [b.probability for b in bins], [b.share for b in bins]
        spans = [[b.share - b.interval[0] for b in bins], [b.interval[1] - b.share for b in bins]]
        bars = above.errorbar(x, share, spans, fmt="o-" if k == 0 else "s--", capsize=3, markersize=5, label=label)
        colour = bars.lines[0].get_color()
        for b in bins:
            cell = min(int(b.probability * BINS), BINS - 1) + 0.5
            at = cell / BINS + (k - (len(curves) - 1) / 2) * width
            below.bar(at, b.count, width, color=colour)
            below.annotate(str(b.count), (at, b.count), ha="center", va="bottom", fontsize=7)
    above.set(ylabel="share right (95 % interval)", xlim=(0, 1), ylim=(-0.02, 1.02))
    above.legend(fontsize=8, loc="upper left")
    most = max([b.count for _, bins in curves for b in bins], default=1)
    below.set(xlabel='probability of an answer "known"', ylabel="answers", yscale="log", ylim=(0.7, 3 * most))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
