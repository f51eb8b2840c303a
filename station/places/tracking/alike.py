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

UNLIKE_BEFORE = 0.3  # images' worth: before any, nothing is taken to look alike


@dataclass(frozen=True, slots=True)
class Alike:
    """What one hypothesis and its rivals have in common. Images count by how new they are, 0 to 1."""

    both: Mapping[int, float] = field(default_factory=dict)  # number of a rival -> images that fitted both
    either: Mapping[int, float] = field(default_factory=dict)  # ... and that fitted one of the two
    images: float = 0.0  # that fitted a rival, too
    said: float = 0.0  # sum over these: log of what the image said here, less the mean of all that it fitted
    alone: float = 1.0  # probability, were the robot at an equal place elsewhere, of the images that fitted only here

    def of(self, rival: int) -> float:
        """0..1: how surely what deceives at the rival deceives again; 0 without an image that fitted both."""
        both = self.both.get(rival, 0.0)
        return both / (both + self.either.get(rival, 0.0) + UNLIKE_BEFORE)

    @property
    def mean(self) -> float:
        """Of what such images said; images of less than one count as one."""
        return self.said / max(self.images, 1.0)

    def tempered(self, said: float, count: float) -> float:
        """What an image that fits rivals, too, says: as much as it moves the mean of all such images."""
        return (said - self.mean) / max(self.images + count, 1.0)

    def and_both(self, rivals: Mapping[int, float], said: float, freshness: float) -> Alike:
        """After an image that fitted this one and rivals; of each 0..1: how surely that is larger than furniture."""
        both = {**self.both, **{rival: self.both.get(rival, 0.0) + freshness * q for rival, q in rivals.items()}}
        count = freshness * max(rivals.values(), default=0.0)
        return replace(self, both=both, images=self.images + count, said=self.said + count * said)._but_unlike(
            {rival: freshness * (1 - q) for rival, q in rivals.items()}
        )

    def and_either(self, rivals: Iterable[int], freshness: float) -> Alike:
        """After an image that fitted either this one or these rivals."""
        return self._but_unlike(dict.fromkeys((rival for rival in rivals if rival in self.both), freshness))

    def and_alone(self, fails: float, freshness: float) -> Alike:
        """After an image that fitted no other; `fails`: probability that an image is not recognised."""
        return replace(self, alone=self.alone * fails**freshness)

    def _but_unlike(self, counts: Mapping[int, float]) -> Alike:
        either = {rival: self.either.get(rival, 0.0) + count for rival, count in counts.items()}
        return replace(self, either={**self.either, **either})


UNRIVALLED = Alike()
