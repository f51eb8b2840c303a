"""How much in a map looks alike, by the map's own pictures that were looked for in it (`tried_pictures.py`).

The odds of a verified pose were fitted to some kinds of homes. In a home with more equal doors and radiators than those
had, or fewer, all odds are off by the same factor, and the home itself tells by which: it is the one that explains best
which poses of its own pictures are right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.optimize import minimize_scalar

from shared.geometry import FloatArray
from station.places.localisation.tried_pictures import TriedPicture
from station.places.tracking.config import BeliefConfig
from station.places.tracking.fitted import RecognisedOdds, Usual
from station.places.tracking.image_evidence import ImageEvidence, MatchFigures, log_odds
from station.places.tracking.map_view import MapView

RIGHT_M = 0.5  # from the true position: a map that SLAM bent is no look-alike
# What a map may have of its own, log odds, one sigma. Homes of patterns and of white walls lie two of these apart. Were
# it three, a tiny map whose few pictures are found elsewhere once their neighbours are left out would know nothing.
WIDE, MOST = 1.0, 10.0


@dataclass(frozen=True, slots=True)
class Judged:
    """The verified poses of one picture."""

    figures: tuple[MatchFigures, ...]
    right: int | None  # number of the right one; None: there is none


def judged(view: MapView, tried: Sequence[TriedPicture]) -> list[Judged]:
    """The poses of a map's own pictures, judged as those of the robot that mapped it."""
    navigation = view.place_map.navigation
    told = navigation.report.told_camera or navigation.calibration.camera  # by which a map knows its own robot
    calibration = msgspec.structs.replace(navigation.calibration, camera=told)
    evidence = ImageEvidence([view], calibration, BeliefConfig())
    out = []
    for picture in tried:
        found = [replace(z, map_id=view.place_map.id) for z in picture.candidates]
        off = [float(np.linalg.norm(z.T_map_cam[:3, 3] - picture.T_map_cam[:3, 3])) / view.unit for z in found]
        nearest = int(np.argmin(off))
        figures = tuple(evidence.figures(evidence.measured(z)) for z in found)
        out.append(Judged(figures, nearest if off[nearest] < RIGHT_M else None))
    return out


def own_log_odds(pictures: Sequence[Judged], right: RecognisedOdds, usual: Usual, tried: float) -> float:
    """What a map adds to the fitted log odds of poses: never more than 0.

    That much looks alike its pictures show. That little does they do not: they look from where the map was made, and a
    robot that is put down somewhere looks from other sides, at less of what it knows.

    `right`, `usual`, `tried`: as in `FittedOdds`.
    """
    return min(0.0, fitted_to_own(pictures, right, usual, tried))


def fitted_to_own(pictures: Sequence[Judged], right: RecognisedOdds, usual: Usual, tried: float) -> float:
    """What, added to the fitted log odds of poses, explains a map's pictures best; 0 without any."""
    rows = [np.array([log_odds(right, f.or_usual(usual)) for f in one.figures]) for one in pictures]

    def misfit(own: float) -> float:
        more = tried + own
        of_pictures = [_misfit(row + more, one.right) for row, one in zip(rows, pictures, strict=True)]
        return float(np.sum(of_pictures)) + 0.5 * (own / WIDE) ** 2

    return float(minimize_scalar(misfit, bounds=(-MOST, MOST), method="bounded").x) if rows else 0.0


def _misfit(log: FloatArray, right: int | None) -> float:
    """Negative log likelihood that this pose is right, or none."""
    return float(np.logaddexp.reduce([*log, 0.0])) - (0.0 if right is None else float(log[right]))
