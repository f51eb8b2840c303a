"""Local refinement of an alignment with scale: robust point-to-plane Gauss-Newton over Sim(3).

GICP libraries estimate no scale and trim nothing; a scale error of 5 % is invisible to their inlier ratio while it
bends the result by decimetres. So rotation, translation and log scale are solved together here, with a prior that
keeps gravity-aligned clouds upright and a scale step of zero where the scale is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, cross, rotation_of, se3, skew, so3_exp, transform
from station.places.registration.cloud import PreparedCloud
from station.places.registration.nearest import NearestTracker
from station.places.registration.problem import RegistrationProblem

TILT_SIGMA_RAD = np.radians(1.0)  # gravity from a minute of IMU is good to about half a degree, times two clouds
REACH_PER_SIGMA = 5.0  # of the robust weights: residuals beyond a fifth of the search radius fade
POINT_WEIGHT = 0.2  # of the nearest landmark beside the plane


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A locally optimal alignment and its normal equations."""

    T_target_source: FloatArray  # (4, 4) with scale
    hessian: FloatArray  # (7, 7) of the weighted residuals: rotation, translation, log scale about `pivot`
    pivot: FloatArray  # (3,) target frame
    rms: float  # weighted, along normals


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    target_index: IntArray  # (m,) nearest target point
    distance: FloatArray  # (m,) to it, inf beyond the search radius
    along_normal: FloatArray  # (m,) signed distance from its plane
    agreement: FloatArray  # (m,) |cosine| between the two local normals


def measure_residuals(
    target: PreparedCloud, points: FloatArray, normals: FloatArray, T: FloatArray, reach: float
) -> Residuals:
    """Where source points (m, 3) with normals (m, 3) fall on the target when moved by T."""
    moved = transform(T, points)
    distance, index = target.tree.query(moved, distance_upper_bound=reach)
    found = np.isfinite(distance)
    index = np.where(found, index, 0)
    normal = target.normals[index]
    along = np.einsum("ni,ni->n", moved - target.points[index], normal)
    turned = normals @ rotation_of(T).T
    return Residuals(index, distance, np.where(found, along, np.inf), np.abs(np.einsum("ni,ni->n", normal, turned)))


def refine(
    problem: RegistrationProblem, T_start: FloatArray, *, subset: IntArray, reaches: tuple[float, ...], tolerance: float
) -> Refined:
    """Improve T_start: one pass per reach (search radius), shrinking from coarse to fine.

    Args:
        subset: (m,) which source points to use.
        reaches: search radius of each pass, target units.
        tolerance: stop when a pass at the last reach moves less than this (target units).
    Source: point-to-plane as in Chen and Medioni, IVC 10(3), 1992; Geman-McClure weights on residuals
    along normals.
    """
    target, source = problem.target, problem.source
    T = T_start.copy()
    points, normals = source.points[subset], source.normals[subset]
    weight_flat = source.flatness[subset]
    radius = max(target.radius, 1e-9)
    H = np.zeros((7, 7))
    pivot = T[:3, 3]
    rms = float("inf")
    tracker = NearestTracker(target, len(points))
    for reach in reaches:
        moved = transform(T, points)
        nearest, near = tracker.find(moved, reach)
        use = np.flatnonzero(near)
        if len(use) < 12:
            break
        moved, nearest = moved[use], nearest[use]
        normal = target.normals[nearest]
        gap = target.points[nearest] - moved
        along = -np.einsum("ni,ni->n", gap, normal)
        turned = normals[use] @ rotation_of(T).T
        sigma = max(reach / REACH_PER_SIGMA, target.noise)
        w = 1.0 / (1.0 + (along / sigma) ** 2) ** 2  # Geman-McClure: outliers vanish
        agreement = np.einsum("ni,ni->n", normal, turned) ** 2
        w *= np.minimum(agreement, 1.0) * (0.2 + target.flatness[nearest] * weight_flat[use])
        # Beside the plane, a weak pull to the nearest landmark: the same texture seen twice is the same point.
        w_point = POINT_WEIGHT * w / (1.0 + (np.einsum("ni,ni->n", gap, gap)) / (2 * sigma) ** 2) ** 2
        pivot = moved.mean(axis=0)
        arm = moved - pivot
        J = np.empty((len(arm), 7))
        J[:, :3] = cross(arm, normal)
        J[:, 3:6] = normal
        J[:, 6] = np.einsum("ni,ni->n", arm, normal)
        weighted = J * w[:, None]
        H = weighted.T @ J / sigma**2
        g = -(along @ weighted) / sigma**2
        H_point, g_point = _point_terms(arm, gap, w_point / sigma**2)
        H, g = H + H_point, g + g_point
        rms = float(np.sqrt((w * along**2).sum() / max(w.sum(), 1e-12)))
        A, b = H.copy(), g.copy()
        if problem.upright:
            _add_tilt_prior(A, b, T)
        if not problem.free_scale:
            A[6, :], A[:, 6], A[6, 6], b[6] = 0.0, 0.0, 1.0, 0.0
        A += 1e-9 * np.trace(A) * np.eye(7)
        step = np.linalg.solve(A, b)
        step = _bounded(step, reach, radius)
        T = _apply(step, pivot) @ T
        moved_by = float(np.linalg.norm(step[3:6]) + radius * (np.linalg.norm(step[:3]) + abs(step[6])))
        if reach == reaches[-1] and moved_by < tolerance:
            break
    return Refined(T, H, pivot, rms)


def _point_terms(arm: FloatArray, gap: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal equations of the point-to-point terms: gap = omega x arm + v + s * arm."""
    H, g = np.zeros((7, 7)), np.zeros(7)
    total = w.sum()
    mean = w @ arm
    outer = (w[:, None] * arm).T @ arm
    H[:3, :3] = np.trace(outer) * np.eye(3) - outer
    H[:3, 3:6] = skew(mean)
    H[3:6, :3] = H[:3, 3:6].T
    H[3:6, 3:6] = total * np.eye(3)
    H[3:6, 6] = H[6, 3:6] = mean
    H[6, 6] = np.trace(outer)
    g[:3] = w @ cross(arm, gap)
    g[3:6] = w @ gap
    g[6] = w @ np.einsum("ni,ni->n", arm, gap)
    return H, g


def _add_tilt_prior(A: FloatArray, b: FloatArray, T: FloatArray) -> None:
    """Pull the source's vertical to the target's: its tilt is the rotation about x and y that takes it back."""
    up = T[:3, 2] / np.linalg.norm(T[:3, 2])
    tilt = np.array([-up[1], up[0]])  # small-angle rotation (x, y) that has tilted it
    weight = max(float(np.trace(A[:3, :3])), 1e-9)  # as strong as the data at TILT_SIGMA_RAD
    information = weight * (np.radians(0.5) / TILT_SIGMA_RAD) ** 2 * 4
    A[0, 0] += information
    A[1, 1] += information
    b[:2] -= information * tilt


def _bounded(step: FloatArray, reach: float, radius: float) -> FloatArray:
    """No iteration may move a point farther than about the reach: beyond it the correspondences mean nothing."""
    size = float(np.linalg.norm(step[3:6]) + radius * (np.linalg.norm(step[:3]) + abs(step[6])))
    return step if size <= reach else step * (reach / size)


def _apply(step: FloatArray, pivot: FloatArray) -> FloatArray:
    """The small motion `step` about `pivot` as (4, 4)."""
    A = float(np.exp(step[6])) * so3_exp(step[:3])
    return se3(A, pivot + step[3:6] - A @ pivot)
