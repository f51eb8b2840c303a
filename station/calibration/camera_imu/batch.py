"""The batch estimate: every corner, every inertial sample, one motion, one calibration (docs/calibration.md).

Gauss-Newton over a motion in continuous time, so that the gyroscope, the accelerometer and each row of a rolling
shutter are compared with it at their own times, and the time between the clocks is an unknown like any other.
Source: Furgale, Rehder and Siegwart, IROS 2013; rolling shutter: Oth et al., CVPR 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from shared.geometry import FloatArray, IntArray
from station.calibration.camera_imu.arrowhead import (
    Elimination,
    NormalEquations,
    eliminate_knots,
    normal_equations,
    scores,
)
from station.calibration.camera_imu.priors import Known
from station.calibration.camera_imu.rows import (
    Corners,
    Rows,
    Samples,
    camera_rows,
    inertial_rows,
    joined,
    row_times,
)
from station.calibration.camera_imu.scatter import summed_by, widening
from station.calibration.camera_imu.spline import ORDER, motion_through
from station.calibration.camera_imu.start import CameraPoses, TurningMatch
from station.calibration.camera_imu.unknowns import (
    BEND,
    INTRINSICS,
    SCALE,
    Unknowns,
    bias_nodes,
)

SAMPLES_PER_KNOT = 2.0  # of the IMU: follows all that it can see
MIN_SPACING_S = 0.01  # a hand trembles at up to 12 Hz
MARGIN_S = 0.1  # of motion before the first and after the last image: the time shift moves these meanwhile
HUBER = 3.0  # sigmas of a corner: beyond, it counts less
OUTLIER = 5.0  # sigmas of a corner: farther off, it is left out
DAMPING = 1e-9
MAX_ITERATIONS = 25
CORES = 2  # the corners are shared out among so many
ROUGHLY, CONVERGED = 0.3, 0.02  # sigmas: no unknown of the calibration moves more
ROUGH_SHARE = 5  # of the corners one is enough to come near; a tag has four, so that all places of a tag are met
CLUSTER_S = 0.5  # residuals nearer to each other than that may be alike
IMAGE_PARTS = 8  # in each direction, in which they may be alike as well

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What was recorded and what is known beforehand."""

    corners: Corners
    samples: Samples
    known: Known


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How well the motion explains what was measured: the standard deviation of one number, by which it is weighted."""

    corner_px: float
    gyro: float  # rad/s
    accel: float  # m/s^2


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Residuals and equations are those before the last step, which was a small part of a sigma."""

    problem: Problem
    unknowns: Unknowns
    corners: Corners  # those within the motion
    blocks: list[Rows]  # corners, inertial samples
    equations: NormalEquations
    free: IntArray  # (f,) columns of the border that were found
    covariance: FloatArray  # (f, f)
    fit: Fit
    has_converged: bool
    left_out: float = 0.0  # share of the corners, as too far off

    @property
    def rms_px(self) -> float:
        """Of the distances by which the corners that are used lie beside where they should, as of a camera's lens."""
        away = camera_rows(self.unknowns, within(self.corners, self.unknowns)).residual * self.corners.sigma_px
        return float(np.sqrt((away**2).sum(axis=1).mean()))

    @property
    def worst_moment(self) -> tuple[float, float]:
        """When (s, IMU clock) the residuals were largest for CLUSTER_S, and how many times their usual size."""
        worst = (0.0, 0.0)
        for block, times in zip(self.blocks, clusters_in_time(self.blocks, self.unknowns), strict=True):
            squares = (block.residual**2).mean(axis=1)
            rms = np.sqrt(np.bincount(times, squares) / np.maximum(np.bincount(times), 1))
            ratio = float(rms.max() / np.median(rms[rms > 0]))
            worst = max(worst, (ratio, self.unknowns.motion.start_s + (int(rms.argmax()) + 0.5) * CLUSTER_S))
        return worst[1], worst[0]

    def sigma(self, columns: slice) -> FloatArray:
        """Standard deviations of columns of the border that are free."""
        at = np.searchsorted(self.free, np.arange(columns.start, columns.stop))
        return np.sqrt(np.diag(self.covariance)[at])


def start_unknowns(problem: Problem, poses: CameraPoses, match: TurningMatch) -> Unknowns:
    """The camera's own poses as the body's motion, at the time shift at which both turn alike."""
    t_s = poses.t_s + match.shift_s
    R = poses.T_target_cam[:, :3, :3] @ match.R_body_cam.T
    imu = problem.samples
    begin, end = max(t_s[0] - MARGIN_S, imu.t_s[0]), min(t_s[-1] + MARGIN_S, imu.t_s[-1])
    spacing = max(SAMPLES_PER_KNOT * imu.interval_s, MIN_SPACING_S)
    motion = motion_through(t_s, R, poses.T_target_cam[:, :3, 3], begin, end, spacing)
    inside = (imu.t_s > t_s[0]) & (imu.t_s < t_s[-1])
    turned = motion.orientations(motion.weights(imu.t_s[inside])).R
    up = (turned @ imu.accel[inside][..., None])[..., 0].mean(axis=0)  # what moves it averages out
    biases = np.zeros((bias_nodes(motion.end_s - motion.start_s), 6))
    biases[:, :3] = match.gyro_bias
    T_body_cam = np.eye(4)
    T_body_cam[:3, :3] = match.R_body_cam
    told = problem.known.camera
    camera = msgspec.structs.replace(
        told,
        T_body_cam=tuple(T_body_cam.ravel().tolist()),
        time_shift_s=match.shift_s - 0.5 * (told.height - 1) * told.line_delay_s,
    )
    return Unknowns(motion, camera, -problem.known.gravity * up / np.linalg.norm(up), biases)


def solve(problem: Problem, start: Unknowns, progress: Progress, free_target: bool = False) -> Solution:
    """The most likely motion and calibration, with noise as large as the residuals say.

    Args:
        free_target: the target's scale and bend are found as well.
    Raises:
        DegenerateGeometry: the measurements leave the motion or the calibration open.
    """
    every = np.arange(len(problem.corners.ids)) % ROUGH_SHARE == 0
    rough = _iterate(replace(problem, corners=problem.corners.chosen(every)), start, ROUGHLY, free_target, progress)
    seen = within(replace(problem.corners, sigma_px=rough.fit.corner_px), rough.unknowns)
    is_used = np.linalg.norm(camera_rows(rough.unknowns, seen).residual, axis=1) < OUTLIER
    problem = replace(
        problem,
        corners=seen.chosen(is_used),
        samples=replace(problem.samples, sigma_gyro=rough.fit.gyro, sigma_accel=rough.fit.accel),
    )
    found = _iterate(problem, rough.unknowns, CONVERGED, free_target, progress)
    return replace(found, left_out=float(1.0 - is_used.mean()))


def _iterate(problem: Problem, start: Unknowns, tolerance: float, free_target: bool, progress: Progress) -> Solution:
    """Gauss-Newton steps until none of the calibration moves by more than so many of its sigmas."""
    unknowns, free = start, free_columns(problem, start, free_target)
    for _ in range(MAX_ITERATIONS):
        progress("estimating")
        corners = within(problem.corners, unknowns)
        blocks, equations = linearise(problem, unknowns, corners)
        left = eliminate_knots(equations, free, DAMPING)
        knots, border = left.step(unknowns.size)
        unknowns = unknowns.moved(knots, border)
        sigma = np.sqrt(np.diag(np.linalg.inv(left.information)))
        has_converged = float(np.abs(border[free] / sigma).max()) < tolerance
        if has_converged:
            break
    return Solution(
        problem=problem,
        unknowns=unknowns,
        corners=corners,
        blocks=blocks,
        equations=equations,
        free=free,
        covariance=honest_covariance(corners, blocks, left, unknowns),
        fit=fit_of(problem, unknowns, blocks),
        has_converged=has_converged,
    )


@dataclass(frozen=True, slots=True, eq=False)
class TargetShape:
    """How the target differs from its file, if it may: a last step with that left open."""

    scale: float  # of its lengths
    bend_m: FloatArray  # (3,) as Unknowns.bend
    sigma_scale: float
    sigma_bend_m: FloatArray  # (3,)


def target_shape(solution: Solution) -> TargetShape:
    unknowns = solution.unknowns
    free = free_columns(solution.problem, unknowns, free_target=True)
    left = eliminate_knots(solution.equations, free, DAMPING)
    _, border = left.step(unknowns.size)
    sigma = np.zeros(unknowns.size)
    sigma[free] = np.sqrt(np.diag(honest_covariance(solution.corners, solution.blocks, left, unknowns)))
    return TargetShape(
        unknowns.scale + float(border[SCALE]), unknowns.bend + border[BEND], float(sigma[SCALE]), sigma[BEND]
    )


def within(corners: Corners, unknowns: Unknowns) -> Corners:
    """Those whose rows were exposed while the motion is modelled."""
    t = row_times(unknowns, corners)
    return corners.chosen((t >= unknowns.motion.start_s) & (t <= unknowns.motion.end_s))


def linearise(problem: Problem, unknowns: Unknowns, corners: Corners) -> tuple[list[Rows], NormalEquations]:
    """Corners and inertial samples, weighted, and what they and the priors say together."""
    motion = unknowns.motion
    own = np.array_split(np.arange(len(corners.ids)), CORES)

    def see(part: int) -> tuple[Rows, NormalEquations]:
        rows = camera_rows(unknowns, corners.chosen(own[part]))
        size = np.linalg.norm(rows.residual, axis=1)
        rows = rows.weighted(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))
        return rows, normal_equations([rows], motion.num_segments, unknowns.size)

    with ThreadPoolExecutor(CORES) as pool:  # NumPy computes outside Python's lock
        seeing = pool.map(see, range(CORES))
        felt = inertial_rows(unknowns, problem.samples.between(motion.start_s, motion.end_s))
        unseen = inertial_rows(unknowns, problem.samples.interpolated(silent_times(unknowns, felt)))
        equations = normal_equations([felt, unseen], motion.num_segments, unknowns.size)
        parts, of_parts = zip(*seeing, strict=True)
    for part in of_parts:
        equations.add(part)
    for prior in problem.known.priors(unknowns.camera, unknowns.gravity, unknowns.biases):
        equations.add_prior(prior)
    return [joined(parts), felt], equations


def silent_times(unknowns: Unknowns, felt: Rows) -> FloatArray:
    """(N,) s: the middles of the motion's segments that have no inertial sample: their knots may lack rows too."""
    motion = unknowns.motion
    silent = np.setdiff1d(np.arange(motion.num_segments), felt.segment)
    return np.asarray(motion.start_s + motion.spacing_s * (silent + 0.5))


def free_columns(problem: Problem, unknowns: Unknowns, free_target: bool) -> IntArray:
    free = np.ones(unknowns.size, dtype=bool)
    free[SCALE] = free[BEND] = free_target
    free[INTRINSICS] = problem.known.sigma_intrinsics > 0
    return np.flatnonzero(free)


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


def honest_covariance(corners: Corners, blocks: list[Rows], left: Elimination, unknowns: Unknowns) -> FloatArray:
    """(f, f) of the free columns: from independent noise, or from the residuals' own scatter where that is more.

    Residuals are alike within CLUSTER_S (blur, vibration), at one corner of the target (print, lighting) and in one
    part of the image (the lens model).
    """
    independent: FloatArray = np.asarray(np.linalg.inv(left.information), dtype=np.float64)
    seen, felt = (scores(block, left, unknowns.size) for block in blocks)
    times = clusters_in_time(blocks, unknowns)
    camera = unknowns.camera
    column, row = (corners.uv_px * IMAGE_PARTS / [camera.width, camera.height]).astype(np.int64).T
    alike = [
        summed_by(np.concatenate([seen, felt]), np.concatenate(times)),
        summed_by(seen, corners.ids),
        summed_by(seen, np.maximum(row, 0) * IMAGE_PARTS + np.clip(column, 0, IMAGE_PARTS - 1)),
    ]
    larger = widening(independent, [gradients @ independent for gradients in alike])
    return np.asarray(larger[:, None] * independent * larger)


def clusters_in_time(blocks: list[Rows], unknowns: Unknowns) -> list[IntArray]:
    """Of each block's measurements, the CLUSTER_S in which they were made."""
    per_cluster = max(1, round(CLUSTER_S / unknowns.motion.spacing_s))
    last = max(1, unknowns.motion.num_segments // per_cluster) - 1
    return [np.minimum(block.segment // per_cluster, last) for block in blocks]
