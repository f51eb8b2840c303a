"""How sure the estimate is: noise from the residuals, and residuals that are alike counted as one."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from shared.geometry import FloatArray
from station.calibration.camera_imu.scatter import summed_by, widening
from station.calibration.camera_imu.unknowns import BIASES, DELAY, GRAVITY, MOUNT_POSITION, MOUNT_ROTATION, SHIFT
from station.calibration.targetless.adjustment import Linearised, Problem, assembled
from station.calibration.targetless.unknowns import STATE, Estimate

CLUSTER_S = 0.5
# What stays however long the recording: row times within a picture, clocks, an IMU's axes (as with a target).
FLOOR_ROTATION, FLOOR_POSITION_M, FLOOR_SHIFT_S, FLOOR_DELAY_S = np.radians(0.05), 2e-3, 1e-4, 3e-7


def noise_of(problem: Problem, now: Estimate, at: Linearised) -> tuple[float, FloatArray]:
    """Standard deviation of a pixel coordinate, and by how much the IMU's noise is larger than known, turning, moving.

    Each kind of measurement has as many degrees of freedom as numbers, less its share of the trace of the hat matrix.
    Source: Foerstner and Wrobel, Photogrammetric Computer Vision, 2016, sec. 4.2.4 (variance components).
    """
    num_states = STATE * len(now.t_s)
    system = assembled(problem, now, at, 0.0)
    free = problem.free(now.size, num_states)
    C = np.zeros_like(system.H)
    C[np.ix_(free, free)] = cho_solve(
        cho_factor(system.H[np.ix_(free, free)], check_finite=False), np.eye(len(free)), check_finite=False
    )
    felt = at.felt
    used = np.zeros(2)
    gravity = num_states + np.arange(GRAVITY.start, GRAVITY.stop)
    for k, (J, by_g, by_b, node) in enumerate(
        zip(felt.by_states, felt.by_gravity, felt.by_bias, felt.node, strict=True)
    ):
        columns = np.concatenate(
            [STATE * k + np.arange(2 * STATE), gravity, num_states + BIASES + 6 * node + np.arange(12)]
        )
        A = np.concatenate([J, by_g, by_b], axis=1)
        share = np.einsum("ij,jk,ik->i", A, C[np.ix_(columns, columns)], A)
        used += [share[:3].sum(), share[3:].sum()]
    K = len(felt.residual)
    squares = np.array([(felt.residual[:, :3] ** 2).sum(), (felt.residual[:, 3:] ** 2).sum()])
    numbers = np.array([3 * K, 6 * K])
    before = np.ones(2) if problem.noise_scale is None else problem.noise_scale
    scale = before * np.sqrt(squares / np.maximum(numbers - used, 0.1 * numbers))
    M, L = len(problem.seen.image), problem.seen.num_corners
    spent = 3 * L + max(len(free) - used.sum(), 0.0)
    pixel = problem.sigma_px * np.sqrt((at.sighted.residual**2).sum() / max(2 * M - spent, 0.2 * 2 * M))
    return float(pixel), np.maximum(scale, 0.3)


def honest_covariance(problem: Problem, now: Estimate, at: Linearised) -> FloatArray:
    """(border, border): from independent noise, or from the residuals' own scatter where that is more.

    Residuals are alike within CLUSTER_S and of one corner.
    """
    num_states = STATE * len(now.t_s)
    system = assembled(problem, now, at, 0.0)
    free = problem.free(now.size, num_states)
    border = free[free >= num_states]
    A = np.zeros((now.border, now.size))  # rows of the inverse
    right = np.zeros((len(free), len(border)))
    right[np.searchsorted(free, border), np.arange(len(border))] = 1.0
    factor = cho_factor(system.H[np.ix_(free, free)], check_finite=False)
    A[np.ix_(border - num_states, free)] = cho_solve(factor, right, check_finite=False).T
    independent = A[:, num_states:]
    seen, sighted = problem.seen, at.sighted
    r = sighted.residual
    A_states = A[:, :num_states].reshape(now.border, -1, STATE)
    A_border = A[:, num_states : num_states + BIASES]
    # of the corners: they follow the rest
    A_points = np.empty((seen.num_corners, now.border, 3))
    for i, (first, images, by) in enumerate(zip(system.first, system.num_images, system.by_states, strict=True)):
        follows = A[:, STATE * first : STATE * (first + images)] @ by.T + A_border @ system.by_border[i].T
        A_points[i] = -follows @ system.inverse[i]
    g_state = (np.swapaxes(sighted.by_state, 1, 2) @ r[..., None])[..., 0]
    g_border = (np.swapaxes(sighted.by_border, 1, 2) @ r[..., None])[..., 0]
    g_point = (np.swapaxes(sighted.by_point, 1, 2) @ r[..., None])[..., 0]
    from_seen = np.einsum("bms,ms->mb", A_states[:, seen.image], g_state) + g_border @ A_border.T
    from_seen += np.einsum("mbp,mp->mb", A_points[seen.corner], g_point)
    felt = at.felt
    K = len(felt.residual)
    from_felt = np.zeros((K, now.border))
    for k in range(K):
        gs = felt.by_states[k].T @ felt.residual[k]
        gb = felt.by_bias[k].T @ felt.residual[k]
        gg = felt.by_gravity[k].T @ felt.residual[k]
        b = num_states + BIASES + 6 * felt.node[k]
        from_felt[k] = A[:, STATE * k : STATE * (k + 2)] @ gs + A[:, b : b + 12] @ gb
        from_felt[k] += A[:, num_states + GRAVITY.start : num_states + GRAVITY.stop] @ gg
    begin = now.t_s[0]
    in_time = ((now.t_s - begin) / CLUSTER_S).astype(np.int64)
    alike = [
        summed_by(np.concatenate([from_seen, from_felt]), np.concatenate([in_time[seen.image], in_time[:-1]])),
        np.concatenate([summed_by(from_seen, seen.corner), from_felt]),
    ]
    larger = widening(independent, alike)
    found = larger[:, None] * independent * larger
    floor = np.zeros(now.border)
    floor[MOUNT_ROTATION], floor[MOUNT_POSITION] = FLOOR_ROTATION, FLOOR_POSITION_M
    floor[SHIFT], floor[DELAY] = FLOOR_SHIFT_S, FLOOR_DELAY_S
    found[np.diag_indices_from(found)] += np.where(np.diag(independent) > 0, floor**2, 0.0)
    return np.asarray(found)
