"""How well the views so far tell each quantity of a camera: a quick estimate beside the one at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray
from station.calibration.target import BoardView, Target

LEAST_VIEWS = 6  # fewer leave focal length and distance apart only by chance
GROUPS = 8  # of views that are left out in turn
MAX_CORNERS = 40  # of each view: what is shown while a person waits need not have all of them


@dataclass(frozen=True, slots=True)
class Reading:
    """One quantity, and how well it is known."""

    name: str
    value: float
    sigma: float  # one standard deviation
    wanted: float  # the sigma that is good enough
    unit: str


def read_meter(views: Sequence[BoardView], target: Target, camera: CameraCalibration) -> tuple[Reading, ...]:
    """Focal length, centre and distortion of a pinhole camera with radial-tangential distortion, from these views.

    Their standard deviations are of the jackknife: how much the estimate changes when a part of the views is left out.
    The residuals' own would be too small, since the errors of one view's corners go together (the board's bend, blur).
    Empty for fewer than LEAST_VIEWS, for a fisheye, and where the views allow no estimate.

    Source: Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982, sec. 3.1, with groups of views.
    """
    if len(views) < LEAST_VIEWS or camera.model != "radtan":
        return ()
    groups = min(GROUPS, len(views))
    whole = _estimate(views, target, camera)
    parts = [_estimate([v for n, v in enumerate(views) if n % groups != g], target, camera) for g in range(groups)]
    if not np.isfinite([whole, *parts]).all():
        return ()
    spread = np.array(parts) - np.mean(parts, axis=0)
    sigma = np.sqrt((groups - 1) / groups * (spread**2).sum(axis=0))
    return (
        Reading("focal length", float(whole[0]), float(sigma[:2].max()), 0.002 * camera.width, "px"),
        Reading("centre", float(whole[2]), float(sigma[2:4].max()), 0.003 * camera.width, "px"),
        Reading("distortion", float(whole[4]), float(sigma[4]), 0.01, ""),
    )


def _estimate(views: Sequence[BoardView], target: Target, camera: CameraCalibration) -> FloatArray:
    """fx, fy, cx, cy px and k1 (5,); NaN where there is no estimate."""
    corners = target.corners.astype(np.float32)
    rows = [np.linspace(0, len(v.ids) - 1, min(MAX_CORNERS, len(v.ids))).round().astype(np.int64) for v in views]
    p_board = [corners[view.ids[chosen]] for view, chosen in zip(views, rows, strict=True)]
    uv_px = [view.corners_px[chosen].astype(np.float32) for view, chosen in zip(views, rows, strict=True)]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    size = (camera.width, camera.height)
    try:
        _, K, distortion, _, _ = cv2.calibrateCamera(p_board, uv_px, size, camera.K, np.zeros(5), flags=flags)
    except cv2.error:
        return np.full(5, np.nan)
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], distortion.ravel()[0]])
