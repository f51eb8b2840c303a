"""What a whole map says of the camera that made it: focal length, mounting and time shift.

Windows of a drive (calibration_information.py) know the focal length to a quarter of a per cent, and a map that is made
with half a per cent of error is 3 % too large. Where loops are closed and the inertial readings hold the poses, the
map's own equations know it to some hundredths: one turn on the spot that closes tells it.
Source: self-calibrating bundle adjustment (Triggs et al. 2000, section 2.2), one Gauss-Newton step beside a solved
map; the prior is what calibrations at home are off by (station/model/best_camera.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from shared.calibration import CameraCalibration
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, skew, so3_exp, so3_log
from station.model.best_camera import (
    TOLD_FOCAL_SIGMA,
    TOLD_MOUNTING_SIGMA_DEG,
    TOLD_POSITION_SIGMA_M,
    TOLD_TIME_SIGMA_S,
    KnownCamera,
)
from station.model.calibration_fit import CalibrationFit, judge
from station.slam.mapping.calibration_information import FOCAL, FOCAL_STEP, MOUNTING, PRIOR_SIGMA, TIME
from station.slam.mapping.odometry_bundle import BundleState, MotionTerms, Observations, in_camera, information_on
from station.slam.mapping.rolling_shutter import RowMotion
from station.vision.lens import Lens

POSITION = slice(5, 8)  # m, in body axes; the others are those of windows
SIZE = 8
TOLD_SIGMA = np.array([
    TOLD_FOCAL_SIGMA, *np.radians([TOLD_MOUNTING_SIGMA_DEG] * 3), TOLD_TIME_SIGMA_S, *[TOLD_POSITION_SIGMA_M] * 3
])  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """A camera as told, and how far that is off as far as is known."""

    told: CameraCalibration
    camera: CameraCalibration  # corrected, with the told time shift; see `late_s`
    error: FloatArray  # (8,)
    focal_sigma_before: float  # relative, as it was known before the map
    sigma: FloatArray | None = None  # (8,) one standard deviation; None: no map has said anything

    @classmethod
    def started(cls, told: CameraCalibration, known: KnownCamera) -> CameraFit:
        """From what is known of it before the map."""
        error = np.zeros(SIZE)
        error[FOCAL] = np.log(known.camera.fx / told.fx)
        error[MOUNTING] = so3_log(told.T_body_cam_matrix[:3, :3].T @ known.camera.T_body_cam_matrix[:3, :3])
        error[TIME] = known.late_s
        return cls(told, known.camera, error, known.focal_sigma)

    @property
    def late_s(self) -> float:
        """How much later than told the images were taken."""
        return float(self.error[TIME])

    def improved(
        self,
        state: BundleState,
        seen: Observations,
        motion: MotionTerms,
        rows: Sequence[RowMotion],
        scale_px: float,
    ) -> CameraFit:
        """By a map that was solved with this camera; as it is where the map knows it worse than was known before.

        Args:
            rows: how the camera moved at each pose.
            scale_px: of the robust loss.
        """
        J = camera_jacobian(state, seen, self.camera, rows)
        try:
            information, score = information_on(state, seen, motion, scale_px, J)
        except DegenerateGeometry:
            return self
        prior = np.diag(TOLD_SIGMA**-2)
        covariance = np.linalg.inv(information + prior)
        sigma = np.sqrt(np.diag(covariance))
        if sigma[FOCAL] > self.focal_sigma_before:
            return self
        error = self.error + covariance @ (score - prior @ self.error)
        return replace(self, camera=moved(self.told, error), error=error, sigma=sigma)

    def judged(self) -> CalibrationFit | None:
        """What the map alone says of the told camera; None where no map has said anything.

        Without what is told: whoever weighs the two (best_camera.py) would count that twice, and of a map that knows
        little, half an error would be called none.
        """
        if self.sigma is None:
            return None
        of_windows = slice(len(PRIOR_SIGMA))  # a fit does not speak of the position
        together = self.sigma[of_windows] ** -2
        information = np.maximum(together - TOLD_SIGMA[of_windows] ** -2, PRIOR_SIGMA**-2)
        error, sigma = self.error[of_windows] * together / information, information**-0.5
        return judge(
            focal=(float(np.exp(error[FOCAL])), float(sigma[FOCAL])),
            mounting_deg=np.degrees(error[MOUNTING]),
            mounting_sigma_deg=np.degrees(sigma[MOUNTING]),
            shift_s=(float(error[TIME]), float(sigma[TIME])),
        )


def moved(told: CameraCalibration, error: FloatArray) -> CameraCalibration:
    """The camera whose told numbers are off by (8,); its time shift stays."""
    longer, T = float(np.exp(error[FOCAL])), told.T_body_cam_matrix
    T[:3, :3] = T[:3, :3] @ so3_exp(error[MOUNTING])
    T[:3, 3] += error[POSITION]
    return msgspec.structs.replace(told, fx=longer * told.fx, fy=longer * told.fy, T_body_cam=tuple(T.ravel().tolist()))


def camera_jacobian(
    state: BundleState, seen: Observations, camera: CameraCalibration, rows: Sequence[RowMotion]
) -> FloatArray:
    """(K, 2, 8) px: how residuals change with the camera's error, where the points are predicted.

    Where they are seen, a derivative contains the noise of its own residual (calibration_information.py).
    """
    p_cam, J_cam = in_camera(state, seen)
    predicted = p_cam[:, :2] / np.maximum(p_cam[:, 2:], 0.02)
    longer = Lens(msgspec.structs.replace(camera, fx=camera.fx * (1 + FOCAL_STEP), fy=camera.fy * (1 + FOCAL_STEP)))
    J = np.empty((len(p_cam), 2, SIZE))
    by_focal = (longer.unproject(Lens(camera).project(predicted)) - predicted) / FOCAL_STEP
    J[:, :, FOCAL] = -seen.focal_px * by_focal
    J[:, :, MOUNTING] = J_cam @ skew(p_cam)
    v_cam, omega_cam = (np.array([getattr(r, name) for r in rows])[seen.keyframe] for name in ("v_cam", "omega_cam"))
    J[:, :, TIME] = np.einsum("kij,kj->ki", J_cam, -np.cross(omega_cam, p_cam) - v_cam)
    J[:, :, POSITION] = -J_cam @ seen.T_cam_body[:3, :3]
    return J
