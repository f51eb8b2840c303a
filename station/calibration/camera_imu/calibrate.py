"""Camera and IMU from a hand-held recording before a target: rotation, position, time shift, line delay, gravity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from shared.calibration import CameraCalibration, ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray
from station.calibration.camera_imu import verdict
from station.calibration.camera_imu.batch import (
    Problem,
    Progress,
    Solution,
    solve,
    start_unknowns,
    target_shape,
)
from station.calibration.camera_imu.priors import Known
from station.calibration.camera_imu.rows import Corners, Samples
from station.calibration.camera_imu.start import (
    MAX_SHIFT_S,
    MAX_USED_S,
    CameraPoses,
    TurningMatch,
    best_part,
    camera_poses,
    match_turning,
    turns_between,
)
from station.calibration.camera_imu.unknowns import (
    DELAY,
    GRAVITY,
    MOUNT_POSITION,
    MOUNT_ROTATION,
    SHIFT,
)
from station.calibration.layout import OTHER_BOARD, is_other_board
from station.calibration.target import BoardView, Target
from station.model.frames import ImuBatch
from station.vision.lens import Lens

START_SIGMA_PX = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class HandheldRecording:
    """What was recorded of a target and what was known before."""

    views: list[BoardView]
    num_images: int  # with those that show no target
    imu: ImuBatch
    target: Target
    camera: CameraCalibration  # of it the lens counts; its mounting and time shift are found anew
    noise: ImuNoise
    gravity: float  # m/s^2
    sigma_intrinsics: FloatArray  # (8,) how well the lens is known: fx, fy, cx, cy px, distortion; 0: exactly
    notes: list[str]  # what is to be said about what could not be used


@dataclass(frozen=True, slots=True, eq=False)
class CameraImuCalibration:
    """What was found, and whether to use it."""

    reasons: list[str]  # against it
    solution: Solution | None  # None: nothing could be estimated
    notes: list[str]  # what was not used of the recording

    @property
    def is_accepted(self) -> bool:
        return not self.reasons

    def results(self) -> dict[str, Any]:
        """For scripts; numbers are null where nothing could be estimated."""
        verdict = {"accepted": self.is_accepted, "reasons": self.reasons, "notes": self.notes}
        return (NOTHING if self.solution is None else figures(self.solution)) | verdict


NOTHING = dict.fromkeys(
    ("T_body_cam", "time_shift_s", "line_delay_s", "gravity", "sigma", "rms_px", "rms_gyro", "rms_accel", "intrinsics",
     "distortion")
)  # fmt: skip


def figures(solution: Solution) -> dict[str, Any]:
    camera = solution.unknowns.camera
    return {
        "T_body_cam": camera.T_body_cam_matrix.tolist(),
        "time_shift_s": camera.time_shift_s,
        "line_delay_s": camera.line_delay_s,
        "gravity": solution.unknowns.gravity.tolist(),
        "sigma": {
            "rotation_deg": np.degrees(solution.sigma(MOUNT_ROTATION)).tolist(),
            "translation_m": solution.sigma(MOUNT_POSITION).tolist(),
            "time_shift_s": float(solution.sigma(slice(SHIFT, SHIFT + 1))[0]),
            "line_delay_s": float(solution.sigma(slice(DELAY, DELAY + 1))[0]),
            "gravity": solution.sigma(GRAVITY).tolist(),
        },
        "rms_px": solution.rms_px,
        "rms_gyro": solution.fit.gyro,
        "rms_accel": solution.fit.accel,
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "distortion": list(camera.distortion),
    }


def calibrate_camera_imu(recording: HandheldRecording, progress: Progress) -> CameraImuCalibration:
    """The calibration, or why this recording gives none."""
    notes = recording.notes
    if len(recording.imu) < 2:
        return CameraImuCalibration(["the recording holds no inertial readings: record the IMU as well"], None, notes)
    if is_other_board(recording.target, recording.views):
        return CameraImuCalibration([OTHER_BOARD], None, notes)
    origin_ns = int(recording.imu.t_robot_ns[0])
    progress("poses of the target")
    poses = camera_poses(recording.views, recording.target, Lens(recording.camera), origin_ns)
    reasons = verdict.poor_views(poses, recording.num_images)
    if reasons:
        return CameraImuCalibration(reasons, None, notes)
    samples = Samples.of(recording.imu, recording.noise, origin_ns)
    if np.ptp(poses.t_s) > MAX_USED_S:
        poses = best_part(poses, samples.t_s, samples.gyro)
        begin_s, end_s = poses.t_s[[0, -1]]
        samples = samples.between(begin_s - 2 * MAX_SHIFT_S, end_s + 2 * MAX_SHIFT_S)
        notes = [*notes, f"used: second {begin_s:.0f} to {end_s:.0f}, where it turned most; 60 s are enough"]
    reasons = verdict.poor_imu(poses, samples)
    if reasons:
        return CameraImuCalibration(reasons, None, notes)
    progress("time shift")
    try:
        match = match_turning(turns_between(poses), samples.t_s, samples.gyro)
        reasons = verdict.poor_motion(match)
        if reasons:
            return CameraImuCalibration(reasons, None, notes)
        problem = _problem(recording, poses, samples, origin_ns)
        with threadpool_limits(1):  # thousands of small products: BLAS takes twice the time to share each of them out
            reasons, solution = _estimate(recording, problem, poses, match, progress)
        return CameraImuCalibration(reasons, solution, notes)
    except DegenerateGeometry as exc:
        reasons = [f"{exc}: record 30 to 60 s with the target in view, turning about all axes"]
        return CameraImuCalibration(reasons, None, notes)


def _problem(recording: HandheldRecording, poses: CameraPoses, samples: Samples, origin_ns: int) -> Problem:
    return Problem(
        corners=Corners.of(poses.views, recording.target, origin_ns, START_SIGMA_PX),
        samples=samples,
        known=Known(recording.camera, recording.sigma_intrinsics, recording.gravity, recording.noise),
    )


def _estimate(
    recording: HandheldRecording, problem: Problem, poses: CameraPoses, match: TurningMatch, progress: Progress
) -> tuple[list[str], Solution]:
    """The batch estimate, and whether the target and the measurements are as they should be."""
    solution = solve(problem, start_unknowns(problem, poses, match), progress)
    shape = target_shape(solution)
    if verdict.is_another(shape):  # one step from a wrong target tells neither by how much nor how surely
        shape = target_shape(solve(problem, solution.unknowns, progress, free_target=True))
    # A target or a lens that is not as its file says explains what does not fit.
    reasons = (
        verdict.poor_target(shape, recording.target)
        or verdict.poor_lens(solution)
        or verdict.poor_fit(solution, problem.samples)
    )
    return reasons, solution
