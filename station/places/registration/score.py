"""How well an alignment explains both clouds: shares of points on each other's surfaces, beyond what chance gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse_sim3, scale_of
from station.places.registration.cloud import PreparedCloud
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import measure_residuals

SLIDES = 6
SLIDE_TOLERANCES = 6.0  # 30 cm at 2 cm noise: farther than the tolerance, nearer than the next piece of furniture
AGREEMENT = 0.7  # |cosine| of normals that may belong to one surface


@dataclass(frozen=True, slots=True)
class Score:
    """Shares in 0..1 of one alignment."""

    inlier_share: float  # points on the other cloud's surface, of all points; the mean of both directions
    inlier_ratio: float  # of the points with a neighbour in the other cloud
    overlap: float  # points with a neighbour in the other cloud, the smaller of both directions
    point_share: float  # points with a landmark of the other cloud within the tolerance, beyond chance
    rmse: float  # of inliers, along normals


@dataclass(frozen=True, slots=True)
class Contrast:
    """How much of the inlier share is lost by sliding the source a little over the floor.

    Floors and long walls fit anywhere along themselves, also in the wrong flat; only what fits here and nowhere else
    speaks for an alignment.
    """

    mean: float  # share lost on average over the directions
    least: float  # share lost in the direction that loses least


def score_alignment(problem: RegistrationProblem, T: FloatArray, subsets: tuple[IntArray, IntArray]) -> Score:
    """Two-way score of an alignment (4, 4) by subsets of target and source."""
    target, source, tolerance = problem.target, problem.source, problem.tolerance
    scale = scale_of(T)
    reach = max(3.0 * max(target.spacing, source.spacing * scale), 2 * tolerance)
    forward = _one_way(target, source, T, subsets[1], tolerance, reach)
    back = _one_way(source, target, inverse_sim3(T), subsets[0], tolerance / scale, reach / scale)
    return Score(
        inlier_share=(forward[0] + back[0]) / 2,
        inlier_ratio=(forward[0] + back[0]) / max(forward[1] + back[1], 1e-9),
        overlap=min(forward[1], back[1]),
        point_share=(forward[2] + back[2]) / 2,
        rmse=forward[3],
    )


def contrast_of(
    problem: RegistrationProblem, T: FloatArray, share: float, subsets: tuple[IntArray, IntArray]
) -> Contrast:
    """Contrast of an alignment whose inlier share on the same subsets is `share`."""
    slid = []
    for k in range(SLIDES):
        angle = 2 * np.pi * k / SLIDES + 0.3  # off the axes, as walls often are along them
        moved = T.copy()
        moved[:2, 3] += SLIDE_TOLERANCES * problem.tolerance * np.array([np.cos(angle), np.sin(angle)])
        slid.append(score_alignment(problem, moved, subsets).inlier_share)
    return Contrast(share - float(np.mean(slid)), share - max(slid))


def _one_way(
    target: PreparedCloud, source: PreparedCloud, T: FloatArray, subset: IntArray, tolerance: float, reach: float
) -> tuple[float, float, float, float]:
    found = measure_residuals(target, source.points[subset], source.normals[subset], T, reach)
    near = np.isfinite(found.distance)
    along = np.abs(found.along_normal)
    inlier = near & (along <= tolerance) & (found.agreement >= AGREEMENT)
    rmse = float(np.sqrt(np.mean(along[inlier] ** 2))) if inlier.any() else float("nan")
    # Landmarks that coincide: within the tolerance in all directions, against those within twice of it. On a surface
    # sampled independently, the share grows with the square of the radius; coinciding landmarks exceed that.
    close = float(np.mean(found.distance <= tolerance))
    ring = float(np.mean(found.distance <= 2 * tolerance))
    return float(inlier.mean()), float(near.mean()), max(0.0, close - ring / 4), rmse
