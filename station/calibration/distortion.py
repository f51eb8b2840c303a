"""Lens distortion with every derivative that a calibration needs. A known camera is used by station/vision/lens.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from shared.geometry import FloatArray

LensName = Literal["radtan", "radtan5", "radtan8", "equidistant"]
LENS_NAMES: tuple[LensName, ...] = get_args(LensName)
COUNT: dict[LensName, int] = {"radtan": 4, "radtan5": 5, "radtan8": 8, "equidistant": 4}
ROBOT_LENSES: tuple[LensName, ...] = ("radtan", "equidistant")  # those that robot, datasets and kalibr read
MAX_ANGLE_RAD = 1.48  # 85 degrees off the axis


@dataclass(frozen=True, slots=True, eq=False)
class Distorted:
    """Distorted points and how they move."""

    xy: FloatArray  # (n, 2)
    by_xy: FloatArray  # (n, 2, 2), derivative by the undistorted point
    by_d: FloatArray  # (n, 2, COUNT), derivative by the coefficients


def distort(lens: LensName, xy: FloatArray, d: FloatArray) -> Distorted:
    """Points (n, 2) on the plane at distance 1 as the lens shows them.

    Source: radtan as OpenCV's calib3d (k1 k2 p1 p2, k3, k4 k5 k6); equidistant: Kannala and Brandt, TPAMI 28(8), 2006.
    """
    return _equidistant(xy, d) if lens == "equidistant" else _radtan(xy, d)


def undistorted_guess(lens: LensName, xy: FloatArray) -> FloatArray:
    """Points (n, 2) on the plane at distance 1 for a lens of this kind whose coefficients are all 0."""
    if lens != "equidistant":
        return xy
    theta = np.linalg.norm(xy, axis=1, keepdims=True)
    return np.asarray(xy * np.tan(np.minimum(theta, MAX_ANGLE_RAD)) / np.maximum(theta, 1e-9))


def _radtan(xy: FloatArray, d: FloatArray) -> Distorted:
    k = np.zeros(8)
    k[: len(d)] = d
    x, y = xy.T
    r2 = x * x + y * y
    above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    radial = above / below
    slope_above = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    slope_below = k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7])
    slope = 2.0 * (slope_above - radial * slope_below) / below  # d radial / dx = slope * x
    p1, p2 = k[2], k[3]
    out = np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
        axis=1,
    )
    by_xy = np.empty((len(xy), 2, 2))
    by_xy[:, 0, 0] = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    by_xy[:, 1, 1] = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    by_xy[:, 0, 1] = by_xy[:, 1, 0] = slope * x * y + 2 * p1 * x + 2 * p2 * y
    powers = [
        r2 / below,
        r2**2 / below,
        r2**3 / below,
        -radial * r2 / below,
        -radial * r2**2 / below,
        -radial * r2**3 / below,
    ]
    by_d = np.empty((len(xy), 2, 8))
    for column, power in zip((0, 1, 4, 5, 6, 7), powers, strict=True):
        by_d[:, 0, column], by_d[:, 1, column] = x * power, y * power
    by_d[:, 0, 2], by_d[:, 1, 2] = 2 * x * y, r2 + 2 * y * y
    by_d[:, 0, 3], by_d[:, 1, 3] = r2 + 2 * x * x, 2 * x * y
    return Distorted(out, by_xy, by_d[:, :, : len(d)])


def _equidistant(xy: FloatArray, d: FloatArray) -> Distorted:
    r = np.maximum(np.linalg.norm(xy, axis=1), 1e-9)
    theta = np.arctan(r)
    odd = theta[:, None] ** np.array([3, 5, 7, 9])
    theta_d = theta + odd @ d
    slope = (1.0 + theta[:, None] ** np.array([2, 4, 6, 8]) @ (np.array([3, 5, 7, 9]) * d)) / (1.0 + r * r)
    scale = theta_d / r
    unit = xy / r[:, None]
    by_xy = (slope - scale)[:, None, None] * unit[:, :, None] * unit[:, None, :] + scale[:, None, None] * np.eye(2)
    return Distorted(xy * scale[:, None], by_xy, unit[:, :, None] * odd[:, None, :])
