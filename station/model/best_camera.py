"""The camera as it is best known: as told before the drive, corrected by what the drive itself says of it.

What is told is a Gaussian around the truth and so is the fit; their product is the Kalman update of the one by the
other. There is no threshold: a fit that knows little corrects little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import so3_exp
from station.model.calibration_fit import CalibrationFit, why_doubtful, why_misfit, why_unsure
from station.model.navigation import Navigation, NavigationReport

# How good a calibration at home is, one standard deviation: a chessboard that is printed and held by hand gives the
# focal length to about a per cent, a camera is mounted by eye, and its delay is a few milliseconds.
TOLD_FOCAL_SIGMA = 0.01
TOLD_MOUNTING_SIGMA_DEG = 1.0
TOLD_POSITION_SIGMA_M = 0.01
TOLD_TIME_SIGMA_S = 0.005
CONTRADICTED = 9.49  # chi-squared, 95 % of four degrees of freedom: focal length and mounting


@dataclass(frozen=True, slots=True)
class KnownCamera:
    """A camera and how well it is known."""

    camera: CameraCalibration
    focal_sigma: float  # relative, one standard deviation
    late_s: float = 0.0  # how much later than its time shift tells its images are taken


def corrected(told: CameraCalibration, fit: CalibrationFit | None) -> KnownCamera:
    """The camera after the fit; as told without one.

    Its time shift stays, what the fit says of it stands beside: the filter's poses, which a map starts from, have the
    told one in their times.
    """
    if fit is None:
        return KnownCamera(told, TOLD_FOCAL_SIGMA)
    gain = TOLD_FOCAL_SIGMA**2 / (TOLD_FOCAL_SIGMA**2 + fit.focal_sigma**2)
    longer = fit.focal_scale**gain
    gain_mounting = 1.0 / (1.0 + (np.array(fit.mounting_sigma_deg) / TOLD_MOUNTING_SIGMA_DEG) ** 2)
    T = told.T_body_cam_matrix
    T[:3, :3] = T[:3, :3] @ so3_exp(np.radians(gain_mounting * np.array(fit.mounting_deg)))
    camera = msgspec.structs.replace(
        told, fx=longer * told.fx, fy=longer * told.fy, T_body_cam=tuple(T.ravel().tolist())
    )
    late_s = fit.time_shift_s / (1.0 + (fit.time_shift_sigma_s / TOLD_TIME_SIGMA_S) ** 2)
    return KnownCamera(camera, TOLD_FOCAL_SIGMA * math.sqrt(1.0 - gain), late_s)


def unless_it_fits(told: CameraCalibration, fit: CalibrationFit | None) -> CameraCalibration:
    """As told where what the drive says is no further from it than its uncertainty makes likely; else corrected.

    A correction within that is noise of the drive's own where the told camera was measured: 0.2 degrees of mounting
    made maps of flats 1 % too large (docs/studies/ukf-map.md).
    """
    if fit is None:
        return told
    off = [math.log(fit.focal_scale) / fit.focal_sigma, *np.divide(fit.mounting_deg, fit.mounting_sigma_deg)]
    return told if float(np.square(off).sum()) < CONTRADICTED else corrected(told, fit).camera


def best_camera(
    told: CameraCalibration, navigation: Navigation, fit: CalibrationFit | None = None
) -> CameraCalibration:
    """The camera by which to look for an image of a robot in the map that was made from a navigation.

    A robot that tells the numbers that the mapping robot told is taken for that robot: what the mapping drive knew of
    the camera holds for it, and the map is made with that.

    Args:
        fit: what the robot's own drive says of what it tells; used where it is better known.
    """
    own, report = corrected(told, fit), navigation.report
    if not is_of_robot(navigation, told):
        return own.camera
    if report.told_camera is None:
        return told  # uncorrected, the map is as this camera saw it
    of_map = corrected(told, report.calibration_fit)
    return own.camera if own.focal_sigma < of_map.focal_sigma else navigation.calibration.camera or told


def is_of_robot(navigation: Navigation, told: CameraCalibration | None) -> bool:
    """Whether the robot that tells these numbers is taken for the one that made the navigation."""
    return (navigation.report.told_camera or navigation.calibration.camera) == told


def misfit_of(report: NavigationReport) -> str:
    """As `why_doubtful`, and that the map is corrected for it where it is. Also of navigations joined to it."""
    why = why_doubtful(report.calibration_fit)
    return f"{why}; this map is made with the corrected camera" if why and report.told_camera else why or report.unsure


def why_unsure_of(navigation: Navigation) -> str:
    """Why nothing in its map may be said for sure, in a sentence; empty where it was made with a camera that fits."""
    report = navigation.report
    why = why_misfit if report.told_camera is None else why_unsure
    return why(report.calibration_fit) or report.unsure
