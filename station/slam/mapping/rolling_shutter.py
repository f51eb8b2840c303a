"""A rolling shutter exposes row after row while the camera moves: where the body was when each row was exposed."""

from __future__ import annotations

from shared.geometry import FloatArray
from station.motion import lie


def observation_pose(
    R: FloatArray, x: FloatArray, v: FloatArray, omega: FloatArray, delay_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Body poses (..., 3, 3), (..., 3) at the time of each row's own exposure: the image's pose moved on.

    Args:
        R, x: (..., 3, 3), (..., 3) body pose at the image's time.
        v: (..., 3) m/s, world; omega: (..., 3) rad/s, body.
        delay_s: (...) from the image's time to the row's.
    """
    turned = R @ lie.so3_exp(omega * delay_s[..., None])
    return turned, x + v * delay_s[..., None]
