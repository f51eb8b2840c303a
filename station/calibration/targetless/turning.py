"""How the camera turned between pairs of images, from the corners it followed: two-view geometry, calibrated lens."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, cross, homogeneous, skew, so3_exp, so3_log
from station.calibration.camera_imu.start import Turns
from station.calibration.targetless.tracks import MIN_TRACKED, Sightings
from station.vision.lens import BoolArray

APART_S = 0.2  # of a pair's images: nearer, and moving is not told from turning
MIN_PAIRS = 8
STEPS = 12
INLIER_PX = 0.7
CONFIDENCE = 0.9999
LIMIT = 3.0  # of the median: corners that lie farther from their epipolar line count less (Cauchy)
MAX_APART_RAD = 0.15  # of the two starts: more, and the one that tells moving from turning has found a mirrored scene
SETTLED_RAD = 1e-6


def camera_turns(sightings: Sightings, focal_px: float) -> tuple[Turns, BoolArray]:
    """Of all pairs of images about APART_S apart; and which sightings (M,) do not lie beside their epipolar lines.

    Raises:
        DegenerateGeometry: too few corners could be followed.
    """
    agreeing = np.ones(len(sightings.image), dtype=bool)
    pairs = []
    for begin_s, end_s, a, b in image_pairs(sightings):
        turn, distance = relative_rotation(sightings.xy[a], sightings.xy[b], INLIER_PX / focal_px)
        agreeing[b] &= distance < LIMIT * max(float(np.median(distance)), 0.5 * INLIER_PX / focal_px)
        pairs.append((begin_s, end_s, so3_log(turn)))
    if len(pairs) < MIN_PAIRS:
        raise DegenerateGeometry("too few corners could be followed from image to image")
    begin, end, turns = zip(*pairs, strict=True)
    return Turns(np.array(begin), np.array(end), np.array(turns)), agreeing


def image_pairs(sightings: Sightings) -> Iterator[tuple[float, float, IntArray, IntArray]]:
    """Of each pair of images about APART_S apart: both times, and the rows in sightings of the corners in both."""
    t_s = sightings.t_s
    rows = np.argsort(sightings.image, kind="stable")
    bounds = np.searchsorted(sightings.image[rows], np.arange(len(t_s) + 1))
    for k, other in enumerate(np.searchsorted(t_s, t_s + APART_S - 1e-3).tolist()):
        if other >= len(t_s) or t_s[other] > t_s[k] + 2.0 * APART_S:
            continue
        a, b = rows[bounds[k] : bounds[k + 1]], rows[bounds[other] : bounds[other + 1]]
        _, in_a, in_b = np.intersect1d(sightings.corner[a], sightings.corner[b], return_indices=True)
        if len(in_a) >= MIN_TRACKED:
            yield t_s[k], t_s[other], a[in_a], b[in_b]


def planar_share(sightings: Sightings, focal_px: float) -> float:
    """The share of the corners that one plane explains, in the median pair of images.

    A plane allows two ways to have turned and moved, and nothing in two views tells them apart.
    Source: Faugeras and Lustman, Motion and Structure from Motion in a Piecewise Planar Environment, 1988.
    """
    shares = []
    for _, _, a, b in image_pairs(sightings):
        _, mask = cv2.findHomography(sightings.xy[a], sightings.xy[b], cv2.RANSAC, 2.0 * INLIER_PX / focal_px)
        shares.append(0.0 if mask is None else float(np.mean(mask)))
    return float(np.median(shares)) if shares else 0.0


def relative_rotation(xy_a: FloatArray, xy_b: FloatArray, inlier: float) -> tuple[FloatArray, FloatArray]:
    """R_a_b (3, 3) of two views of the same N corners, and the corners' distances (N,) from their epipolar lines.

    Gauss-Newton over rotation and direction of translation on Sampson's distance, weighted by Cauchy's function. It
    has more than one minimum: it starts from the five-point method's, and where the camera hardly moved, which leaves
    that one's rotation open, from the rotation that aligns the rays.
    Source: Hartley and Zisserman, Multiple View Geometry, 2nd ed., sec. 11.4.3; Nister, PAMI 26(6), 2004.

    Args:
        inlier: distance, normalised coordinates, up to which a corner agrees with a five-point solution.
    """
    a, b = homogeneous(xy_a), homogeneous(xy_b)
    R = _aligned(a, b)
    t = _direction(a, b @ R.T)
    cv2.setRNGSeed(0)
    E, mask = cv2.findEssentialMat(xy_b, xy_a, np.eye(3), cv2.RANSAC, CONFIDENCE, inlier)
    if E is not None and E.shape[0] >= 3:
        _, R_five, t_five, _ = cv2.recoverPose(E[:3], xy_b, xy_a, np.eye(3), mask=mask)
        if np.linalg.norm(so3_log(R.T @ R_five)) < MAX_APART_RAD:
            R, t = np.asarray(R_five, dtype=np.float64), np.asarray(t_five, dtype=np.float64).ravel()
    for _ in range(STEPS):
        basis = np.linalg.svd(t[None])[2][1:]  # (2, 3) across t
        distance, J = _sampson(a, b, R, t)
        J = np.concatenate([J[:, :3], J[:, 3:] @ basis.T], axis=1)
        scale = LIMIT * max(float(np.median(np.abs(distance))), 1e-5)
        weight = 1.0 / (1.0 + (distance / scale) ** 2)
        H = (J * weight[:, None]).T @ J
        # A camera that only turns leaves the direction open: damped, it stays where it is.
        H[[3, 4], [3, 4]] += 1e-7 * len(a)
        H[[0, 1, 2], [0, 1, 2]] += 1e-9 * len(a)
        step: FloatArray = np.asarray(-np.linalg.solve(H, J.T @ (weight * distance)), dtype=np.float64)
        R = R @ so3_exp(step[:3])
        t = t + basis.T @ step[3:]
        t /= np.linalg.norm(t)
        if np.abs(step[:3]).max() < SETTLED_RAD:
            break
    return R, np.abs(_sampson(a, b, R, t)[0])


def _aligned(a: FloatArray, b: FloatArray) -> FloatArray:
    """The rotation that turns rays b towards a, wrong ones counting less and less (Kabsch)."""
    a, b = (rays / np.linalg.norm(rays, axis=1)[:, None] for rays in (a, b))
    weight = np.ones(len(a))
    R = np.eye(3)
    for _ in range(4):
        U, _, Vt = np.linalg.svd((a * weight[:, None]).T @ b)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        error = ((a - b @ R.T) ** 2).sum(axis=1)
        weight = 1.0 / (1.0 + error / (4.0 * np.median(error) + 1e-12))
    return R


def _direction(a: FloatArray, turned_b: FloatArray) -> FloatArray:
    normals = cross(a, turned_b)
    return np.asarray(np.linalg.svd(normals, full_matrices=False)[2][-1])


def _sampson(a: FloatArray, b: FloatArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (N,) of a pair from agreeing, and its derivative (N, 6) by the turn (on R's right) and by t.

    That of the numerator: the denominator changes little where the distance is small.
    """
    E = skew(t) @ R
    line_a, line_b = b @ E.T, a @ E
    norm = np.sqrt((line_a[:, :2] ** 2).sum(axis=1) + (line_b[:, :2] ** 2).sum(axis=1))
    norm = np.maximum(norm, 1e-9)
    error = (a * line_a).sum(axis=1)
    J = np.concatenate([cross(b, line_b), cross(b @ R.T, a)], axis=1)
    return error / norm, J / norm[:, None]
