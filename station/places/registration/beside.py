"""Other alignments a few decimetres, degrees or percent beside the one found: is one of them as good, or better?

Furniture that meets its neighbour, a bookcase one shelf on: refinement ends in such an optimum, and no check of the
alignment alone sees it, as most of the two clouds do lie on each other. So the surroundings are searched on purpose.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, se3, transform, yaw_rotation
from station.places.registration.cloud import PreparedCloud
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import Refined, refine

ANGLES = 2 * np.pi * np.arange(8) / 8
# Voxels: none, and in eight directions 12 to 40 cm in a flat of 9 m.
AROUND = np.array([np.zeros(3), *(r * np.array([np.cos(a), np.sin(a), 0.0]) for r in (0.6, 1.2, 2.0) for a in ANGLES)])
TURNS_DEG = (-5.0, -2.5, 0.0, 2.5, 5.0)
SCALES = (0.965, 1.0, 1.035)  # where the scale is free
STARTS = 6  # the best of them are refined
FIRST_PART = 6  # of the points: the first look at them is by that share
START_GAP = 0.5  # voxels between two of them
HALVES = (-1.0, -0.5, 0.0, 0.5, 1.0)
NUDGES = np.array([(dx, dy, 0.0) for dx in HALVES for dy in HALVES])  # voxels
NUDGE_TURNS_DEG = (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0)
REACHES = (1.0, 1.0, 0.75, 0.75, 0.75, 0.75, 0.5, 0.5)  # voxels


def alignments_beside(problem: RegistrationProblem, T: FloatArray, *, subset: IntArray, few: IntArray) -> list[Refined]:
    """Local optima (at most STARTS) reached from around T (4, 4): shifted, and turned about the vertical.

    Args:
        subset: (m,) source points for the refinement.
        few: (k,) source points to choose the starts by; a few hundred suffice.
    """
    voxel, points = problem.voxel, problem.source.points[few]
    starts = _moved(problem, T, points, AROUND, TURNS_DEG, SCALES if problem.free_scale else (1.0,))
    chosen: list[FloatArray] = []
    for k in best_fits(problem.target, points, starts, voxel, keep=(len(starts) // 3, len(starts) // 3)):
        X = starts[k]
        if all(problem.landed_apart(X, other) > START_GAP * voxel for other in [T, *chosen]):
            chosen.append(X)
            if len(chosen) == STARTS:
                break
    reaches = tuple(r * voxel for r in REACHES)
    found = [refine(problem, X, subset=subset, reaches=reaches, tolerance=1e-3 * voxel) for X in chosen]
    return [refined for refined in found if np.isfinite(refined.rms)]


def nudge(problem: RegistrationProblem, T: FloatArray, subset: IntArray) -> FloatArray:
    """The best of 175 alignments (4, 4) around T, shifted and turned about the vertical.

    It brings the source's points nearest to the target's surfaces. The coarse grid's peak is off by up to a voxel and a
    yaw step; from there, point-to-plane refinement may slide along walls into a wrong local optimum, and from the best
    of these nudges it seldom does. `subset`: (m,) points to look at; a few hundred suffice.
    """
    p = problem.source.points[subset]
    candidates = _moved(problem, T, p, NUDGES, NUDGE_TURNS_DEG)
    return candidates[int(best_fits(problem.target, p, candidates, problem.voxel, keep=(60, 20, 1))[0])]


def _moved(
    problem: RegistrationProblem,
    T: FloatArray,
    points: FloatArray,
    shifts: FloatArray,
    turns_deg: tuple[float, ...],
    scales: tuple[float, ...] = (1.0,),
) -> list[FloatArray]:
    """T (4, 4) moved about the middle of the points (k, 3): every shift (voxels) with every turn and scale."""
    centre = np.median(points, axis=0)
    landed = transform(T, centre)
    R_up = problem.R_up
    steps = [R_up.T @ (problem.voxel * shift) for shift in shifts]
    out = []
    for scale in scales:
        for turn in turns_deg:
            R = scale * R_up.T @ yaw_rotation(np.radians(turn)) @ R_up @ T[:3, :3]
            out += [se3(R, landed + step - R @ centre) for step in steps]
    return out


def best_fits(
    target: PreparedCloud, points: FloatArray, alignments: list[FloatArray], voxel: float, keep: tuple[int, ...]
) -> IntArray:
    """The order (n,) of alignments (4, 4) by how near the points (k, 3) come to the target's surfaces, best first.

    In as many looks as `keep` has numbers, each by more of the points; only the best `keep` of one are looked at in the
    next, the others follow them as they are: a sixth of the points tells the better third from the rest.
    """
    mixed = np.argsort(np.arange(len(points)) % FIRST_PART, kind="stable")  # any piece of it is of the whole cloud
    left, total, seen = np.arange(len(alignments)), np.zeros(len(alignments)), 0
    aside: list[IntArray] = []
    for look, count in enumerate(keep):
        last = look == len(keep) - 1
        until = len(points) if last else -(-len(points) * 2**look // FIRST_PART)
        part = points[mixed[seen:until]]
        total[left] += len(part) * surface_fit(target, part, [alignments[k] for k in left], voxel)
        order, seen = left[np.argsort(-total[left], kind="stable")], until
        left = order[:count]
        aside.insert(0, order[count:])
    return np.concatenate([left, *aside])


def surface_fit(target: PreparedCloud, points: FloatArray, alignments: list[FloatArray], voxel: float) -> FloatArray:
    """(n,) how near the points (k, 3) come to the target's surfaces under each alignment (4, 4), 0..1.

    As wide as a third of a voxel: the alignments are steps on a grid, not optima.
    """
    X = np.stack(alignments)
    # One point under all alignments, then the next: neighbours in the list are neighbours in the tree.
    moved = (np.einsum("aij,kj->kai", X[:, :3, :3], points) + X[:, :3, 3]).reshape(-1, 3)
    distance, index = target.tree.query(moved, distance_upper_bound=1.5 * voxel, workers=2)
    near = np.flatnonzero(np.isfinite(distance))
    index, distance = index[near], distance[near]
    along = np.einsum("ni,ni->n", moved[near] - target.points[index], target.normals[index])
    fit = np.zeros(len(moved))
    fit[near] = np.exp(-0.5 * (along / (0.3 * voxel)) ** 2 - 0.5 * (distance / (0.8 * voxel)) ** 2)
    return np.asarray(fit.reshape(len(points), -1).mean(axis=0), dtype=np.float64)
