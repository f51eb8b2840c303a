"""How far a keyframe or depth scan saw in each direction over the ground: up to what it observes there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.model.navigation import Navigation
from station.places.space.observed import Observed

SECTORS = 120  # of 3 degrees
GAP = 4  # sectors without landmarks that are bridged: a plain wall shows few
SHORT_OF = 0.95  # a sight ends this share of the way to its landmark: depths err


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What was seen from one position."""

    eye: FloatArray  # (2,)
    reach: FloatArray  # (SECTORS,) how far; 0 where nothing was seen
    farthest: float  # of all sights

    @classmethod
    def of(cls, eye_map: FloatArray, p_map: FloatArray, R_ground_map: FloatArray, farthest: float) -> Sight | None:
        """From an eye (3,) to points (n, 3) that it saw; None of none. A point beyond `farthest` counts as that far."""
        d = ((p_map - eye_map) @ R_ground_map.T)[:, :2]
        d = d[np.isfinite(d).all(axis=1)]
        if not len(d):
            return None
        reach = SHORT_OF * np.minimum(_bridged(_second_farthest(d)), farthest)
        return cls((R_ground_map @ eye_map)[:2], reach, farthest)

    def sees_through(self, p: FloatArray) -> npt.NDArray[np.bool_]:
        """(n,) whether points (n, 2) lie in front of what was seen in their direction."""
        d = p - self.eye
        return np.asarray(np.hypot(d[:, 0], d[:, 1]) < self.reach[_sectors(d)], dtype=np.bool_)


def sights(navigation: Navigation, R_ground_map: FloatArray, farthest: float) -> Iterator[Sight]:
    """One for each keyframe or depth scan that observed something; `farthest`: a point beyond counts as this far."""
    seen = Observed.of(navigation)
    for eye, rows in zip(seen.eye_map, seen.by_eye(), strict=True):
        sight = Sight.of(eye, seen.p_map[seen.point[rows]], R_ground_map, farthest)
        if sight is not None:
            yield sight


def _second_farthest(d: FloatArray) -> FloatArray:
    """(SECTORS,) of the landmarks (n, 2) in each sector; of several the farthest may be false. 0: there is none."""
    sector, far = _sectors(d), np.hypot(d[:, 0], d[:, 1])
    order = np.lexsort((-far, sector))
    sector, far = sector[order], far[order]
    own, begin, count = np.unique(sector, return_index=True, return_counts=True)
    out = np.zeros(SECTORS)
    out[own] = far[begin + np.minimum(count - 1, 1)]
    return out


def _bridged(reach: FloatArray) -> FloatArray:
    """(SECTORS,) with narrow gaps closed: as far as the nearer of the two neighbours."""
    found = np.flatnonzero(reach)
    out = reach.copy()
    for left, right in zip(found, np.roll(found, -1), strict=True):
        gap = (right - left - 1) % SECTORS
        if 0 < gap <= GAP:
            out[(left + 1 + np.arange(gap)) % SECTORS] = min(reach[left], reach[right])
    return out


def _sectors(d: FloatArray) -> IntArray:
    """(n,) the sector of each direction (n, 2)."""
    turn = np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) % 1.0
    return np.floor(turn * SECTORS).astype(np.int64) % SECTORS
