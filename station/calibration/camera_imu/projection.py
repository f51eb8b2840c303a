"""Points as a camera sees them, and what each number of its calibration does to that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, skew
from station.calibration.camera_imu.unknowns import (
    BIASES,
    DELAY,
    INTRINSICS,
    MOUNT_POSITION,
    MOUNT_ROTATION,
    SHIFT,
    intrinsics_of,
    with_intrinsics,
)
from station.vision.lens import Lens

INTRINSICS_STEP = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 1e-6])  # of their numerical derivative
NEAREST = 1e-3  # of the depth: what lies behind the camera is as far beside the image as that


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """M points in the picture; everything in standard deviations of a pixel coordinate."""

    camera: CameraCalibration
    sigma_px: float
    uv_px: FloatArray  # (M, 2) where they were seen
    p_cam: FloatArray  # (M, 3) homogeneous: their length does not count
    xy: FloatArray  # (M, 2) normalised
    residual: FloatArray  # (M, 2) expected less seen
    by_cam: FloatArray  # (M, 2, 3) by p_cam
    by_body: FloatArray  # (M, 2, 3) by the same along the body's axes

    @classmethod
    def of(cls, camera: CameraCalibration, p_cam: FloatArray, uv_px: FloatArray, sigma_px: float) -> Projection:
        lens = Lens(camera)
        z = np.maximum(p_cam[:, 2], NEAREST)
        xy = p_cam[:, :2] / z[:, None]
        by_cam = np.zeros((len(z), 2, 3))
        by_cam[:, 0, 0] = by_cam[:, 1, 1] = 1.0 / z
        by_cam[:, :, 2] = -xy / z[:, None]
        by_cam = lens.whitening(xy, sigma_px) @ by_cam
        by_body = by_cam @ camera.T_body_cam_matrix[:3, :3].T
        return cls(camera, sigma_px, uv_px, p_cam, xy, (lens.project(xy) - uv_px) / sigma_px, by_cam, by_body)

    def by_border(self, moving: FloatArray, nearness: FloatArray) -> FloatArray:
        """(M, 2, BIASES) by the camera's calibration; 0 by the rest of the border.

        Args:
            moving: (M, 3) 1/s how p_cam changes with time, along the body's axes.
            nearness: (M,) 1/m by how much p_cam changes with the camera's place in the body; 1 where p_cam is in m.
        """
        out = np.zeros((len(self.uv_px), 2, BIASES))
        out[..., MOUNT_ROTATION] = self.by_cam @ skew(self.p_cam)
        out[..., MOUNT_POSITION] = -nearness[:, None, None] * self.by_body
        out[..., SHIFT] = (self.by_body @ moving[..., None])[..., 0]
        out[..., DELAY] = out[..., SHIFT] * self.uv_px[:, 1, None]
        out[..., INTRINSICS] = by_intrinsics(self.camera, self.xy) / self.sigma_px
        return out


def by_intrinsics(camera: CameraCalibration, xy: FloatArray) -> FloatArray:
    """(M, 2, 8) px. Numerical, so that every lens model has it: it is linear in all of them but for rounding."""
    now = intrinsics_of(camera)
    out = np.empty((len(xy), 2, len(now)))
    for i, step in enumerate(INTRINSICS_STEP):
        high, low = (
            Lens(with_intrinsics(camera, now + sign * step * (np.arange(8) == i))).project(xy) for sign in (0.5, -0.5)
        )
        out[..., i] = (high - low) / step
    return out
