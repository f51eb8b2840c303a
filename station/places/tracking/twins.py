"""One image beside hypotheses of which several explain it: what it says of parts of a map that look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.geometry import FloatArray
from station.places.tracking.alike import Alike
from station.places.tracking.belief import SAME_POSE, Agreement, Hypothesis

LEAST = 1e-12  # of what has a logarithm


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
        self._hypotheses, self._share, self._large, self._freshness = hypotheses, share, large, freshness
        self._fitting = [_fitting(row, share) for row in fits]  # (H,) number of the candidate
        said = [
            0.0 if j is None else float(np.log(max(row[j].density * share[j], LEAST)))
            for row, j in zip(fits, self._fitting, strict=True)
        ]
        known = [x for x, j in zip(said, self._fitting, strict=True) if j is not None]
        self._said = [x - float(np.mean(known)) if known else 0.0 for x in said]  # (H,)
        self.tempering = np.array([self._tempering(i) for i in range(len(hypotheses))])  # (H,) factor of its candidates

    def likelihood(self, i: int, likelihood: float, at: FloatArray, fails: Sequence[float]) -> float:
        """Of the image at a hypothesis; `likelihood`: were nothing alike.

        Args:
            at: (H,) densities of the candidates there.
            fails: (H,) that an image is not recognised there.
        """
        alike, unlike = self._hypotheses[i].alike, self._unlike(i)
        if self._fitting[i] is not None:
            return likelihood * min((1 - alike.of(self._number(j)) * (1 - fails[j]) for j in unlike), default=1.0)
        deceived = [(alike.of(self._number(j)), float(at[j])) for j in unlike]
        surely, density = max(deceived, key=lambda pair: pair[0] * pair[1], default=(0.0, 0.0))
        return (1 - surely) * likelihood + surely * fails[i] * density

    def after(self, expected_by: Sequence[int | None], fails: float) -> list[Alike]:
        """(H,) what hypotheses have in common after the image; `fails`: that an image is not recognised."""
        return [self._after(i, fails if None not in expected_by else 1.0) for i in range(len(self._hypotheses))]

    def started(self) -> list[Alike]:
        """(C,) of a new hypothesis at each candidate: how much likelier its image says that it is than the others."""
        said = np.log(np.maximum(self._share, LEAST))
        counts = self._freshness * self._large * (len(said) > 1)
        return [
            Alike(images=float(count), said=float(count * x))
            for x, count in zip(said - said.mean(), counts, strict=True)
        ]

    def new_weights(self, factors: Sequence[float], expected_by: Sequence[int | None]) -> FloatArray:
        """(C,) least weight of a new hypothesis at a candidate: what one there had by now beside those that fit."""
        weights = np.zeros(len(self._share))
        for j in (j for j, by in enumerate(expected_by) if by is None):
            for h, factor, fitting in zip(self._hypotheses, factors, self._fitting, strict=True):
                if fitting is not None and fitting != j:
                    ratio = float(self._share[j] / self._share[fitting]) ** self._freshness
                    weight = h.weight * factor * ratio * h.alike.alone * self._both_large(j, fitting)
                    weights[j] = max(weights[j], weight)
        return weights

    def least_weights(self, factors: Sequence[float], alike: Sequence[Alike]) -> list[float]:
        """(H,) least weight of each hypothesis: what told it from its rivals before it was known how alike they are.

        That was one image that was recognised at one of them only, or first pictures of little: it does not count more
        than images since. `alike`: after the image.
        """
        least = [0.0] * len(self._hypotheses)
        for j in range(len(self._hypotheses)):
            for i, rival in enumerate(self._hypotheses):
                if rival.number in self._rivals(j):
                    ratio = min(1.0, float(np.exp(alike[j].mean - alike[i].mean)))
                    weight = rival.weight * factors[i] * ratio * alike[i].alone * alike[j].of(rival.number)
                    least[j] = max(least[j], weight)
        return least

    def _after(self, i: int, fails: float) -> Alike:
        alike = self._hypotheses[i].alike.and_either(map(self._number, self._unlike(i)), self._freshness)
        if self._fitting[i] is None:
            return alike
        rivals = self._rivals(i)
        if rivals:
            return alike.and_both(rivals, self._said[i], self._freshness)
        return alike.and_alone(fails, self._freshness)

    def _tempering(self, i: int) -> float:
        rivals = self._rivals(i)
        if not rivals:
            return 1.0
        large = max(rivals.values())
        tempered = self._hypotheses[i].alike.tempered(self._said[i], self._freshness * large)
        return float(np.exp(large * (tempered - self._said[i])))

    def _rivals(self, i: int) -> dict[int, float]:
        """Number of each hypothesis that another candidate fits than this one's, and how surely both are large."""
        mine = self._fitting[i]
        if mine is None:
            return {}
        return {
            self._number(j): self._both_large(mine, other)
            for j, other in enumerate(self._fitting)
            if other is not None and other != mine
        }

    def _unlike(self, i: int) -> list[int]:
        """Hypotheses that the image fits, where it does not fit this one, or the other way round."""
        is_fitting = self._fitting[i] is not None
        return [j for j, other in enumerate(self._fitting) if (other is not None) != is_fitting]

    def _both_large(self, a: int, b: int) -> float:
        return float(min(self._large[a], self._large[b]))

    def _number(self, i: int) -> int:
        return self._hypotheses[i].number


def _fitting(row: Sequence[Agreement], share: FloatArray) -> int | None:
    """The candidate that a hypothesis is corrected by."""
    best = int(np.argmax([fit.density * part for fit, part in zip(row, share, strict=True)]))
    return best if row[best].squared < SAME_POSE else None
