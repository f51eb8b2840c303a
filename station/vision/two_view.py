"""Outlier test between two frames whose relative rotation the gyroscope knows: only the direction is searched."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, cross
from station.vision.lens import BoolArray


def epipolar_inliers(
    rays_a: FloatArray,
    rays_b: FloatArray,
    R_a_b: FloatArray,
    threshold: float,
    rng: np.random.Generator,
    num_hypotheses: int = 32,
) -> BoolArray:
    """Which correspondences agree with one translation direction, given the rotation (2-point RANSAC).

    With R known, each pair constrains the translation t by t . (a x R b) = 0; two pairs give t. The error is the
    distance of a from the epipolar line through R b, so that pure rotation (every t fits) rejects only what is away
    from R b.
    Args:
        rays_a: (N, 2) normalised coordinates in frame a.
        rays_b: (N, 2) the same points in frame b.
        R_a_b: (3, 3) from the gyroscope.
        threshold: largest distance to the epipolar line, normalised coordinates.
    Returns:
        (N,) True for inliers of the best hypothesis.
    Source: Troiani et al., ICRA 2014 (2-point RANSAC with known rotation).
    """
    N = len(rays_a)
    if N < 3:
        return np.ones(N, dtype=bool)
    a = np.column_stack([rays_a, np.ones(N)])
    b = np.column_stack([rays_b, np.ones(N)]) @ R_a_b.T
    behind = b[:, 2] < 0.1
    b = b / np.where(behind, 1.0, b[:, 2])[:, None]
    normals = cross(a, b)
    # Pairs that moved more constrain the direction better: draw those more often.
    weight = np.linalg.norm(normals, axis=1) + 1e-9
    draws = rng.choice(N, size=(num_hypotheses, 2), p=weight / weight.sum())
    t = cross(normals[draws[:, 0]], normals[draws[:, 1]])
    norm = np.linalg.norm(t, axis=1)
    t = t[norm > 1e-15] / norm[norm > 1e-15, None]
    if not len(t):
        return ~behind & (np.linalg.norm(a - b, axis=1) < threshold)
    inliers = _line_distance(normals, b, t) < threshold
    best = int(np.argmax(inliers.sum(axis=1)))
    # One refit on the inliers: the least-squares direction is the smallest singular vector of their normals.
    refit = (
        np.linalg.svd(normals[inliers[best]], full_matrices=False)[2][-1:]
        if inliers[best].sum() >= 3
        else t[best][None]
    )
    refined = _line_distance(normals, b, refit)[0] < threshold
    chosen = refined if refined.sum() >= inliers[best].sum() else inliers[best]
    return chosen & ~behind


def _line_distance(normals: FloatArray, b: FloatArray, t: FloatArray) -> FloatArray:
    """(H, N) distance of points a to the lines through b (N, 3; b_z = 1) and the epipoles t (H, 3).

    The line is t x b, and a . (t x b) = -t . (a x b), with normals = a x b (N, 3).
    """
    line_x = t[:, 1:2] - t[:, 2:] * b[:, 1]
    line_y = t[:, 2:] * b[:, 0] - t[:, :1]
    return np.abs(t @ normals.T) / np.maximum(np.sqrt(line_x * line_x + line_y * line_y), 1e-12)
