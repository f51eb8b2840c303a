"""Camera pose from map points and their rays: RANSAC over three points, refinement, uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray, inverse, se3, skew, so3_exp, transform

RANSAC_ITERATIONS = 400
RANSAC_CONFIDENCE = 0.999
REFINE_ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    T_map_cam: FloatArray  # (4, 4)
    inlier: npt.NDArray[np.bool_]  # (n,) of the matches given
    cov_pose: FloatArray  # (6, 6) rotation (rad), translation (map units), both in the camera frame
    median_depth: float  # of the inliers

    @property
    def num_inliers(self) -> int:
        return int(np.count_nonzero(self.inlier))

    @property
    def sigma_position(self) -> float:
        """One sigma of the camera's position along its worst axis, map units."""
        return float(np.sqrt(np.linalg.eigvalsh(self.cov_pose[3:, 3:])[-1]))


def solve_pose(p_map: FloatArray, rays: FloatArray, tolerance: float) -> CameraPose | None:
    """Pose that most matches agree on, or None.

    Args:
        p_map: (n, 3) map points.
        rays: (n, 2) normalised coordinates they were seen at.
        tolerance: of a match that agrees, normalised coordinates (pixels over focal length).
    """
    found = pose_by_ransac(p_map, rays, tolerance, RANSAC_ITERATIONS, seed=1) if len(p_map) >= 6 else None
    return None if found is None else solve_pose_from(found[0], p_map, rays, tolerance)


def pose_by_ransac(
    p_map: FloatArray, rays: FloatArray, tolerance: float, iterations: int, seed: int
) -> tuple[FloatArray, IntArray] | None:
    """T_map_cam (4, 4) that most matches agree on, as `solve_pose` has them, and which do; None without such a pose.

    Source: AP3P (Ke and Roumeliotis, CVPR 2017) in RANSAC, by OpenCV; its random numbers are seeded per call.
    """
    cv2.setRNGSeed(seed)
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        np.ascontiguousarray(p_map),
        np.ascontiguousarray(rays),
        np.eye(3),
        np.zeros(4),
        iterationsCount=iterations,
        reprojectionError=tolerance,
        confidence=RANSAC_CONFIDENCE,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or inliers is None:
        return None
    agree = np.asarray(inliers, dtype=np.int64).ravel()
    # OpenCV ends the search with EPnP, which for small flat things may end far from what the matches agreed on.
    rotation, translation = _fitted(p_map[agree], rays[agree]) or (rotation, translation)
    R = np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64)
    T_cam_map = se3(R, np.asarray(translation, dtype=np.float64).ravel())
    return (inverse(T_cam_map), agree) if np.isfinite(T_cam_map).all() else None


def _fitted(p_map: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Rotation vector and translation that fit all matches best; None where these are too few different points.

    Source: SQPnP (Terzakis and Lourakis, ECCV 2020), by OpenCV.
    """
    try:
        found, rotation, translation = cv2.solvePnP(
            np.ascontiguousarray(p_map),
            np.ascontiguousarray(rays),
            np.eye(3),
            np.zeros(4),
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:
        return None
    return (np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)) if found else None


def solve_pose_from(T_map_cam: FloatArray, p_map: FloatArray, rays: FloatArray, tolerance: float) -> CameraPose | None:
    """Refine a pose by Gauss-Newton on the matches that agree with it; None when fewer than six do."""
    T_cam_map = inverse(T_map_cam)
    H = np.eye(6)
    for _ in range(REFINE_ROUNDS):
        p_cam, residual, inlier = _residuals(T_cam_map, p_map, rays, 2.0 * tolerance)
        if np.count_nonzero(inlier) < 6:
            return None
        J = _jacobian(p_cam[inlier])
        r = residual[inlier]
        w = 1.0 / (1.0 + (r**2).sum(axis=1) / tolerance**2) ** 2  # Geman-McClure
        H = np.einsum("n,nki,nkj->ij", w, J, J)
        g = np.einsum("n,nki,nk->i", w, J, r)
        try:
            step = np.linalg.solve(H + 1e-12 * np.trace(H) * np.eye(6), -g)
        except np.linalg.LinAlgError:
            return None
        T_cam_map = se3(so3_exp(step[:3]), step[3:]) @ T_cam_map
        if float(np.linalg.norm(step)) < 1e-9:
            break
    p_cam, residual, inlier = _residuals(T_cam_map, p_map, rays, tolerance)
    if np.count_nonzero(inlier) < 6:
        return None
    # The map's own errors and outliers within the tolerance are part of the residuals, so their size is the noise.
    variance = max(float((residual[inlier] ** 2).sum()) / max(2 * int(np.count_nonzero(inlier)) - 6, 1), 1e-12)
    J = _jacobian(p_cam[inlier])
    cov = variance * np.linalg.pinv(np.einsum("nki,nkj->ij", J, J), hermitian=True)
    return CameraPose(inverse(T_cam_map), inlier, cov, float(np.median(p_cam[inlier, 2])))


def _residuals(
    T_cam_map: FloatArray, p_map: FloatArray, rays: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    p_cam = transform(T_cam_map, p_map)
    ahead = p_cam[:, 2] > 1e-9
    residual = p_cam[:, :2] / np.where(ahead, p_cam[:, 2], 1.0)[:, None] - rays
    return p_cam, residual, ahead & ((residual**2).sum(axis=1) < tolerance**2)


def _jacobian(p_cam: FloatArray) -> FloatArray:
    """(n, 2, 6) of projections by a small motion (rotation, translation) applied in the camera frame."""
    x, y, z = p_cam.T
    J_point = np.zeros((len(p_cam), 2, 3))
    J_point[:, 0, 0] = J_point[:, 1, 1] = 1 / z
    J_point[:, 0, 2], J_point[:, 1, 2] = -x / z**2, -y / z**2
    J_motion = np.zeros((len(p_cam), 3, 6))
    J_motion[:, :, :3] = -skew(p_cam)
    J_motion[:, :, 3:] = np.eye(3)
    return J_point @ J_motion
