"""Where the estimate starts: with the turning known, the rest is a linear problem."""

from __future__ import annotations

import itertools

import msgspec
import numpy as np

from shared.calibration import CameraCalibration
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, homogeneous
from station.calibration.camera_imu.start import TurningMatch
from station.calibration.camera_imu.unknowns import bias_nodes
from station.calibration.targetless.rows import Inertial
from station.calibration.targetless.tracks import Sightings
from station.calibration.targetless.unknowns import MAX_INVERSE_DEPTH, Estimate, across
from station.motion.preintegration import Preintegration, compose
from station.vision.lens import Lens

ROUNDS = 4
FIRST_DEPTH_M = 2.0
NEAREST_M = 0.1
SIGMA_RAY = 0.05  # of a ray, with turning not yet exact
# Of velocity and position between images, with gravity's direction drifting by what the gyroscope's bias is off.
SIGMA_MOVING = 0.03  # m/s^2 sqrt(s)
SIGMA_BIAS = 0.1  # m/s^2
SIGMA_GRAVITY = 0.05  # m/s^2
UNKNOWN = 6  # of an image: position, velocity


def begin(
    told: CameraCalibration, seen: Sightings, match: TurningMatch, inertial: Inertial, gravity: float
) -> Estimate:
    """Raises DegenerateGeometry where the corners do not tell how the camera moved."""
    T = told.T_body_cam_matrix
    T[:3, :3] = match.R_body_cam
    camera = msgspec.structs.replace(
        told,
        T_body_cam=tuple(T.ravel().tolist()),
        time_shift_s=match.shift_s - 0.5 * (told.height - 1) * told.line_delay_s,
    )
    t_s = seen.t_s + match.shift_s
    biases = np.zeros((bias_nodes(t_s[-1] - t_s[0]), 6))
    biases[:, :3] = match.gyro_bias
    K, L = len(t_s), seen.num_corners
    steps = [inertial.between(a, b, biases[0]) for a, b in itertools.pairwise(t_s)]
    R, _, _, _ = compose(steps)
    # Unknown: K positions and velocities, gravity (3), accelerometer bias (3); corners are eliminated.
    n = UNKNOWN * K + 6
    T = camera.T_body_cam_matrix
    k, corner = seen.image, seen.corner
    rays = homogeneous(Lens(camera).unproject(seen.uv_px))
    rays = rays @ T[:3, :3].T
    rays = (R[k] @ rays[..., None])[..., 0]
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    sideways = np.swapaxes(across(rays), 1, 2)  # (M, 2, 3)
    arm = (R @ T[:3, 3])[k]
    depth = np.full(len(k), FIRST_DEPTH_M)
    base_H, base_g = _inertial_part(steps, R, n)
    # world: the first position is the origin
    base_H[range(3), range(3)] += 1e8
    base_H[range(n - 3, n), range(n - 3, n)] += 1.0 / SIGMA_BIAS**2
    # Gravity's size along where what was felt points on average, so that not everything shrinks to a point.
    felt = np.sum([r @ step.dv for r, step in zip(R, steps, strict=False)], axis=0)
    down = -felt / np.linalg.norm(felt)
    base_H[n - 6 : n - 3, n - 6 : n - 3] += np.outer(down, down) / SIGMA_GRAVITY**2
    base_g[n - 6 : n - 3] -= gravity * down / SIGMA_GRAVITY**2
    starts = np.searchsorted(corner, np.arange(L + 1))
    for _ in range(ROUNDS):
        J = sideways / (SIGMA_RAY * depth[:, None, None])  # by corner; by position the opposite
        r = -(J @ arm[..., None])[..., 0]
        H, g = base_H.copy(), base_g.copy()
        JJ = np.swapaxes(J, 1, 2) @ J
        Jr = (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
        V = np.add.reduceat(JJ, starts[:-1]) + 1e-9 * np.eye(3)
        gl = np.add.reduceat(Jr, starts[:-1])
        Vi = np.linalg.inv(V)
        for image in range(K):
            mine = k == image
            s = slice(UNKNOWN * image, UNKNOWN * image + 3)
            H[s, s] += JJ[mine].sum(axis=0)
            g[s] -= Jr[mine].sum(axis=0)
        for i in range(L):
            own = slice(starts[i], starts[i + 1])
            columns = (UNKNOWN * k[own][:, None] + np.arange(3)).ravel()
            W = -np.concatenate(list(JJ[own]), axis=1)  # (3, 3 images)
            H[np.ix_(columns, columns)] -= W.T @ Vi[i] @ W
            g[columns] -= W.T @ (Vi[i] @ gl[i])
        try:
            x = np.asarray(-np.linalg.solve(H, g), dtype=np.float64)
        except np.linalg.LinAlgError as exc:
            raise DegenerateGeometry("the corners do not tell how the camera moved") from exc
        p = x[: UNKNOWN * K].reshape(K, UNKNOWN)[:, :3]
        back = np.add.reduceat((JJ @ p[k][..., None])[..., 0], starts[:-1])
        points = (Vi @ (back - gl)[..., None])[..., 0]
        away = points[corner] - p[k] - arm
        ahead = (away * rays).sum(axis=1)
        depth = np.maximum(ahead, NEAREST_M)
    v = x[: UNKNOWN * K].reshape(K, UNKNOWN)[:, 3:]
    biases[:, 3:] = x[-3:]
    fall = x[-6:-3]
    first = starts[:-1]
    anchor = p[k[first]] + arm[first]
    typical = float(np.median(depth))
    distance = (points - anchor) * rays[first]
    distance = distance.sum(axis=1)
    inverse_depth = np.where(distance > NEAREST_M, 1.0 / np.maximum(distance, NEAREST_M), 1.0 / typical)
    return Estimate(
        camera=camera,
        gravity=fall,
        biases=biases,
        t_s=t_s,
        R=R,
        p=p,
        v=v,
        anchor=anchor,
        ray=rays[first],
        inverse_depth=np.clip(inverse_depth, 0.0, MAX_INVERSE_DEPTH),
    )


def _inertial_part(steps: list[Preintegration], R: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    H, g = np.zeros((n, n)), np.zeros(n)
    eye = np.eye(3)
    for i, step in enumerate(steps):
        dt = step.duration_s
        J = np.zeros((6, 18))  # p, v, next p, v, gravity, bias
        J[:3, 0:3], J[:3, 6:9], J[:3, 3:6] = -eye, eye, -dt * eye
        J[:3, 12:15] = -0.5 * dt * dt * eye
        J[:3, 15:] = -R[i] @ step.dp_by_bias[:, 3:]
        J[3:, 3:6], J[3:, 9:12], J[3:, 12:15] = -eye, eye, -dt * eye
        J[3:, 15:] = -R[i] @ step.dv_by_bias[:, 3:]
        r = -np.concatenate([R[i] @ step.dp, R[i] @ step.dv])
        sigma = SIGMA_MOVING * np.repeat([dt**1.5 / 3.0**0.5, dt**0.5], 3)
        J, r = J / sigma[:, None], r / sigma
        at = np.concatenate([UNKNOWN * i + np.arange(12), n - 6 + np.arange(6)])
        H[np.ix_(at, at)] += J.T @ J
        g[at] += J.T @ r
    return H, g
