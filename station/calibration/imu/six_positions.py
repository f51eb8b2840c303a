"""Scale, misalignment and bias of an accelerometer from rests on its different sides: each must read gravity's length.

Source: Tedaldi, Pretto, Menegatti, A robust and easy to implement method for IMU calibration without external
equipments, ICRA 2014, eqs. 2, 5 and 9. Beyond it: what is known beforehand of such sensors takes part in the least
squares, so that six rests suffice for scale and bias (nine unknowns need nine rests), and the residuals' covariance
holds the bias' random walk between the rests, which outweighs the white noise of their means.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from shared.calibration import AccelerometerCalibration, upper_triangular
from shared.geometry import FloatArray
from station.calibration.imu.still import EvenSamples

MIN_ORIENTATIONS = 6  # scale and bias: six unknowns
APART = float(np.cos(np.radians(30.0)))  # cosine between orientations that count as different
UP_AND_DOWN = 0.5  # of gravity, along each axis, both ways: an axis within 60 degrees of up, and of down
LEAST_SPREAD = 0.1  # mean square of the directions along their weakest axis; even ones have a third
MOST_RMS = 0.1  # m/s^2: cheap sensors bend by a third of that
# Standard deviations before the measurement: the loosest of consumer units' data sheets, cross-axis 2 %.
PRIOR = np.repeat([0.05, 0.02, 1.0], 3)
KNOWN_SHARE = 0.5  # of the prior: an angle less surely known than that comes from the prior, not from the rests
SCALE, ANGLES, BIAS = slice(0, 3), slice(3, 6), slice(6, 9)


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerErrors:
    """force = upper_triangular(angles) @ (scale * (reading - bias)), in a frame whose x is the sensor's."""

    scale: FloatArray  # (3,)
    angles: FloatArray  # (3,) rad: y towards x, z towards x, z towards y
    bias: FloatArray  # (3,) m/s^2, amid the rests
    sigma: FloatArray  # (9,) standard deviations of scale, angles, bias
    rms: float  # m/s^2, of the rests' lengths after the correction, against gravity
    num_rests: int

    @property
    def angles_known(self) -> bool:
        """Whether the rests tell the angles; six on the flat sides do not."""
        return bool((self.sigma[ANGLES] < KNOWN_SHARE * PRIOR[ANGLES]).all())

    @property
    def told(self) -> AccelerometerCalibration:
        """What the estimation is told; it finds the bias by itself, since that drifts."""
        x, y, z = self.scale.tolist()
        yx, zx, zy = self.angles.tolist() if self.angles_known else (0.0, 0.0, 0.0)
        return AccelerometerCalibration(scale=(x, y, z), misalignment=(yx, zx, zy))


@dataclass(frozen=True, slots=True, eq=False)
class RestForces:
    """The mean force of every rest."""

    t_s: FloatArray  # (n,) middle of the rest
    duration_s: FloatArray  # (n,)
    force: FloatArray  # (n, 3) m/s^2

    @property
    def directions(self) -> FloatArray:
        """(n, 3) Unit vectors."""
        return self.force / np.linalg.norm(self.force, axis=1, keepdims=True)

    def mean_length(self) -> float:
        return float(np.linalg.norm(self.force, axis=1).mean())

    def num_orientations(self) -> int:
        """How many of the rests differ."""
        chosen: list[FloatArray] = []
        for u in self.directions:
            if all(float(u @ other) < APART for other in chosen):
                chosen.append(u)
        return len(chosen)


def rest_forces(samples: EvenSamples, rests: Sequence[slice]) -> RestForces:
    return RestForces(
        np.array([0.5 * (samples.t_s[rest.start] + samples.t_s[rest.stop - 1]) for rest in rests]),
        np.array([(rest.stop - rest.start) / samples.rate_hz for rest in rests]),
        np.array([samples.values[rest, 3:].mean(axis=0) for rest in rests]).reshape(-1, 3),
    )


def missing_orientations(rests: RestForces) -> Iterator[str]:
    """What else to do, where the rests cannot tell scale and bias; judged by how it lay, not by the fit."""
    count = rests.num_orientations()
    if count < MIN_ORIENTATIONS:
        yield (
            f"it lay in {count} orientations, and the accelerometer's scale and bias need {MIN_ORIENTATIONS}:"
            " lay it on each of its sides, better in nine to twelve orientations"
        )
        return
    u = rests.directions
    if np.linalg.eigvalsh(u.T @ u / len(u))[0] < LEAST_SPREAD:
        yield "all orientations lie near one plane, turned about one axis: lay it on its other sides as well"
        return
    for axis, low, high in zip("xyz", u.min(axis=0), u.max(axis=0), strict=True):
        for is_missing, way in ((high < UP_AND_DOWN, "up"), (low > -UP_AND_DOWN, "down")):
            if is_missing:
                yield f"the accelerometer's {axis} axis never pointed {way}: lay it on that side as well"


def fit_errors(rests: RestForces, density: float, walk: float, gravity: float) -> AccelerometerErrors:
    """The nine figures that make every rest read gravity.

    Args:
        density: of the white noise, m/s^2/sqrt(Hz).
        walk: of the bias, m/s^3/sqrt(Hz).
        gravity: m/s^2, where it was recorded.
    """
    weights = np.linalg.cholesky(_covariance(rests, density, walk))
    start = np.repeat([1.0, 0.0, 0.0], 3)

    def residuals(x: FloatArray) -> FloatArray:
        too_long = np.linalg.norm(_corrected(x, rests.force), axis=1) - gravity
        return np.concatenate([solve_triangular(weights, too_long, lower=True), (x - start) / PRIOR])

    found = least_squares(residuals, start, x_scale=PRIOR)
    cov = np.linalg.inv(found.jac.T @ found.jac)
    # More is left over than noise and walk explain: the sensor is not linear, or was warming up.
    excess = max(1.0, 2.0 * float(found.cost) / len(rests.t_s))
    too_long = np.linalg.norm(_corrected(found.x, rests.force), axis=1) - gravity
    return AccelerometerErrors(
        scale=found.x[SCALE],
        angles=found.x[ANGLES],
        bias=found.x[BIAS],
        sigma=np.sqrt(excess * np.diag(cov)),
        rms=float(np.sqrt(np.mean(too_long**2))),
        num_rests=len(rests.t_s),
    )


def _corrected(x: FloatArray, force: FloatArray) -> FloatArray:
    """(n, 3) Tedaldi et al., eq. 5, with the bias' sign turned: what is read too much."""
    return np.asarray((x[SCALE] * (force - x[BIAS])) @ upper_triangular(x[ANGLES]).T)


def _covariance(rests: RestForces, density: float, walk: float) -> FloatArray:
    """(n, n) Of the lengths of the rests' mean forces, about the bias amid the rests.

    Noise changes a length by its part along the force; the walk's variance grows with the time from the middle, and
    two rests on the same side of it share what the nearer one has. A mean over T adds the walk's variance of T / 12.
    """
    from_middle = rests.t_s - np.median(rests.t_s)
    same_side = np.sign(from_middle)[:, None] == np.sign(from_middle)
    shared_s = np.where(same_side, np.minimum(np.abs(from_middle)[:, None], np.abs(from_middle)), 0.0)
    u = rests.directions
    own = density**2 / rests.duration_s + walk**2 * rests.duration_s / 12.0
    return walk**2 * shared_s * (u @ u.T) + np.diag(own)
