"""A rolling shutter exposes row after row while the camera moves; here each row's own time is allowed for.

Either a pose is moved on to the row's time, or what the row saw is turned back to the image's.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, homogeneous, so3_exp


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
        omega_cam: (3,) rad/s in the camera frame. What the camera moves meanwhile (a few mm) is left out.
    """
    turn = so3_exp(delay_s[:, None] * omega_cam)
    rays = np.einsum("nij,nj->ni", turn, homogeneous(xy))
    return np.asarray(rays[:, :2] / rays[:, 2:])
