"""Does the answer stay when the data are resampled?

Landmarks that are neighbours share their errors: one plane, one piece of furniture that was moved, one bend of the map.
So not points are drawn anew but blocks of space, with all that both clouds have there. Two questions are asked of every
such draw: which alignment explains it best, and where does the answer move by it?
Source: block bootstrap, Kuensch, Annals of Statistics 17(3), 1989.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, rotation_of, scale_of, so3_log, transform
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import refine
from station.places.registration.score import Score

# Voxels: 60 cm in a flat of 9 m, a piece of furniture, and 2 m: a map that bends moves whole corners of rooms.
BLOCK, WIDE_BLOCK = 3.0, 10.0
DRAWS = 1000
REFITS = 12
REFIT_SUBSET = 2000
REACHES = (0.6,) * 5  # voxels


@dataclass(frozen=True, slots=True, eq=False)
class Rivalry:
    """In how many draws the answer loses."""

    mass: float  # to any rival
    shares: FloatArray  # (r,) to each


def compare(
    problem: RegistrationProblem,
    T: FloatArray,
    answer: Score,
    rivals: list[Score],
    subsets: tuple[IntArray, IntArray],
) -> Rivalry:
    """How often a rival explains a draw as well as the answer T (4, 4) does; `subsets` as the scores are of."""
    if not rivals:
        return Rivalry(0.0, np.zeros(0))
    landed = transform(T, problem.source.points[subsets[1]])
    blocks = _blocks_of(np.concatenate([landed, problem.target.points[subsets[0]]]), BLOCK * problem.voxel)
    count = int(blocks.max()) + 1
    ahead = [np.bincount(blocks, weights=answer.evidence - rival.evidence, minlength=count) for rival in rivals]
    drawn = problem.rng.multinomial(count, np.full(count, 1 / count), size=DRAWS)
    lost = drawn @ np.array(ahead).T <= 0
    return Rivalry(float(lost.any(axis=1).mean()), np.asarray(lost.mean(axis=0), dtype=np.float64))


def _blocks_of(p: FloatArray, size: float) -> IntArray:
    """(n,) which block of space each point (n, 3) lies in, counted from 0."""
    index = np.floor((p - p.min(axis=0)) / size).astype(np.int64)
    return np.asarray(np.unique(index @ np.array([1, 1 << 20, 1 << 40]), return_inverse=True)[1], dtype=np.int64)


def spread_of(problem: RegistrationProblem, T: FloatArray) -> FloatArray | None:
    """Covariance (7, 7) of the alignment T (4, 4), as REFITS draws of blocks move it; None where too few points meet.

    Of rotation, translation of the shared points' middle and log scale, target frame. The blocks hold source points;
    the target's errors are in them, too, as those of the planes that the points of a block lie on.
    """
    rng, voxel = problem.rng, problem.voxel
    count = len(problem.source.points)
    subset = np.sort(rng.choice(count, size=min(REFIT_SUBSET, count), replace=False))
    landed = transform(T, problem.source.points[subset])
    meets = np.isfinite(problem.target.tree.query(landed, distance_upper_bound=REACHES[0] * voxel)[0])
    subset, landed = subset[meets], landed[meets]
    if not len(subset):
        return None
    blocks = _blocks_of(landed, WIDE_BLOCK * voxel)
    order = np.argsort(blocks, kind="stable")
    members = np.split(subset[order], np.flatnonzero(np.diff(blocks[order])) + 1)
    middle = np.median(problem.source.points[subset], axis=0)
    moves = []
    for _ in range(REFITS):
        drawn = np.concatenate([members[k] for k in rng.integers(len(members), size=len(members))])
        refined = refine(problem, T, subset=drawn, reaches=tuple(r * voxel for r in REACHES), tolerance=1e-4 * voxel)
        if np.isfinite(refined.rms):
            moves.append(_move(refined.T_target_source, T, middle))
    if len(moves) <= REFITS // 2:
        return None
    free = np.array([1.0] * 6 + [float(problem.free_scale)])
    return np.cov(np.array(moves), rowvar=False) * np.outer(free, free)


def _move(T: FloatArray, T_from: FloatArray, middle: FloatArray) -> FloatArray:
    """(7,) from one alignment to another: rotation, translation of the middle (3,), log scale."""
    turn = so3_log(rotation_of(T) @ rotation_of(T_from).T)
    return np.array([*turn, *transform(T - T_from, middle), np.log(scale_of(T) / scale_of(T_from))])
