"""Lens distortion with every derivative that a calibration needs. A known camera is used by station/vision/lens.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from shared.geometry import FloatArray

LensName = Literal["radtan", "radtan5", "radtan8", "equidistant"]
LENS_NAMES: tuple[LensName, ...] = get_args(LensName)
COUNT: dict[LensName, int] = {"radtan": 4, "radtan5": 5, "radtan8": 8, "equidistant": 4}
NARROWER: dict[LensName, LensName] = {
    "radtan5": "radtan",
    "radtan8": "radtan5",
}  # those they are with further numbers 0
ROBOT_LENSES: tuple[LensName, ...] = ("radtan", "equidistant")  # those that robot, datasets and kalibr read
MAX_ANGLE_RAD = 1.48  # 85 degrees off the axis


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """How distorted points move."""

    by_xy: FloatArray  # (n, 2, 2), derivative by the undistorted point
    by_d: FloatArray  # (n, 2, COUNT), derivative by the coefficients


def distort(lens: LensName, xy: FloatArray, d: FloatArray) -> FloatArray:
    """Points (n, 2) on the plane at distance 1 as the lens shows them.

    Source: radtan as OpenCV's calib3d (k1 k2 p1 p2, k3, k4 k5 k6); equidistant: Kannala and Brandt, TPAMI 28(8), 2006.
    """
    if lens == "equidistant":
        r, theta, odd = _angles(xy)
        return np.asarray(xy * ((theta + d @ odd) / r)[:, None])
    x, y, r2, above, below = _radial(xy, d)
    radial, p1, p2 = above / below, d[2], d[3]
    return np.column_stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]
    )


def distortion_slopes(lens: LensName, xy: FloatArray, d: FloatArray) -> Slopes:
    """Derivatives of `distort`."""
    return _equidistant_slopes(xy, d) if lens == "equidistant" else _radtan_slopes(xy, d)


def undistorted_guess(lens: LensName, xy: FloatArray) -> FloatArray:
    """Points (n, 2) on the plane at distance 1 for a lens of this kind whose coefficients are all 0."""
    if lens != "equidistant":
        return xy
    theta = np.linalg.norm(xy, axis=1, keepdims=True)
    return np.asarray(xy * np.tan(np.minimum(theta, MAX_ANGLE_RAD)) / np.maximum(theta, 1e-9))


def _radial(xy: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """x, y, r^2 and the two polynomials in it whose ratio stretches a point."""
    x, y = np.ascontiguousarray(xy.T)
    r2 = x * x + y * y
    k = d[[0, 1, *range(4, len(d))]]
    above = 1.0 + r2 * np.polynomial.polynomial.polyval(r2, k[:3])
    below = 1.0 + r2 * np.polynomial.polynomial.polyval(r2, k[3:]) if len(k) > 3 else np.ones_like(r2)
    return x, y, r2, above, below


def _radtan_slopes(xy: FloatArray, d: FloatArray) -> Slopes:
    x, y, r2, above, below = _radial(xy, d)
    k = np.zeros(8)
    k[: len(d)] = d
    radial = above / below
    slope_above = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    slope_below = k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7])
    slope = 2.0 * (slope_above - radial * slope_below) / below  # d radial / dx = slope * x
    p1, p2 = k[2], k[3]
    by_xy = np.empty((len(xy), 2, 2))
    by_xy[:, 0, 0] = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    by_xy[:, 1, 1] = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    by_xy[:, 0, 1] = by_xy[:, 1, 0] = slope * x * y + 2 * p1 * x + 2 * p2 * y
    by_d = np.empty((len(xy), 2, len(d)))
    by_d[:, 0, 2], by_d[:, 1, 2] = 2 * x * y, r2 + 2 * y * y
    by_d[:, 0, 3], by_d[:, 1, 3] = r2 + 2 * x * x, 2 * x * y
    above_d, below_d = [c for c in (0, 1, 4) if c < len(d)], range(5, len(d))
    for columns, factor in ((above_d, 1.0 / below), (below_d, -radial / below)):
        for column in columns:
            factor = factor * r2  # the next power
            by_d[:, 0, column], by_d[:, 1, column] = x * factor, y * factor
    return Slopes(by_xy, by_d)


def _angles(xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distance from the middle, angle off the axis (n,), and the angle to the 3rd, 5th, 7th and 9th power (4, n)."""
    r = np.maximum(np.hypot(xy[:, 0], xy[:, 1]), 1e-9)
    theta = np.arctan(r)
    t2 = theta * theta
    t3 = theta * t2
    t5 = t3 * t2
    t7 = t5 * t2
    return r, theta, np.stack([t3, t5, t7, t7 * t2])


def _equidistant_slopes(xy: FloatArray, d: FloatArray) -> Slopes:
    r, theta, odd = _angles(xy)
    slope = (1.0 + (np.array([3, 5, 7, 9]) * d) @ odd / theta) / (1.0 + r * r)
    scale = (theta + d @ odd) / r
    unit = xy / r[:, None]
    by_xy = (slope - scale)[:, None, None] * unit[:, :, None] * unit[:, None, :] + scale[:, None, None] * np.eye(2)
    return Slopes(by_xy, unit[:, :, None] * odd.T[:, None, :])
