"""What scale would the clouds choose, were it not given?

An inlier ratio cannot see a wrong scale: a source 2 % too large lies on the target with nearly as many points. But
left free, the scale of that alignment goes back by those 2 %, while that of a right one stays where it is.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, scale_of
from station.places.registration.cloud import PreparedCloud
from station.places.registration.refine import refine

# Search radii in voxels. Wide at first, as at 5 % the far ends of a flat lie two voxels off; still wider ones (2.5)
# came nearer to the truth where a scale was wrong, but led two of 53 right answers with little overlap 1.1 % astray.
REACHES = (1.5, 1.5, 1.0, 1.0, *(0.75,) * 6, *(0.6,) * 3)
SETTLED = 9  # of them, from the end: for parts of the points, from where all of them ended
PARTS = 4  # drawn at random


def free_the_scale(
    target: PreparedCloud,
    source: PreparedCloud,
    T: FloatArray,
    *,
    subset: IntArray,
    voxel: float,
    upright: bool,
    reaches: tuple[float, ...] = REACHES,
) -> FloatArray | None:
    """T (4, 4) refined with a free scale, by source[subset (m,)]; None where too few points meet.

    Args:
        voxel: of the global search, target units.
        upright: hold the tilt near zero.
        reaches: search radii, voxels.
    """
    refined = refine(
        target,
        source,
        T,
        subset=subset,
        reaches=tuple(r * voxel for r in reaches),
        upright=upright,
        free_scale=True,
        tolerance=1e-4 * voxel,
    )
    return refined.T_target_source if np.isfinite(refined.rms) else None


def noise_of_scale(
    target: PreparedCloud,
    source: PreparedCloud,
    T: FloatArray,
    *,
    subset: IntArray,
    voxel: float,
    upright: bool,
    rng: np.random.Generator,
) -> float | None:
    """One standard deviation of the log scale of T (4, 4), as free_the_scale left it: how much parts of it differ.

    None where a part of source[subset (m,)] has no answer.
    """
    mixed = rng.permutation(subset)
    found = [
        free_the_scale(
            target,
            source,
            T,
            subset=np.sort(mixed[k::PARTS]),
            voxel=voxel,
            upright=upright,
            reaches=REACHES[-SETTLED:],
        )
        for k in range(PARTS)
    ]
    scales = [scale_of(X) for X in found if X is not None]
    return float(np.std(np.log(scales), ddof=1) / np.sqrt(PARTS)) if len(scales) == PARTS else None
