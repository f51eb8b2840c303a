"""Do parts of the landmarks, each by itself, say the same?

Where two clouds show one place, every part of them fits at one spot. An alignment that rests on chance, or on
furniture that meets its neighbour, is a compromise: each part alone would move it elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, scale_of, transform
from station.places.registration.cloud import PreparedCloud
from station.places.registration.refine import measure_residuals, refine
from station.places.registration.score import landed_apart

PASSES = 6
MIN_POINTS = 30  # fewer landmarks determine no motion
UNKNOWN = 0.5  # units; speaks neither for an alignment nor against it


@dataclass(frozen=True, slots=True)
class PartsApart:
    """How far apart the answers of two parts of the source lie: median distance of its landmarks, in units.

    UNKNOWN where a part is too small for an answer.
    """

    halves: float  # two halves drawn at random: the noise of the answer
    sides: float  # two sides of what the clouds share, the worse of two cuts: its bias
    scales: float  # how far their scales differ, the largest of all cuts, relative; 0 where the scale is known
    unit: float  # target units


def parts_apart(
    target: PreparedCloud,
    source: PreparedCloud,
    T: FloatArray,
    *,
    R_up: FloatArray,
    subset: IntArray,
    reach: float,
    unit: float,
    upright: bool,
    free_scale: bool,
    rng: np.random.Generator,
) -> PartsApart:
    """Refine T (4, 4) by parts of the source alone.

    Args:
        R_up: (3, 3) rotation that puts the target's vertical along z; the cuts are upright.
        subset: (m,) source points to part.
        reach: search radius, target units.
        unit: what distances are told in, target units.
    """

    def apart(first: IntArray, second: IntArray) -> tuple[float, float]:
        if min(len(first), len(second)) < MIN_POINTS:
            return UNKNOWN, 0.0
        one, other = (
            refine(
                target,
                source,
                T,
                subset=np.sort(part),
                reaches=(0.8 * reach,) * PASSES,
                upright=upright,
                free_scale=free_scale,
                tolerance=1e-4 * reach,
            ).T_target_source
            for part in (first, second)
        )
        return landed_apart(one, other, source) / unit, abs(float(np.log(scale_of(one) / scale_of(other))))

    mixed = rng.permutation(subset)
    found = measure_residuals(target, source.points[subset], source.normals[subset], T, reach)
    shared = np.isfinite(found.distance)
    on_floor = (transform(T, source.points[subset]) @ R_up.T)[:, :2]
    halves = apart(mixed[::2], mixed[1::2])
    if np.count_nonzero(shared) < 2 * MIN_POINTS:
        return PartsApart(halves[0], UNKNOWN, halves[1], unit)
    centred = on_floor - np.median(on_floor[shared], axis=0)
    axes = np.linalg.svd(centred[shared], full_matrices=False)[2]
    cuts = [centred @ axis > 0 for axis in axes]
    sides = [apart(subset[side], subset[~side]) for side in cuts]
    return PartsApart(
        halves=halves[0],
        sides=max(gap for gap, _ in sides),
        scales=max(scale for _, scale in [halves, *sides]),
        unit=unit,
    )
