"""Two parts of a map that look alike, such as twin rooms: what images say of hypotheses that both explain them.

An image that shows the same thing twice in the map does not tell by the number of landmarks which of them it is: one
was mapped from nearer, or by more views, and so it is in every image of it. So such images say on average which is
likelier, however many there are. And an image that is recognised at one of two such hypotheses only says no more than
that it was not recognised at the other one: what looks alike deceives as surely as the right one is found.

Both holds as far as what looks alike is larger than furniture that comes twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

UNLIKE_BEFORE = 0.3  # images' worth: before any, nothing is taken to look alike


@dataclass(frozen=True, slots=True)
class Alike:
    """What one hypothesis and its rivals have in common. Images count by how new they are, 0 to 1."""

    fit_both: Mapping[int, float] = field(default_factory=dict)  # number of a rival -> images that fitted both
    fit_one: Mapping[int, float] = field(default_factory=dict)  # ... and that fitted one of the two
    images: float = 0.0  # that fitted a rival, too
    log_ratios: float = 0.0  # their sum: log likelihood here, less the mean over all that the image fitted
    log_alone: float = 0.0  # log probability, at an equal place elsewhere, of the images that fitted only here
    log_failed: float = 0.0  # sum over the images that were not recognised: log likelihood here, less elsewhere

    def of(self, rival: int) -> float:
        """0..1: how surely what deceives at the rival deceives again; 0 without an image that fitted both."""
        both = self.fit_both.get(rival, 0.0)
        return both / (both + self.fit_one.get(rival, 0.0) + UNLIKE_BEFORE)

    @property
    def mean(self) -> float:
        """Log ratio of the images that fitted rivals, too; images of less than one count as one."""
        return self.log_ratios / max(self.images, 1.0)

    def tempered(self, log_ratio: float, count: float) -> float:
        """The log ratio of one more image, counted `count` times: as much as it moves the mean of all such images."""
        if count <= 0:
            return log_ratio
        mean = (self.log_ratios + count * log_ratio) / max(self.images + count, 1.0)
        return (mean - self.mean) / count

    def and_both(self, rivals: Mapping[int, float], log_ratio: float, freshness: float) -> Alike:
        """After an image that fitted this one and rivals; of each 0..1: how surely that is larger than furniture."""
        count = freshness * max(rivals.values(), default=0.0)
        return replace(
            self,
            fit_both=_added(self.fit_both, {rival: freshness * q for rival, q in rivals.items()}),
            fit_one=_added(self.fit_one, {rival: freshness * (1 - q) for rival, q in rivals.items()}),
            images=self.images + count,
            log_ratios=self.log_ratios + count * log_ratio,
        )

    def and_one(self, rivals: Iterable[int], freshness: float) -> Alike:
        """After an image that fitted either this one or these rivals."""
        counts = {rival: freshness for rival in rivals if rival in self.fit_both}
        return replace(self, fit_one=_added(self.fit_one, counts))

    def and_alone(self, fails: float, freshness: float) -> Alike:
        """After an image that fitted no other; `fails`: probability that an image is not recognised."""
        return replace(self, log_alone=self.log_alone + freshness * float(np.log(fails)))

    def and_failed(self, likelihood_ratio: float, freshness: float) -> Alike:
        """After an image that was not recognised; how much likelier that is here than elsewhere in the map."""
        return replace(self, log_failed=self.log_failed + freshness * float(np.log(likelihood_ratio)))

    def among(self, living: Iterable[int]) -> Alike:
        """Without the rivals that are no more."""
        kept = set(self.fit_both).intersection(living)
        return replace(
            self, fit_both={k: self.fit_both[k] for k in kept}, fit_one={k: self.fit_one.get(k, 0.0) for k in kept}
        )


def _added(counts: Mapping[int, float], more: Mapping[int, float]) -> dict[int, float]:
    return {**counts, **{rival: counts.get(rival, 0.0) + count for rival, count in more.items()}}


UNRIVALLED = Alike()
