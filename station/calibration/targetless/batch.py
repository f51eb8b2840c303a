"""The estimate, with wrong sightings left out and the noise as large as it proves to be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray
from station.calibration.camera_imu.unknowns import INTRINSICS
from station.calibration.targetless.adjustment import Linearised, Problem, Progress, assembled, linearised, minimised
from station.calibration.targetless.rows import sighting_rows
from station.calibration.targetless.solver import solved
from station.calibration.targetless.tracks import MIN_SIGHTINGS
from station.calibration.targetless.uncertainty import honest_covariance, noise_of
from station.calibration.targetless.unknowns import STATE, Estimate
from station.vision.lens import BoolArray

ROUNDS = 2
OUTLIER = 4.0  # of the typical distance: farther off, a sighting is left out
LEAST_TYPICAL_PX = 0.1
MAX_BAD_SHARE = 0.3  # of a corner's sightings: more, and it lies on something that moves
SIGMA_FOCAL = 0.05  # of what was told: a lens that was turned, not another one
SIGMA_GYRO_SCALE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    problem: Problem  # with the sightings that were used and the noise that was found
    estimate: Estimate
    covariance: FloatArray  # (border, border): 0 where kept
    has_converged: bool
    left_out: float  # share of the sightings, as too far off
    rms_px: float
    rms_gyro: float
    rms_accel: float
    focal_scale: float  # the focal length that the recording wants, over the told one
    focal_sigma: float

    def sigma(self, columns: slice) -> FloatArray:
        return np.sqrt(np.diag(self.covariance)[columns])


def solve(problem: Problem, start: Estimate, progress: Progress) -> Solution:
    """The most likely motion, scene and calibration, with noise as large as the residuals say."""
    total = len(problem.seen.image)
    now, at, settled = minimised(problem, start, progress)
    for _ in range(ROUNDS):
        problem, now = without_outliers(problem, now)
        sigma_px, scale = noise_of(problem, now, linearised(problem, now))
        problem = replace(problem, sigma_px=sigma_px, noise_scale=scale)
        now, at, settled = minimised(problem, now, progress)
    focal = focal_length(problem, now, at)
    raw = sighting_rows(now, problem.seen, problem.inertial, 1.0).residual
    assert problem.noise_scale is not None
    rate = problem.inertial.noise.rate_hz**0.5
    return Solution(
        problem=problem,
        estimate=now,
        covariance=honest_covariance(problem, now, at),
        has_converged=settled,
        left_out=1.0 - len(problem.seen.image) / total,
        rms_px=float(np.sqrt((raw**2).sum(axis=1).mean())),
        rms_gyro=float(problem.noise_scale[0] * problem.inertial.noise.gyro_density * rate),
        rms_accel=float(problem.noise_scale[1] * problem.inertial.noise.accel_density * rate),
        focal_scale=focal[0],
        focal_sigma=focal[1],
    )


def focal_length(problem: Problem, now: Estimate, at: Linearised) -> tuple[float, float]:
    """Over the told one, by a last step with it left open, and its standard deviation.

    The gyroscope's scale is the measure of it, and 1 % of that is within what such sensors' data sheets allow.
    """
    if problem.known.sigma_intrinsics.any():
        opened = problem
    else:
        opened = with_open_focal_length(problem)
        at = linearised(opened, now)
    num_states = STATE * len(now.t_s)
    system = assembled(opened, now, at, 0.0)
    step = solved(system.H, system.g, opened.free(now.size, num_states), 0.0)[num_states:]
    covariance = honest_covariance(opened, now, at)
    fx = now.camera.fx + step[INTRINSICS.start]
    sigma = np.sqrt(covariance[INTRINSICS.start, INTRINSICS.start]) / problem.known.camera.fx
    return float(fx / problem.known.camera.fx), float(np.hypot(sigma, SIGMA_GYRO_SCALE))


def with_focal_length(solution: Solution, progress: Progress) -> Solution:
    """The estimate with the focal length found as well."""
    return solve(with_open_focal_length(solution.problem), solution.estimate, progress)


def with_open_focal_length(problem: Problem) -> Problem:
    sigma = np.array([SIGMA_FOCAL * problem.known.camera.fx] * 2 + [0.0] * 6)
    return replace(problem, known=replace(problem.known, sigma_intrinsics=sigma))


def without_outliers(problem: Problem, now: Estimate) -> tuple[Problem, Estimate]:
    """Without the sightings that lie too far off, and corners that are then seen too seldom or behind the camera."""
    raw = np.linalg.norm(sighting_rows(now, problem.seen, problem.inertial, 1.0).residual, axis=1)
    typical = float(np.median(raw)) / 1.1774  # of a Rayleigh distribution
    good: BoolArray = raw < OUTLIER * max(typical, LEAST_TYPICAL_PX)
    seen = problem.seen
    bad_of_corner = np.bincount(seen.corner, ~good, minlength=seen.num_corners)
    all_of_corner = np.bincount(seen.corner, minlength=seen.num_corners)
    good &= (bad_of_corner < MAX_BAD_SHARE * all_of_corner)[seen.corner]
    kept = seen.chosen(good)
    often = np.flatnonzero(np.bincount(seen.corner[good], minlength=seen.num_corners) >= MIN_SIGHTINGS)
    return replace(problem, seen=kept), now.of_corners(often)
