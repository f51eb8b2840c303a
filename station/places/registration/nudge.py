"""Between the coarse grid and the refinement: the best of many small shifts and turns around a candidate.

The grid's peak is off by up to a voxel and a yaw step. Point-to-plane refinement from there slid along walls into a
wrong local optimum in 4 of 26 training pairs, from the best of these nudges in 1.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, se3, transform, yaw_rotation
from station.places.registration.beside import best_fits
from station.places.registration.cloud import PreparedCloud

SHIFTS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # voxels
TURNS_DEG = (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0)


def nudge(
    target: PreparedCloud,
    source: PreparedCloud,
    T: FloatArray,
    R_up: FloatArray,
    subset: IntArray,
    voxel: float,
) -> FloatArray:
    """The best of 175 alignments (4, 4) around T: source points nearest to the target's surfaces.

    Args:
        R_up: (3, 3) rotation that puts the target's vertical along z; shifts and turns happen in that frame.
        subset: (m,) source points to look at; a few hundred suffice.
    """
    p = source.points[subset]
    centre = np.median(p, axis=0)
    landed = transform(T, centre)
    candidates = []
    for turn in TURNS_DEG:
        R = R_up.T @ yaw_rotation(np.radians(turn)) @ R_up @ T[:3, :3]
        for dx in SHIFTS:
            for dy in SHIFTS:
                shift = R_up.T @ np.array([dx * voxel, dy * voxel, 0.0])
                candidates.append(se3(R, landed + shift - R @ centre))
    return candidates[int(best_fits(target, p, candidates, voxel, keep=(60, 20, 1))[0])]
