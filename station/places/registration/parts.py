"""Do parts of the landmarks, each by itself, say the same?

Where two clouds show one place, every part of them fits at one spot. An alignment that rests on chance, or on
furniture that meets its neighbour, is a compromise: each part alone would move it elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, scale_of, transform
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import measure_residuals, refine

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
    problem: RegistrationProblem, T: FloatArray, *, subset: IntArray, reach: float, unit: float
) -> PartsApart:
    """Refine T (4, 4) by parts of the source alone; sides are cut upright.

    Args:
        subset: (m,) source points to part.
        reach: search radius, target units.
        unit: what distances are given in, target units.
    """
    target, source = problem.target, problem.source

    def apart(first: IntArray, second: IntArray) -> tuple[float, float]:
        if min(len(first), len(second)) < MIN_POINTS:
            return UNKNOWN, 0.0
        one, other = (
            refine(
                problem, T, subset=np.sort(part), reaches=(0.8 * reach,) * PASSES, tolerance=1e-4 * reach
            ).T_target_source
            for part in (first, second)
        )
        return problem.landed_apart(one, other) / unit, abs(float(np.log(scale_of(one) / scale_of(other))))

    mixed = problem.rng.permutation(subset)
    found = measure_residuals(target, source.points[subset], source.normals[subset], T, reach)
    shared = np.isfinite(found.distance)
    on_floor = (transform(T, source.points[subset]) @ problem.R_up.T)[:, :2]
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
