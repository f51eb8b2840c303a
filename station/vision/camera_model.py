"""A camera on its body: what it sees of points, and how that changes as the points move in the body frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray
from station.vision.lens import BoolArray, Lens

MIN_DEPTH_M = 0.05  # nearer points count as behind the camera: their projection is all but singular


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """Lens, mounting, pixel noise, and when each row is exposed."""

    lens: Lens
    R_body_cam: FloatArray  # (3, 3)
    t_body_cam: FloatArray  # (3,)
    sigma_px: float
    line_delay_s: float
    middle_row: float

    @classmethod
    def of(cls, camera: CameraCalibration, sigma_px: float) -> CameraModel:
        T = camera.T_body_cam_matrix
        return cls(Lens(camera), T[:3, :3], T[:3, 3], sigma_px, camera.line_delay_s, 0.5 * (camera.height - 1))

    def row_delay_s(self, v_px: FloatArray) -> FloatArray:
        """When a row is exposed, relative to the middle row, whose time is the image's."""
        return (v_px - self.middle_row) * self.line_delay_s

    def to_camera(self, p_body: FloatArray) -> FloatArray:
        """Points (..., 3) in camera coordinates."""
        return (p_body - self.t_body_cam) @ self.R_body_cam


def normalised_points(
    camera: CameraModel, R: FloatArray, x: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Points p (..., 3) as seen from body poses R (..., 3, 3), x (..., 3), all in the world.

    Returns:
        Normalised image coordinates (..., 2), their derivative by the point in the body frame (..., 2, 3), and
        whether each point lies in front of the camera (...).
    """
    p_body = np.einsum("...ji,...j->...i", R, p - x)
    p_cam = camera.to_camera(p_body)
    z = p_cam[..., 2]
    in_front = z > MIN_DEPTH_M
    z = np.where(in_front, z, 1.0)
    xy = p_cam[..., :2] / z[..., None]
    D = np.zeros((*xy.shape, 3))
    D[..., 0, 0] = D[..., 1, 1] = 1.0 / z
    D[..., 0, 2], D[..., 1, 2] = -xy[..., 0] / z, -xy[..., 1] / z
    return xy, D @ camera.R_body_cam.T, in_front
