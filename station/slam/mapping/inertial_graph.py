"""Factors of visual-inertial smoothing for GTSAM (docs/slam.md, "Smoothing"; thesis 2.10-2.13).

Variables of a keyframe: pose x (Pose3, T_world_body), velocity v (3,) in the world, biases b (6,) of gyroscope and
accelerometer; of a landmark: l (Point3). A change (w, u) of a pose is GTSAM's, on its right: R Exp(w), t + R u.
"""

from __future__ import annotations

from collections.abc import MutableSequence
from functools import lru_cache

import gtsam
import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray
from station.motion.preintegration import Preintegration

UNIT_CAMERA = gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0)  # measurements are normalised coordinates

Jacobians = MutableSequence[FloatArray]  # by each of a factor's variables: GTSAM hands it over to be filled

ODOMETRY_SIGMA_RAD, ODOMETRY_SIGMA_M, ODOMETRY_SHARE = 1e-3, 0.002, 0.05


def pose_key(number: int) -> int:
    return int(gtsam.symbol("x", number))


def velocity_key(number: int) -> int:
    return int(gtsam.symbol("v", number))


def bias_key(number: int) -> int:
    return int(gtsam.symbol("b", number))


def landmark_key(number: int) -> int:
    return int(gtsam.symbol("l", number))


WHEELS_KEY = int(gtsam.symbol("w", 0))


def to_pose(T: FloatArray) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(T[:3, :3]), T[:3, 3])


def inertial_factor(a: int, b: int, link: Preintegration, noise: ImuNoise, gravity: float) -> gtsam.CustomFactor:
    """The IMU between keyframes a and b, and how far biases walk meanwhile: thesis eq. 2.11."""
    fall = np.array([0.0, 0.0, -gravity])
    walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3) * np.sqrt(link.duration_s)
    W = link.sqrt_information

    def error(_: gtsam.CustomFactor, values: gtsam.Values, H: Jacobians | None) -> FloatArray:
        Ti, Tj = values.atPose3(keys[0]), values.atPose3(keys[1])
        bi, bj = values.atVector(keys[4]), values.atVector(keys[5])
        r, J = inertial_residual(
            Ti.rotation().matrix(), Ti.translation(), values.atVector(keys[2]), bi,
            Tj.rotation().matrix(), Tj.translation(), values.atVector(keys[3]), link, fall, H is not None,
        )  # fmt: skip
        if H is not None:
            J = W @ J
            blocks = (J[:, :6], J[:, 6:12], J[:, 12:15], J[:, 15:18], J[:, 18:24], None)
            walking = np.diag(1.0 / walk)
            for k, block in enumerate(blocks):
                whole = np.zeros((15, 3 if k in (2, 3) else 6))
                if block is not None:
                    whole[:9] = block
                if k >= 4:
                    whole[9:] = walking if k == 5 else -walking
                H[k] = whole
        return np.concatenate([W @ r, (bj - bi) / walk])

    keys = [pose_key(a), pose_key(b), velocity_key(a), velocity_key(b), bias_key(a), bias_key(b)]
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(15), keys, error)


def inertial_residual(
    Ri: FloatArray,
    xi: FloatArray,
    vi: FloatArray,
    bias: FloatArray,
    Rj: FloatArray,
    xj: FloatArray,
    vj: FloatArray,
    link: Preintegration,
    fall: FloatArray,
    with_derivative: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Residual (9,) of rotation, velocity, position; its derivative (9, 24) by (w, u)_i, (w, u)_j, v_i, v_j, b_i."""
    d = bias - link.bias
    bent = link.dR_by_bias @ d[:3]
    dR = link.dR @ gtsam.Rot3.Expmap(bent).matrix()
    dv, dp = link.dv + link.dv_by_bias @ d, link.dp + link.dp_by_bias @ d
    T = link.duration_s
    to_v = Ri.T @ (vj - vi - fall * T)
    to_p = Ri.T @ (xj - xi - vi * T - 0.5 * fall * T * T)
    r_phi = gtsam.Rot3.Logmap(gtsam.Rot3(dR.T @ Ri.T @ Rj))
    r = np.concatenate([r_phi, to_v - dv, to_p - dp])
    if not with_derivative:
        return r, np.empty((9, 0))
    J = np.zeros((9, 24))
    left = _left_jacobian_inverse(r_phi)
    right = left.T  # inverse of the right Jacobian
    Rji = Rj.T @ Ri
    J[:3, 0:3] = -right @ Rji
    J[:3, 6:9] = right
    J[:3, 18:21] = -left @ _right_jacobian(bent) @ link.dR_by_bias
    J[3:6, 0:3] = _skew(to_v)
    J[6:9, 0:3] = _skew(to_p)
    J[6:9, 3:6] = -np.eye(3)
    J[6:9, 9:12] = Rji.T
    J[3:6, 12:15] = -Ri.T
    J[3:6, 15:18] = Ri.T
    J[6:9, 12:15] = -T * Ri.T
    J[3:6, 18:24] = -link.dv_by_bias
    J[6:9, 18:24] = -link.dp_by_bias
    return r, J


def _left_jacobian_inverse(phi: FloatArray) -> FloatArray:
    """(3, 3) of one small rotation vector; its transpose is the right Jacobian's."""
    angle2 = float(phi @ phi)
    if angle2 < 1e-6:
        quadratic = 1.0 / 12.0 + angle2 / 720.0
    else:
        half = 0.5 * np.sqrt(angle2)
        quadratic = (1.0 - half / np.tan(half)) / angle2
    K = _skew(phi)
    return np.asarray(np.eye(3) - 0.5 * K + quadratic * (K @ K))


def _right_jacobian(phi: FloatArray) -> FloatArray:
    """(3, 3) of a rotation vector that a change of bias makes: tiny, so that two terms suffice."""
    K = _skew(phi)
    return np.asarray(np.eye(3) - 0.5 * K + (K @ K) / 6.0)


def _skew(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def reprojection_factor(
    keyframe: int, landmark: int, xy: FloatArray, sigma: float, huber: float, T_body_cam: gtsam.Pose3
) -> gtsam.NonlinearFactor:
    """A landmark seen at normalised coordinates xy (2,), known to sigma: thesis eq. 2.12, by an ideal camera."""
    model = _pixel_noise(float(f"{sigma:.2g}"), huber)
    return gtsam.GenericProjectionFactorCal3_S2(
        xy, model, pose_key(keyframe), landmark_key(landmark), UNIT_CAMERA, False, False, T_body_cam
    )


@lru_cache(maxsize=256)
def _pixel_noise(sigma: float, huber: float) -> gtsam.noiseModel.Base:
    """Shared: to make one takes longer than to make a factor."""
    model = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), model)


def wheel_factor(keyframe: int, by_wheels: FloatArray, sigma: FloatArray, huber: float) -> gtsam.CustomFactor | None:
    """Body velocity R^T v as wheels have it, by their two constants (docs/slam.md, sec. 9); None: nothing is known.

    Args:
        by_wheels: (3, 2) velocity by the constants; sigma: (3,) m/s, infinite where unknown.
    """
    known = np.isfinite(sigma)
    if not known.any():
        return None
    by_wheels, sigma = by_wheels[known], sigma[known]

    def error(_: gtsam.CustomFactor, values: gtsam.Values, H: Jacobians | None) -> FloatArray:
        R = values.atPose3(keys[0]).rotation().matrix()
        v_body = R.T @ values.atVector(keys[1])
        if H is not None:
            by_pose = np.zeros((len(sigma), 6))
            by_pose[:, :3] = _skew(v_body)[known]
            H[0] = by_pose / sigma[:, None]
            H[1] = R.T[known] / sigma[:, None]
            H[2] = -by_wheels / sigma[:, None]
        return np.asarray((v_body[known] - by_wheels @ values.atVector(keys[2])) / sigma)

    keys = [pose_key(keyframe), velocity_key(keyframe), WHEELS_KEY]
    unit = gtsam.noiseModel.Unit.Create(int(known.sum()))
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), unit)
    return gtsam.CustomFactor(robust, keys, error)


def odometry_factor(a: int, b: int, T_a_b: FloatArray) -> gtsam.NonlinearFactor:
    """What a filter says of the motion between two keyframes, where they see too little to say it themselves."""
    sigma_x = ODOMETRY_SIGMA_M + ODOMETRY_SHARE * float(np.linalg.norm(T_a_b[:3, 3]))
    model = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([ODOMETRY_SIGMA_RAD, sigma_x], 3))
    return gtsam.BetweenFactorPose3(pose_key(a), pose_key(b), to_pose(T_a_b), model)


def standstill_factors(a: int, b: int, sigma_phi: float, sigma_x: float, sigma_v: float) -> list[gtsam.NonlinearFactor]:
    """The body has not moved between two keyframes and rests at the second."""
    same = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([sigma_phi, sigma_x], 3))
    return [
        gtsam.BetweenFactorPose3(pose_key(a), pose_key(b), gtsam.Pose3(), same),
        gtsam.PriorFactorVector(velocity_key(b), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, sigma_v)),
    ]


def prior_factors(
    keyframe: int, T: FloatArray, v: FloatArray, bias: FloatArray, sigma: FloatArray
) -> list[gtsam.NonlinearFactor]:
    """What is known of a first keyframe; sigma (15,): rotation about the world's axes, position, velocity, biases."""
    R = T[:3, :3]
    cov = np.zeros((6, 6))
    cov[:3, :3] = R.T @ np.diag(sigma[:3] ** 2) @ R
    cov[3:, 3:] = R.T @ np.diag(sigma[3:6] ** 2) @ R
    return [
        gtsam.PriorFactorPose3(pose_key(keyframe), to_pose(T), gtsam.noiseModel.Gaussian.Covariance(cov)),
        gtsam.PriorFactorVector(velocity_key(keyframe), v, gtsam.noiseModel.Diagonal.Sigmas(sigma[6:9])),
        gtsam.PriorFactorVector(bias_key(keyframe), bias, gtsam.noiseModel.Diagonal.Sigmas(sigma[9:])),
    ]
