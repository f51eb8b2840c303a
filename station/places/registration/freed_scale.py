"""What scale would the clouds choose, were it not given?

An inlier ratio cannot see a wrong scale: a source 2 % too large lies on the target with nearly as many points. But
left free, the scale of that alignment goes back by those 2 %, while that of a right one stays where it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, IntArray, scale_of
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import refine

# Search radii in voxels. Wide at first, as at 5 % the far ends of a flat lie two voxels off; still wider ones may lead
# right answers with little overlap astray.
REACHES = (1.5, 1.5, 1.0, 1.0, *(0.75,) * 6, *(0.6,) * 3)
SETTLED = 9  # of them, from the end: for parts of the points, from where all of them ended
PARTS = 4  # drawn at random


def free_the_scale(
    problem: RegistrationProblem, T: FloatArray, *, subset: IntArray, reaches: tuple[float, ...] = REACHES
) -> FloatArray | None:
    """T (4, 4) refined with a free scale, by source[subset (m,)]; None where too few points meet.

    `reaches`: search radii, voxels.
    """
    voxel = problem.voxel
    refined = refine(
        replace(problem, free_scale=True),
        T,
        subset=subset,
        reaches=tuple(r * voxel for r in reaches),
        tolerance=1e-4 * voxel,
    )
    return refined.T_target_source if np.isfinite(refined.rms) else None


def noise_of_scale(problem: RegistrationProblem, T: FloatArray, *, subset: IntArray) -> float | None:
    """One standard deviation of the log scale of T (4, 4), as free_the_scale left it: how much parts of it differ.

    None where a part of source[subset (m,)] has no answer.
    """
    mixed = problem.rng.permutation(subset)
    found = [
        free_the_scale(problem, T, subset=np.sort(mixed[k::PARTS]), reaches=REACHES[-SETTLED:]) for k in range(PARTS)
    ]
    scales = [scale_of(X) for X in found if X is not None]
    return float(np.std(np.log(scales), ddof=1) / np.sqrt(PARTS)) if len(scales) == PARTS else None
