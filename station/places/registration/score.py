"""How well an alignment explains both clouds, and what each of their points says of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse_sim3, scale_of
from station.places.registration.cloud import PreparedCloud
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import measure_residuals

AGREEMENT = 0.7  # |cosine| of normals that may belong to one surface
CHANCE = 0.25  # what a point near the other cloud gets where the clouds have nothing in common


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """One alignment, judged by subsets of both clouds."""

    # (m + k,) of m source and k target points; the sum is what alignments are ranked by: the mean of both directions.
    # A point on the other cloud's surface speaks for the alignment, one on a landmark of it even more, and one near
    # the other cloud and beside its surfaces against it. One that the other cloud never saw says nothing.
    evidence: FloatArray
    inlier_ratio: float  # points on the other cloud's surface, of the points with a neighbour in the other cloud
    overlap: float  # points with a neighbour in the other cloud, the smaller of both directions
    rmse: float  # of inliers, along normals

    @property
    def total(self) -> float:
        return float(self.evidence.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _OneWay:
    evidence: FloatArray  # (n,)
    inlier_share: float
    near_share: float
    rmse: float


def score_alignment(problem: RegistrationProblem, T: FloatArray, subsets: tuple[IntArray, IntArray]) -> Score:
    """Two-way score of an alignment (4, 4) by subsets of target and source."""
    target, source, tolerance = problem.target, problem.source, problem.tolerance
    scale = scale_of(T)
    reach = max(3.0 * max(target.spacing, source.spacing * scale), 2 * tolerance)
    forward = _one_way(target, source, T, subsets[1], tolerance, reach)
    back = _one_way(source, target, inverse_sim3(T), subsets[0], tolerance / scale, reach / scale)
    return Score(
        evidence=np.concatenate([forward.evidence, back.evidence]) / 2,
        inlier_ratio=(forward.inlier_share + back.inlier_share) / max(forward.near_share + back.near_share, 1e-9),
        overlap=min(forward.near_share, back.near_share),
        rmse=forward.rmse,
    )


def _one_way(
    target: PreparedCloud, source: PreparedCloud, T: FloatArray, subset: IntArray, tolerance: float, reach: float
) -> _OneWay:
    found = measure_residuals(target, source.points[subset], source.normals[subset], T, reach)
    near = np.isfinite(found.distance)
    along = np.where(near, np.abs(found.along_normal), np.inf)
    inlier = (along <= tolerance) & (found.agreement >= AGREEMENT)
    on_surface = np.exp(-0.5 * (along / (tolerance / 2)) ** 2) * np.minimum(found.agreement, 1.0) ** 2
    on_landmark = np.exp(-0.5 * (found.distance / (2 * tolerance / 3)) ** 2)
    return _OneWay(
        evidence=(on_surface + on_landmark - CHANCE * near) / len(subset),
        inlier_share=float(inlier.mean()),
        near_share=float(near.mean()),
        rmse=float(np.sqrt(np.mean(along[inlier] ** 2))) if inlier.any() else float("nan"),
    )
