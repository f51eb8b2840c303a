"""A rolling shutter exposes row after row while the camera moves; here each row's own time is allowed for.

Either a pose is moved on to the row's time, or what the row saw is turned back to the image's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, homogeneous, so3_exp


@dataclass(frozen=True, slots=True, eq=False)
class RowMotion:
    """What a camera did while it exposed one image."""

    delay_s: FloatArray  # (n,) from the image's time to the row of each feature
    v_cam: FloatArray  # (3,) m/s, of the camera in its own frame
    omega_cam: FloatArray  # (3,) rad/s, likewise


def observation_pose(
    R: FloatArray, x: FloatArray, v: FloatArray, omega: FloatArray, delay_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Body poses (..., 3, 3), (..., 3) at the time of each row's own exposure: the image's pose moved on.

    Args:
        R, x: (..., 3, 3), (..., 3) body pose at the image's time.
        v: (..., 3) m/s, world; omega: (..., 3) rad/s, body.
        delay_s: (...) from the image's time to the row's.
    """
    turned = R @ so3_exp(omega * delay_s[..., None])
    return turned, x + v * delay_s[..., None]


def turned_back(xy: FloatArray, delay_s: FloatArray, omega_cam: FloatArray) -> FloatArray:
    """Normalised image coordinates (N, 2) as if each had been exposed delay_s (N,) earlier by a camera that turns.

    Args:
        omega_cam: (3,) rad/s in the camera frame. What the camera moves meanwhile is left to `moved_back`.
    """
    turn = so3_exp(delay_s[:, None] * omega_cam)
    rays = np.einsum("nij,nj->ni", turn, homogeneous(xy))
    return np.asarray(rays[:, :2] / rays[:, 2:])


def moved_back(xy: FloatArray, depth: FloatArray, delay_s: FloatArray, v_cam: FloatArray) -> FloatArray:
    """Normalised image coordinates (N, 2) as if each had been exposed delay_s (N,) earlier by a camera that moves.

    Args:
        depth: (N,) m of what is seen, at the earlier time.
        v_cam: (N, 3) m/s in the camera frame.
    """
    moved = v_cam * delay_s[:, None]
    then = depth - moved[:, 2]
    return np.asarray((xy * then[:, None] + moved[:, :2]) / depth[:, None])
