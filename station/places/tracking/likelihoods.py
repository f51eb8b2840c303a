"""How probable an image is where the robot may be: measured rates, as logistic regressions.

An image is recognised at one pose or several (`Localization`), or not at all. What tells the right pose from a
look-alike, a mapped room from an unmapped one, and how often nothing is recognised although the map knows the view, was
counted on recorded drives: `python -m benchmarks.fit_place_likelihoods` makes the numbers here, from the drives named
below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# What the coefficients are counted from, not what is most frequent: the median image there has 670 features.
USUAL_FEATURES = 400
USUAL_EXTENT_M = 0.1
USUAL_INLIERS = 50
USUAL_SUPPORT = 0.2
LEAST_EXTENT_M = 0.01  # a smaller one has no logarithm to speak of
# Added, in what a usual keyframe saw, so that a view of nothing has a logarithm.
NONE_IN_VIEW = 0.05
NONE_RECOGNISED, FEW_EXPECTED = 0.015, 0.1


def support(recognised: float, expected: float) -> float:
    """The share of what should be in view that was recognised, small counts drawn to what is not surprising.

    Both in the number of landmarks that a usual keyframe of the map saw (`Coverage.in_view`).
    """
    return (recognised + NONE_RECOGNISED) / (expected + FEW_EXPECTED)


@dataclass(frozen=True, slots=True)
class Shown:
    """What tells of an image how far its verified pose may be believed."""

    extent_m: float  # median distance of the recognised landmarks from their middle
    inliers: int
    support: float
    features: int  # of the whole image


@dataclass(frozen=True, slots=True)
class Recognising:
    """Log odds by what an image shows, linear in the logarithms of its figures against their usual values."""

    usual: float
    extent: float
    inliers: float
    support: float
    features: float

    def log_odds(self, shown: Shown) -> float:
        """Of the image."""
        log = self.usual + self.extent * np.log(max(shown.extent_m, LEAST_EXTENT_M) / USUAL_EXTENT_M)
        log += self.inliers * np.log(max(shown.inliers, 1) / USUAL_INLIERS)
        log += self.support * np.log(shown.support / USUAL_SUPPORT)
        return float(log + self.features * np.log(max(shown.features, 1) / USUAL_FEATURES))


@dataclass(frozen=True, slots=True)
class Failing:
    """Log odds that an image is not recognised, linear in the logarithms of what it depends on."""

    usual: float  # after an image that was recognised
    features: float
    again: float  # the image before was not recognised
    in_view: float = 0.0

    def probability(self, num_features: int, failed_before: float, in_view: float = 1.0) -> float:
        """`failed_before`: whether the last image failed, 0 to 1; `in_view`: as `Coverage.in_view` counts."""
        log = self.usual + self.features * np.log(max(num_features, 1) / USUAL_FEATURES)
        log += self.again * failed_before + self.in_view * np.log(in_view + NONE_IN_VIEW)
        return float(1.0 / (1.0 + np.exp(-log)))


# Of 62 drives (world `small`, full of look-alikes, a room each unmapped): 1 and 3 through flats 101 to 120, 200, 203
# and 204 (2 and 3 through 105, 107, 114, 116, 118 and 120), 11 through 105, 1 to 5 through 310 to 312. In them 2101
# recognised images in mapped rooms and 436 in unmapped ones, 2258 and 1158 by which to count failures.
# Log loss, each flat left out in turn: 0.286 of which pose is right (by extent alone 0.382, by extent and inliers
# 0.375), 0.387 of whether the room is mapped, 0.347, 0.401 and 0.423 of failing.
RIGHT = Recognising(-0.51, extent=2.86, inliers=0.49, support=1.78, features=-1.54)
UNMAPPED = Recognising(-1.71, extent=0.51, inliers=-1.43, support=0.17, features=2.03)
FAILS_AT_POSE = Failing(-2.83, features=-0.84, again=1.68, in_view=-0.81)
FAILS_IN_MAP = Failing(-1.67, features=-1.15, again=2.17)
FAILS_UNMAPPED = Failing(-0.01, features=-1.62, again=2.48)
