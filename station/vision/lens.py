"""Lens models: pixels to normalised image coordinates and back. Pure, batched."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray

BoolArray = npt.NDArray[np.bool_]

NEWTON_STEPS = 12  # stops earlier once every point moved less than NEWTON_TOLERANCE
NEWTON_TOLERANCE = 1e-11
MAX_ANGLE_RAD = 1.48  # 85 degrees off the axis: beyond it (x, y, 1) cannot say a direction


class Lens:
    """Pinhole camera with radtan (Brown) or equidistant (Kannala-Brandt) distortion.

    Normalised coordinates (x, y) are the ray (x, y, 1) of the camera frame.
    Source: radtan as in OpenCV's calib3d; equidistant: Kannala and Brandt, TPAMI 28(8), 2006, with odd powers to 9.
    """

    def __init__(self, camera: CameraCalibration) -> None:
        self.camera = camera
        self.focal = np.array([camera.fx, camera.fy])
        self._centre = np.array([camera.cx, camera.cy])
        self._d = camera.distortion

    def project(self, xy: FloatArray) -> FloatArray:
        """Pixels (..., 2) of the normalised coordinates (..., 2)."""
        return self._distort(xy)[0] * self.focal + self._centre

    def unproject(self, uv_px: FloatArray, near: FloatArray | None = None) -> FloatArray:
        """Normalised coordinates (..., 2) of pixels (..., 2). Where the lens model ends, the nearest it can say.

        near: (..., 2) about where they are, which saves steps.
        """
        target = (np.asarray(uv_px, dtype=np.float64) - self._centre) / self.focal
        if self.camera.model == "equidistant":
            return self._undistort_equidistant(target)
        xy = target.copy() if near is None else near
        for _ in range(NEWTON_STEPS):
            distorted, J = self._distort(xy)
            error = target - distorted
            det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
            det = np.where(np.abs(det) < 0.05, 0.05, det)  # beyond the lens model's turning point: small steps
            step = np.stack(
                [
                    (J[..., 1, 1] * error[..., 0] - J[..., 0, 1] * error[..., 1]) / det,
                    (J[..., 0, 0] * error[..., 1] - J[..., 1, 0] * error[..., 0]) / det,
                ],
                axis=-1,
            )
            xy = xy + np.clip(step, -0.5, 0.5)
            if not step.size or float(np.max(np.abs(step))) < NEWTON_TOLERANCE:
                break
        return xy

    def is_invertible(self, uv_px: FloatArray, xy: FloatArray) -> BoolArray:
        """Whether xy (..., 2) really projects to uv_px (..., 2): false where the lens model folds over or ends."""
        return np.abs(self.project(xy) - uv_px).max(axis=-1) < 0.01

    def whitening(self, xy: FloatArray, sigma_px: float) -> FloatArray:
        """(..., 2, 2) that turns a small difference of normalised coordinates into pixels over sigma_px."""
        return self._distort(xy)[1] * (self.focal[:, None] / sigma_px)

    def is_inside(self, uv_px: FloatArray, margin_px: float = 0.0) -> BoolArray:
        """Whether pixels (..., 2) lie in the image, margin_px away from its border."""
        low = margin_px - 0.5
        u, v = uv_px[..., 0], uv_px[..., 1]
        return (u > low) & (v > low) & (u < self.camera.width - 1 - low) & (v < self.camera.height - 1 - low)

    def _distort(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.camera.model == "radtan":
            return self._distort_radtan(xy)
        return self._distort_equidistant(xy)

    def _distort_radtan(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        k1, k2, p1, p2 = self._d
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + k2 * r2)
        slope = 2.0 * (k1 + 2.0 * k2 * r2)  # d radial / dx = slope * x
        out = np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )
        J = np.empty((*xy.shape, 2))
        J[..., 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        J[..., 0, 1] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        J[..., 1, 0] = J[..., 0, 1]
        J[..., 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        return out, J

    def _undistort_equidistant(self, distorted: FloatArray) -> FloatArray:
        k1, k2, k3, k4 = self._d
        radius = np.linalg.norm(distorted, axis=-1)
        theta = np.minimum(radius, MAX_ANGLE_RAD)
        for _ in range(NEWTON_STEPS):
            t2 = theta * theta
            value = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
            theta = np.clip(theta - (value - radius) / np.maximum(slope, 0.05), 0.0, MAX_ANGLE_RAD)
        scale = np.where(radius < 1e-9, 1.0, np.tan(theta) / np.where(radius < 1e-9, 1.0, radius))
        return distorted * scale[..., None]

    def _distort_equidistant(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        k1, k2, k3, k4 = self._d
        r = np.linalg.norm(xy, axis=-1)
        theta = np.arctan(r)
        t2 = theta * theta
        theta_d = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        d_theta_d = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        near = r < 1e-8
        r_safe = np.where(near, 1.0, r)
        scale = np.where(near, 1.0, theta_d / r_safe)
        # d scale / dr over r, so that the outer product below needs no division near the axis
        slope = np.where(near, 0.0, (d_theta_d / (1.0 + r * r) - scale) / (r_safe * r_safe))
        J = slope[..., None, None] * (xy[..., :, None] * xy[..., None, :])
        J[..., 0, 0] += scale
        J[..., 1, 1] += scale
        return xy * scale[..., None], J
