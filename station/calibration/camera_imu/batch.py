"""The batch estimate: every corner, every inertial sample, one motion, one calibration (docs/calibration.md).

Gauss-Newton over a motion in continuous time, so that the gyroscope, the accelerometer and each row of a rolling
shutter are compared with it at their own times, and the time between the clocks is an unknown like any other.
Source: Furgale, Rehder and Siegwart, IROS 2013; rolling shutter: Oth et al., CVPR 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from shared.calibration import CameraCalibration, ImuNoise
from shared.geometry import FloatArray, IntArray
from station.calibration.camera_imu.arrowhead import (
    Elimination,
    NormalEquations,
    cluster_scores,
    eliminate_knots,
    normal_equations,
)
from station.calibration.camera_imu.rows import (
    Corners,
    Rows,
    Samples,
    camera_rows,
    inertial_rows,
    row_times,
)
from station.calibration.camera_imu.spline import ORDER, motion_through
from station.calibration.camera_imu.start import CameraPoses, TurningMatch
from station.calibration.camera_imu.unknowns import (
    BEND,
    BIAS_EVERY_S,
    BIASES,
    DELAY,
    GRAVITY,
    INTRINSICS,
    SCALE,
    Unknowns,
    bias_nodes,
    intrinsics_of,
)

SAMPLES_PER_KNOT = (4, 2)  # the second where the first cannot follow the motion
MARGIN_S = 0.1  # of motion before the first and after the last image: the time shift moves these meanwhile
HUBER = 3.0  # sigmas of a corner: beyond, it counts less
DAMPING = 1e-9
MAX_ITERATIONS = 25
CONVERGED = 1e-2  # sigmas: no unknown of the calibration moves more
CLUSTER_S = 0.5  # residuals nearer to each other than that may be alike
# Gravity differs by 0.026 m/s^2 from pole to equator, a consumer accelerometer's scale by half a percent.
SIGMA_GRAVITY = 0.05
SIGMA_FIRST_BIAS = np.repeat([0.2, 1.0], 3)  # rad/s, m/s^2: more than a consumer IMU's
SIGMA_DELAY_S = 1e-4  # rows are read within 50 ms at the slowest: keeps finite what no motion shows

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What was recorded and what is known beforehand."""

    corners: Corners
    samples: Samples
    noise: ImuNoise
    gravity: float  # m/s^2
    told: CameraCalibration
    sigma_intrinsics: FloatArray  # (8,) of what is told; 0: kept


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How well the motion explains what was measured, each a standard deviation of one number."""

    corner_px: float
    gyro: float  # rad/s
    accel: float  # m/s^2


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    problem: Problem  # with the noise that the residuals have
    unknowns: Unknowns
    free: IntArray  # (f,) columns of the border that were found
    covariance: FloatArray  # (f, f)
    fit: Fit
    corner_residuals_px: FloatArray  # (M, 2) of the corners within the motion
    corners: Corners  # those
    has_converged: bool

    def sigma(self, columns: slice) -> FloatArray:
        """Standard deviations of columns of the border that are free."""
        at = np.searchsorted(self.free, np.arange(columns.start, columns.stop))
        return np.sqrt(np.diag(self.covariance)[at])


def start_unknowns(problem: Problem, poses: CameraPoses, match: TurningMatch, samples_per_knot: int) -> Unknowns:
    """The camera's own poses as the body's motion, at the time shift at which both turn alike."""
    t_s = poses.t_s + match.shift_s
    R = poses.T_target_cam[:, :3, :3] @ match.R_body_cam.T
    imu = problem.samples
    begin, end = max(t_s[0] - MARGIN_S, imu.t_s[0]), min(t_s[-1] + MARGIN_S, imu.t_s[-1])
    motion = motion_through(t_s, R, poses.T_target_cam[:, :3, 3], begin, end, samples_per_knot * imu.interval_s)
    inside = (imu.t_s > t_s[0]) & (imu.t_s < t_s[-1])
    turned = motion.orientations(motion.weights(imu.t_s[inside])).R
    up = (turned @ imu.accel[inside][..., None])[..., 0].mean(axis=0)  # what moves it averages out
    biases = np.zeros((bias_nodes(motion.end_s - motion.start_s), 6))
    biases[:, :3] = match.gyro_bias
    T_body_cam = np.eye(4)
    T_body_cam[:3, :3] = match.R_body_cam
    told = problem.told
    camera = msgspec.structs.replace(
        told,
        T_body_cam=tuple(T_body_cam.ravel().tolist()),
        time_shift_s=match.shift_s - 0.5 * (told.height - 1) * told.line_delay_s,
    )
    return Unknowns(motion, camera, -problem.gravity * up / np.linalg.norm(up), biases)


def solve(problem: Problem, start: Unknowns, progress: Progress, free_target: bool = False) -> Solution:
    """The most likely motion and calibration, with noise as large as the residuals say.

    Args:
        free_target: the target's scale and bend are found as well.
    Raises:
        DegenerateGeometry: the measurements leave the motion or the calibration open.
    """
    unknowns, _ = _iterate(problem, start, free_target, progress)
    problem = with_noise_of(problem, unknowns)
    unknowns, has_converged = _iterate(problem, unknowns, free_target, progress)
    free = free_columns(problem, unknowns, free_target)
    blocks, equations = linearise(problem, unknowns)
    left = eliminate_knots(equations, free, DAMPING)
    seen = within(problem.corners, unknowns)
    residuals = camera_rows(unknowns, seen).residual * seen.sigma_px
    covariance = honest_covariance(blocks, left, unknowns)
    return Solution(
        problem, unknowns, free, covariance, fit_of(problem, unknowns, blocks), residuals, seen, has_converged
    )


def _iterate(problem: Problem, start: Unknowns, free_target: bool, progress: Progress) -> tuple[Unknowns, bool]:
    """Gauss-Newton steps, and whether they ended by themselves."""
    unknowns, free = start, free_columns(problem, start, free_target)
    for iteration in range(MAX_ITERATIONS):
        progress(f"estimating, step {iteration + 1}")
        _, equations = linearise(problem, unknowns)
        left = eliminate_knots(equations, free, DAMPING)
        knots, border = left.step(unknowns.size)
        unknowns = unknowns.moved(knots, border)
        sigma = np.sqrt(np.diag(np.linalg.inv(left.information)))
        if float(np.abs(border[free] / sigma).max()) < CONVERGED:
            return unknowns, True
    return unknowns, False


def refined_knots(unknowns: Unknowns, spacing_s: float) -> Unknowns:
    """The same with knots at another distance."""
    motion = unknowns.motion
    t_s = np.arange(motion.start_s, motion.end_s, 0.5 * spacing_s)
    weights = motion.weights(t_s)
    turned = motion.orientations(weights)
    finer = motion_through(t_s, turned.R, motion.positions(weights)[0], motion.start_s, motion.end_s, spacing_s)
    return replace(unknowns, motion=finer)


def within(corners: Corners, unknowns: Unknowns) -> Corners:
    """Those whose rows were exposed while the motion is modelled."""
    t = row_times(unknowns, corners)
    return corners.chosen((t >= unknowns.motion.start_s) & (t <= unknowns.motion.end_s))


def linearise(problem: Problem, unknowns: Unknowns) -> tuple[list[Rows], NormalEquations]:
    """Corners and inertial samples, weighted, and what they and the priors say together."""
    seen = camera_rows(unknowns, within(problem.corners, unknowns))
    size = np.linalg.norm(seen.residual, axis=1)
    seen = seen.weighted(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))
    motion = unknowns.motion
    felt = inertial_rows(unknowns, problem.samples.between(motion.start_s, motion.end_s))
    equations = normal_equations([seen, felt], motion.num_segments, unknowns.size)
    add_priors(equations, problem, unknowns)
    return [seen, felt], equations


def add_priors(equations: NormalEquations, problem: Problem, unknowns: Unknowns) -> None:
    """The known size of gravity, the intrinsics and line delay that were told, and biases that walk slowly."""
    size = float(np.linalg.norm(unknowns.gravity))
    equations.add(
        np.arange(GRAVITY.start, GRAVITY.stop),
        np.array([(size - problem.gravity) / SIGMA_GRAVITY]),
        unknowns.gravity[None] / (size * SIGMA_GRAVITY),
    )
    known = problem.sigma_intrinsics > 0
    sigma = problem.sigma_intrinsics[known]
    away = (intrinsics_of(unknowns.camera) - intrinsics_of(problem.told))[known]
    equations.add(np.arange(INTRINSICS.start, INTRINSICS.stop)[known], away / sigma, np.diag(1.0 / sigma))
    slower = unknowns.camera.line_delay_s - problem.told.line_delay_s
    equations.add(np.array([DELAY]), np.array([slower / SIGMA_DELAY_S]), np.array([[1.0 / SIGMA_DELAY_S]]))
    equations.add(BIASES + np.arange(6), unknowns.biases[0] / SIGMA_FIRST_BIAS, np.diag(1.0 / SIGMA_FIRST_BIAS))
    walk = np.repeat([problem.noise.gyro_walk, problem.noise.accel_walk], 3) * np.sqrt(BIAS_EVERY_S)
    J = np.hstack([-np.diag(1.0 / walk), np.diag(1.0 / walk)])
    for node, step in enumerate(np.diff(unknowns.biases, axis=0)):
        equations.add(BIASES + 6 * node + np.arange(12), step / walk, J)


def free_columns(problem: Problem, unknowns: Unknowns, free_target: bool) -> IntArray:
    free = np.ones(unknowns.size, dtype=bool)
    free[SCALE] = free[BEND] = free_target
    free[INTRINSICS] = problem.sigma_intrinsics > 0
    return np.flatnonzero(free)


def with_noise_of(problem: Problem, unknowns: Unknowns) -> Problem:
    """With the noise that the residuals have: a sensor on a hand-held robot is noisier than on the bench."""
    blocks, _ = linearise(problem, unknowns)
    fit = fit_of(problem, unknowns, blocks)
    samples = replace(problem.samples, sigma_gyro=fit.gyro, sigma_accel=fit.accel)
    return replace(problem, corners=replace(problem.corners, sigma_px=fit.corner_px), samples=samples)


def fit_of(problem: Problem, unknowns: Unknowns, blocks: list[Rows]) -> Fit:
    """From the residuals, and from how many of them the motion's knots could take up.

    A kind of measurement has as many degrees of freedom as numbers, less its share of the trace of the hat matrix;
    the images know little of the motion between them, so that nearly all of the knots are the IMU's.
    """
    seen, felt = blocks
    knots = 3 * (unknowns.motion.num_segments + ORDER - 1)
    free = max(felt.residual[:, :3].size - knots, 0.25 * felt.residual[:, :3].size)
    gyro, accel = (np.sqrt((felt.residual[:, at] ** 2).sum() / free) for at in (slice(0, 3), slice(3, 6)))
    imu = problem.samples
    corner = np.sqrt((seen.residual**2).mean())
    return Fit(corner * problem.corners.sigma_px, float(gyro * imu.sigma_gyro), float(accel * imu.sigma_accel))


def honest_covariance(blocks: list[Rows], left: Elimination, unknowns: Unknowns) -> FloatArray:
    """(f, f) of the free columns: from independent noise, or from the residuals' own scatter where that is more.

    Corners of one image err alike (blur, focus, the lens model), and neighbouring samples do (vibration). So the
    residuals' gradients are summed over CLUSTER_S, and their scatter is carried through the estimate.
    Source: Liang and Zeger, Biometrika 73(1), 1986 (the "sandwich").
    """
    independent = np.linalg.inv(left.information)
    clusters = max(1, round(CLUSTER_S / unknowns.motion.spacing_s))
    scores = cluster_scores(blocks, left, clusters, unknowns.size)
    alike = independent @ (scores.T @ scores) @ independent
    larger = np.sqrt(np.maximum(np.diag(alike) / np.diag(independent), 1.0))
    return np.asarray(larger[:, None] * independent * larger)
