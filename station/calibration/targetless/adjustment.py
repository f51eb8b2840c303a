"""Least squares over every corner of the scene, every inertial sample and one calibration (docs/calibration.md).

Levenberg and Marquardt's method over the states at the images, linked by preintegrated readings. The states' times move
with the time shift: after each step they are carried to where the new one puts the images, and the readings are
integrated between these anew.
Source: Forster et al., IEEE T-RO 33(1), 2017; time shift: Li and Mourikis, IJRR 33(7), 2014.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, IntArray, so3_log
from station.calibration.camera_imu.priors import Known, Prior, columns_of, scalar_prior
from station.calibration.camera_imu.unknowns import BEND, INTRINSICS, MOUNT_POSITION, MOUNT_ROTATION, SCALE, SHIFT
from station.calibration.targetless.rows import (
    Inertial,
    InertialRows,
    SightingRows,
    carried,
    inertial_rows,
    sighting_rows,
)
from station.calibration.targetless.solver import Equations, equations, solved
from station.calibration.targetless.tracks import Sightings
from station.calibration.targetless.unknowns import STATE, Estimate

START_SIGMA_PX = 1.0
CAUCHY = 2.5  # sigmas: beyond, a sighting counts less and less
MAX_ITERATIONS = 40
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e6
CONVERGED = 1e-4  # share of the cost by which a step still lowers it
# What is known beforehand is weaker than any recording worth using: it keeps finite what no motion shows.
SIGMA_ROTATION, SIGMA_POSITION_M, SIGMA_SHIFT_S = 0.5, 0.3, 0.2
SIGMA_FRAME = 1e-3  # rad, m: of the first image's pose, which is the world's origin

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What was recorded and what is known beforehand."""

    seen: Sightings
    inertial: Inertial
    known: Known
    sigma_px: float = START_SIGMA_PX
    noise_scale: FloatArray | None = None  # (2,): of turning, of moving, over what the noise that was told means

    def free(self, size: int, num_states: int) -> IntArray:
        """Columns of states and border that are found."""
        free = np.ones(size, dtype=bool)
        border = free[num_states:]
        border[SCALE] = border[BEND] = False
        border[INTRINSICS] = self.known.sigma_intrinsics > 0
        return np.flatnonzero(free)


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Residuals and derivatives at an estimate, sightings weighted."""

    sighted: SightingRows
    felt: InertialRows
    priors: list[Prior]
    cost: float


def linearised(problem: Problem, now: Estimate) -> Linearised:
    sighted = sighting_rows(now, problem.seen, problem.inertial, problem.sigma_px)
    square = (sighted.residual**2).sum(axis=1) / CAUCHY**2
    root = np.sqrt(1.0 / (1.0 + square))
    scale = np.ones(2) if problem.noise_scale is None else problem.noise_scale
    felt = inertial_rows(now, problem.inertial, scale)
    priors = known_before(problem, now)
    cost = CAUCHY**2 * np.log1p(square).sum() + (felt.residual**2).sum() + sum((p.residual**2).sum() for p in priors)
    weighted = SightingRows(
        sighted.residual * root[:, None],
        *(J * root[:, None, None] for J in (sighted.by_state, sighted.by_border, sighted.by_point)),
    )
    return Linearised(weighted, felt, priors, float(cost))


def known_before(problem: Problem, now: Estimate) -> list[Prior]:
    """Of the border; of how the camera sits, and of the time shift, next to nothing."""
    told, T, T_told = problem.known.camera, now.camera.T_body_cam_matrix, problem.known.camera.T_body_cam_matrix
    turned = so3_log(T_told[:3, :3].T @ T[:3, :3])
    return [
        *problem.known.priors(now.camera, now.gravity, now.biases),
        Prior(columns_of(MOUNT_ROTATION), turned / SIGMA_ROTATION, np.eye(3) / SIGMA_ROTATION),
        Prior(columns_of(MOUNT_POSITION), (T[:3, 3] - T_told[:3, 3]) / SIGMA_POSITION_M, np.eye(3) / SIGMA_POSITION_M),
        scalar_prior(np.array([SHIFT]), now.camera.time_shift_s - told.time_shift_s, np.eye(1), SIGMA_SHIFT_S),
    ]


def assembled(problem: Problem, now: Estimate, at: Linearised, damping: float) -> Equations:
    num_states = STATE * len(now.t_s)
    found = equations(problem.seen, at.sighted, at.felt, at.priors, num_states, now.border, damping)
    pose = np.arange(6)
    found.H[pose, pose] += 1.0 / SIGMA_FRAME**2  # the frame is where the first image is: no residual
    return found


def minimised(problem: Problem, start: Estimate, progress: Progress) -> tuple[Estimate, Linearised, bool]:
    """The most likely estimate near the start; whether it settled."""
    now, damping = start, FIRST_DAMPING
    at = linearised(problem, now)
    num_states = STATE * len(now.t_s)
    free = problem.free(now.size, num_states)
    for _ in range(MAX_ITERATIONS):
        progress("estimating")
        system = assembled(problem, now, at, damping)
        dx = solved(system.H, system.g, free, damping)
        tried = now.moved(dx[:num_states].reshape(-1, STATE), dx[num_states:], system.points(dx, num_states))
        t_s = problem.seen.t_s + tried.camera.middle_row_shift_s
        tried = carried(replace(tried, t_s=now.t_s), t_s, problem.inertial)
        tried_at = linearised(problem, tried)
        gained = at.cost - tried_at.cost
        if gained <= 0 or not np.isfinite(tried_at.cost):
            damping *= 10.0
            if damping > MOST_DAMPING:
                return now, at, False
            if abs(gained) < CONVERGED * at.cost and damping > 1e-2:
                return now, at, True
            continue
        now, at, damping = tried, tried_at, max(0.1 * damping, LEAST_DAMPING)
        if gained < CONVERGED * at.cost:
            return now, at, True
    return now, at, False
