"""One image beside hypotheses of which several explain it: what it says of parts of a map that look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.geometry import FloatArray
from station.places.tracking.alike import Alike
from station.places.tracking.belief import SAME_POSE, Agreement, Hypothesis

LEAST = 1e-12  # of what has a logarithm
LEAST_LARGE = 0.01  # less surely larger than furniture: no twins


class Twins:
    """Hypotheses that the candidates of one image fit, and others that they do not (`alike.py`)."""

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        fits: Sequence[Sequence[Agreement]],
        share: FloatArray,
        large: FloatArray,
        freshness: float,
    ) -> None:
        """What an image says of hypotheses.

        Args:
            fits: (H, C)
            share: (C,) of each candidate, if one of them is right.
            large: (C,) 0..1, how surely what it recognised is larger than furniture that comes twice.
            freshness: 0..1, how new the image is.
        """
        self._hypotheses, self._large, self._freshness = hypotheses, large, freshness
        self.fitting = [_fitting(row, share) for row in fits]  # (H,) number of the candidate; None: it fits none
        logs = [
            0.0 if j is None else float(np.log(max(row[j].density * share[j], LEAST)))
            for row, j in zip(fits, self.fitting, strict=True)
        ]
        known = [x for x, j in zip(logs, self.fitting, strict=True) if j is not None]
        self._log_ratios = [x - float(np.mean(known)) if known else 0.0 for x in logs]  # (H,)
        self.tempering = np.array([self._tempering(i) for i in range(len(hypotheses))])  # (H,) factor of its candidates

    @property
    def fits_one_of_alike(self) -> bool:
        """Whether the image fits one of two hypotheses that are known to look alike, and not the other."""
        return any(
            h.alike.of(self._number(j)) > 0 for i, h in enumerate(self._hypotheses) for j in self._fits_one_with(i)
        )

    def likelihood(self, i: int, likelihood: float, at: FloatArray, fails: Sequence[float]) -> float:
        """Of the image at a hypothesis; `likelihood`: were nothing alike.

        Args:
            at: (H,) densities of the candidates there.
            fails: (H,) that an image is not recognised there.
        """
        alike, others = self._hypotheses[i].alike, self._fits_one_with(i)
        if self.fitting[i] is not None:
            return likelihood * min((1 - alike.of(self._number(j)) * (1 - fails[j]) for j in others), default=1.0)
        deceived = [(alike.of(self._number(j)), float(at[j])) for j in others]
        surely, density = max(deceived, key=lambda pair: pair[0] * pair[1], default=(0.0, 0.0))
        return (1 - surely) * likelihood + surely * fails[i] * density

    def after(self, expected_by: Sequence[int | None], fails: float) -> list[Alike]:
        """(H,) what hypotheses have in common after the image; `fails`: that an image is not recognised."""
        living = {h.number for h in self._hypotheses}
        alone = 1.0 if None in expected_by else fails
        return [self._after(i, alone).among(living) for i in range(len(self._hypotheses))]

    def levelled(self, factors: Sequence[float], alike: Sequence[Alike]) -> list[float]:
        """(H,) factors that leave each hypothesis at least what tells it from its rivals; rivals give up as much.

        Until it was known how alike two are, one image that was recognised at one of them only, or first pictures of
        little, told them apart: that does not count more than images since. `alike`: after the image.
        """
        weights = [h.weight * factor for h, factor in zip(self._hypotheses, factors, strict=True)]
        least = [self._least_weight(j, weights, alike) for j in range(len(weights))]
        raised = [max(*pair) for pair in zip(weights, least, strict=True)]
        given_up = sum(weights) / max(sum(raised), LEAST)
        return [given_up * x / max(h.weight, LEAST) for x, h in zip(raised, self._hypotheses, strict=True)]

    def _least_weight(self, j: int, weights: Sequence[float], alike: Sequence[Alike]) -> float:
        rivals, least = self._rivals(j), 0.0
        for i, weight in enumerate(weights):
            if self._number(i) in rivals:
                mine, other = alike[j], alike[i]
                log_ratio = min(0.0, mine.mean - other.mean + mine.log_failed - other.log_failed) + other.log_alone
                least = max(least, weight * float(np.exp(log_ratio)) * mine.of(self._number(i)))
        return least

    def _after(self, i: int, alone: float) -> Alike:
        alike = self._hypotheses[i].alike.and_one(map(self._number, self._fits_one_with(i)), self._freshness)
        if self.fitting[i] is None:
            return alike
        rivals = self._rivals(i)
        if not rivals:
            return alike.and_alone(alone, self._freshness)
        large = {rival: q for rival, q in rivals.items() if q > LEAST_LARGE}
        return alike.and_both(large, self._log_ratios[i], self._freshness)

    def _tempering(self, i: int) -> float:
        large = max(self._rivals(i).values(), default=0.0)
        tempered = self._hypotheses[i].alike.tempered(self._log_ratios[i], self._freshness * large)
        return float(np.exp(large * (tempered - self._log_ratios[i])))

    def _rivals(self, i: int) -> dict[int, float]:
        """Number of each hypothesis that another candidate fits than this one's, and how surely both are large.

        The two halves of one that may have slipped have one number, and are no rivals.
        """
        mine = self.fitting[i]
        if mine is None:
            return {}
        return {
            self._number(j): float(min(self._large[mine], self._large[other]))
            for j, other in enumerate(self.fitting)
            if other is not None and other != mine and self._number(j) != self._number(i)
        }

    def _fits_one_with(self, i: int) -> list[int]:
        """Hypotheses that the image fits, where it does not fit this one, or the other way round."""
        is_fitting = self.fitting[i] is not None
        return [j for j, other in enumerate(self.fitting) if (other is not None) != is_fitting]

    def _number(self, i: int) -> int:
        return self._hypotheses[i].number


def _fitting(row: Sequence[Agreement], share: FloatArray) -> int | None:
    """The candidate that a hypothesis is corrected by."""
    best = int(np.argmax([fit.density * part for fit, part in zip(row, share, strict=True)]))
    return best if row[best].squared < SAME_POSE else None
