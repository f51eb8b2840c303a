"""What a window of poses says of the camera's calibration: focal length, mounting, time shift.

The window's least squares (inertial_bundle.py) has settled with the calibration as told. Were the calibration free as
well, its step from there would follow from the Schur complement over poses, velocities, biases and points: the
gyroscope knows how far the camera turned, and a focal length that is too long makes tracks turn less. Windows have
little else in common, so what they say adds up (`combined`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, skew
from station.model.calibration_fit import CalibrationFit, judge
from station.motion.preintegration import Preintegration
from station.slam.mapping.inertial_bundle import (
    Prior,
    VisualRows,
    WindowLinks,
    WindowStates,
    WindowTracks,
    normal_equations,
    visual_index,
)
from station.vision.camera_model import CameraModel
from station.vision.lens import Lens

SIZE = 5  # log focal length, mounting (3) rad about the camera's axes, time shift s
FOCAL, MOUNTING, TIME = 0, slice(1, 4), 4
PRIOR_SIGMA = np.array([0.1, 0.1, 0.1, 0.1, 0.05])  # hardly anything: keeps what no window has seen finite
# A window is off by more than its pixels' noise: features drift in one direction as their surroundings do, rows are
# exposed one after the other. Measured: by how much windows of right calibrations differ (docs/localisation.md).
WINDOW_SIGMA = np.array([5e-3, 5e-3, 5e-3, 5e-3, 1e-3])
LIKELY = 15.1  # chi-square with 5 degrees of freedom: one window in a hundred is beyond, and counts less
REWEIGHTINGS = 5
JACKKNIFE_GROUPS = 20  # enough for a standard deviation good to a sixth; bounds the cost of a long drive
FOCAL_STEP = 1e-4  # of the numerical derivative by the focal length


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationInformation:
    """Of the calibration's error around what was told: a Gaussian in information form."""

    matrix: FloatArray  # (5, 5)
    score: FloatArray  # (5,) matrix @ most likely error, where that is defined

    def blurred(self) -> CalibrationInformation:
        """The same by a window that is never better than WINDOW_SIGMA."""
        kept = np.eye(SIZE) - self.matrix @ np.linalg.inv(self.matrix + np.diag(WINDOW_SIGMA**-2))
        return CalibrationInformation(kept @ self.matrix, kept @ self.score)


def calibration_information(
    camera: CameraModel,
    noise: ImuNoise,
    gravity: float,
    states: WindowStates,
    links: list[Preintegration],
    tracks: WindowTracks,
    prior: Prior,
    huber: float = 2.0,
) -> CalibrationInformation:
    """What a solved window says of the calibration.

    Args:
        states: as solve_window found them with the same arguments.
    Raises:
        DegenerateGeometry: fewer than 8 usable tracks.
    """
    H, g, _, rows = normal_equations(camera, noise, gravity, states, WindowLinks.of(links), tracks, prior, huber)
    F, K = rows.used.shape
    C = calibration_jacobian(camera, states, rows)
    by_point = rows.Qt @ C.reshape(F, 2 * K, SIZE)  # (F, 3, 5)
    explained = by_point.reshape(3 * F, SIZE)
    r_explained = (rows.Qt @ rows.residual.reshape(F, 2 * K, 1)).reshape(3 * F)
    H_pc = np.zeros((len(H), SIZE))
    cross = np.einsum("fkip,fkic->kpc", rows.by_pose, C).reshape(6 * K, SIZE)
    H_pc[visual_index(K)] = cross - rows.by_pose_explained().T @ explained
    H_cc = np.einsum("fkia,fkib->ab", C, C) - explained.T @ explained
    g_c = np.einsum("fkic,fki->c", C, rows.residual) - explained.T @ r_explained
    by_poses = np.linalg.solve(H, np.column_stack([H_pc, g]))
    matrix = H_cc - H_pc.T @ by_poses[:, :SIZE]
    return CalibrationInformation(0.5 * (matrix + matrix.T), g_c - H_pc.T @ by_poses[:, SIZE])


def calibration_jacobian(camera: CameraModel, states: WindowStates, rows: VisualRows) -> FloatArray:
    """(F, K, 2, 5): whitened residuals change by minus this times the calibration's error.

    All of it is taken where the points are predicted, not where they were seen: a derivative that contains the noise
    of its own residual pulls the estimate by as much as the noise's square, 0.4 % of focal length for 1 px.
    """
    F, K = rows.used.shape
    out = np.empty((F, K, 2, SIZE))
    told = camera.lens.camera
    longer = 1.0 + FOCAL_STEP
    lens = Lens(msgspec.structs.replace(told, fx=told.fx * longer, fy=told.fy * longer))
    seen_longer = lens.unproject(camera.lens.project(rows.predicted).reshape(-1, 2)).reshape(rows.predicted.shape)
    by_focal = (seen_longer - rows.predicted) / FOCAL_STEP
    out[..., FOCAL] = -(rows.whitening @ by_focal[..., None])[..., 0]
    p_cam = camera.to_camera(np.einsum("fkji,fkj->fki", rows.R, rows.p - rows.x))
    out[..., MOUNTING] = rows.by_point @ camera.R_body_cam @ skew(p_cam)
    turning = np.einsum("kij,kj->ki", states.R, states.omega)  # rad/s, world
    moving = np.broadcast_to(np.hstack([turning, states.v]), (F, K, 6))
    out[..., TIME] = (rows.by_pose @ moving[..., None])[..., 0]
    return out


def combined(windows: Sequence[CalibrationInformation], *, is_all: bool) -> CalibrationFit | None:
    """What all windows say together; those that contradict the others count less. None without windows.

    The standard deviations are never smaller than the jackknife's: no window alone makes the result. One by itself says
    nothing sure while more are to come; where it `is_all` that there will be, its own standard deviation must do.
    """
    if not windows:
        return None
    parts = [window.blurred() for window in windows]
    matrices, scores = np.array([p.matrix for p in parts]), np.array([p.score for p in parts])
    error, sigma = _solved(matrices, scores)
    if len(parts) > 1 or not is_all:
        sigma = np.maximum(sigma, _jackknife_sigma(matrices, scores))
    return judge(
        focal=(float(np.exp(error[FOCAL])), float(sigma[FOCAL])),
        mounting_deg=np.degrees(error[MOUNTING]),
        mounting_sigma_deg=np.degrees(sigma[MOUNTING]),
        shift_s=(float(error[TIME]), float(sigma[TIME])),
    )


def nothing_known() -> CalibrationFit:
    """What is said of a calibration before any window."""
    none = np.zeros(3)
    return judge(
        (1.0, float(PRIOR_SIGMA[FOCAL])), none, np.degrees(PRIOR_SIGMA[MOUNTING]), (0.0, float(PRIOR_SIGMA[TIME]))
    )


def _jackknife_sigma(matrices: FloatArray, scores: FloatArray) -> FloatArray:
    """(5,) by how much the result changes when some windows are left out (Efron 1982). One window: the prior's.

    One after the other; of a long drive, one of so many groups of neighbours.
    """
    if len(matrices) == 1:
        return PRIOR_SIGMA
    groups = np.array_split(np.arange(len(matrices)), min(len(matrices), JACKKNIFE_GROUPS))
    without = np.array([
        _solved(np.delete(matrices, group, axis=0), np.delete(scores, group, axis=0))[0] for group in groups
    ])  # fmt: skip
    spread = ((without - without.mean(axis=0)) ** 2).mean(axis=0)
    return np.asarray(np.sqrt((len(groups) - 1) * spread))


def _solved(matrices: FloatArray, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The calibration's error (5,) by windows (n, 5, 5), (n, 5), robustly, and its standard deviations (5,)."""
    prior = np.diag(PRIOR_SIGMA**-2)
    weight = np.ones(len(matrices))
    for _ in range(REWEIGHTINGS):
        covariance = np.linalg.inv(prior + np.einsum("w,wab->ab", weight, matrices))
        error = covariance @ (weight @ scores)
        rest = scores - matrices @ error
        chi2 = np.einsum("wa,wa->w", rest, np.linalg.solve(matrices + prior, rest[..., None])[..., 0])
        weight = np.minimum(1.0, LIKELY / np.maximum(chi2, 1e-9))
    return error, np.sqrt(np.diag(covariance))
