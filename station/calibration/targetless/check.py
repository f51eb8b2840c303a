"""Checks a calibration by an ordinary lively recording, and repairs it where that recording tells how."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from shared.calibration import CameraCalibration, ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import IntArray
from station.calibration.camera_imu.priors import Known
from station.calibration.camera_imu.rows import Samples
from station.calibration.camera_imu.start import match_turning
from station.calibration.camera_imu.unknowns import DELAY, GRAVITY, MOUNT_POSITION, MOUNT_ROTATION, SHIFT
from station.calibration.targetless import verdict
from station.calibration.targetless.adjustment import Problem
from station.calibration.targetless.batch import Solution, solve, with_focal_length
from station.calibration.targetless.beginning import begin
from station.calibration.targetless.rows import Inertial
from station.calibration.targetless.tracks import follow, liveliest_part
from station.calibration.targetless.turning import camera_turns, planar_share
from station.calibration.targetless.verdict import Quantity
from station.model.frames import DriveSample, ImageFrame, ImuBatch

MIN_HEAD_RAD = 0.01


class Progress(Protocol):
    """What is told of the work while it goes on."""

    def step(self, description: str, total: int | None = None) -> None: ...
    def advance(self) -> None: ...


@dataclass(frozen=True, slots=True, eq=False)
class LivelyRecording:
    """What was recorded, and the calibration it is to be compared with."""

    frame_times_ns: IntArray
    read_frames: Callable[[], Iterable[ImageFrame]]
    imu: ImuBatch
    camera: CameraCalibration
    noise: ImuNoise
    gravity: float  # m/s^2
    drive: tuple[DriveSample, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationCheck:
    """What the recording says of the calibration."""

    told: CameraCalibration
    reasons: list[str]  # against the result
    solution: Solution | None  # None: nothing could be estimated
    quantities: list[Quantity]
    is_believed: bool = False  # the estimate explains what was measured

    @property
    def is_accepted(self) -> bool:
        return not self.reasons

    @property
    def fits(self) -> bool | None:
        """None: it does not tell all of it. Sooner than how to repair something, it tells that it is wrong."""
        if self.is_believed and any(quantity.is_surely_wrong for quantity in self.quantities):
            return False
        return True if self.is_accepted and not self.unseen else None

    @property
    def unseen(self) -> list[str]:
        """What this motion does not show of where the camera sits and when it sees, by name."""
        return [q.name for q in self.quantities if q.key in verdict.ASKED and not q.is_observable]

    @property
    def notes(self) -> list[str]:
        """What is seen of each quantity, and what was not used of the recording.

        An estimate that does not explain what was measured says nothing of any.
        """
        not_used = () if self.solution is None else self.solution.problem.seen.notes
        return [*(verdict.sentences(self.quantities) if self.is_believed else ()), *not_used]

    @property
    def repairs(self) -> list[str]:
        """What `repaired` replaces, by name."""
        return [q.name for q in self.quantities if self.is_believed and q.is_observable and not q.fits]

    @property
    def repaired(self) -> CameraCalibration:
        """What was told, but for what is observable and does not fit."""
        if self.solution is None or not self.is_believed:
            return self.told
        found, told = self.solution.estimate.camera, self.told
        wrong = {q.key for q in self.quantities if q.name in self.repairs}
        T, T_found = told.T_body_cam_matrix, found.T_body_cam_matrix
        if "rotation_deg" in wrong:
            T[:3, :3] = T_found[:3, :3]
        if "translation_m" in wrong:
            T[:3, 3] = T_found[:3, 3]
        changed: dict[str, Any] = {"T_body_cam": tuple(T.ravel().tolist())}
        if "focal_length" in wrong:
            changed |= {"fx": found.fx, "fy": found.fy}
        if wrong & {"time_shift_s", "line_delay_s"}:  # the first image row's shift goes with the delay of the others
            changed |= {"time_shift_s": found.time_shift_s, "line_delay_s": found.line_delay_s}
        return msgspec.structs.replace(told, **changed)

    def results(self) -> dict[str, Any]:
        """For scripts; numbers are null where nothing could be estimated."""
        out: dict[str, Any] = {"accepted": self.is_accepted, "reasons": self.reasons, "fits": self.fits}
        out["repairs"] = self.repairs
        out["notes"] = self.notes
        out["told"] = _numbers(self.told)
        if self.solution is None:
            return dict.fromkeys(ESTIMATED) | out
        return figures(self.solution, self.quantities) | _numbers(self.repaired) | out


ESTIMATED = (
    "T_body_cam", "time_shift_s", "line_delay_s", "intrinsics", "distortion", "gravity", "sigma", "rms_px", "rms_gyro",
    "rms_accel", "found", "away", "in_sigmas", "observable",
)  # fmt: skip


def _numbers(camera: CameraCalibration) -> dict[str, Any]:
    return {
        "T_body_cam": camera.T_body_cam_matrix.tolist(),
        "time_shift_s": camera.time_shift_s,
        "line_delay_s": camera.line_delay_s,
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "distortion": list(camera.distortion),
    }


def figures(solution: Solution, quantities: list[Quantity]) -> dict[str, Any]:
    def plain(values: Any) -> Any:
        return values.tolist() if len(values) > 1 else float(values[0])

    return {
        "gravity": solution.estimate.gravity.tolist(),
        "sigma": {
            "rotation_deg": np.degrees(solution.sigma(MOUNT_ROTATION)).tolist(),
            "translation_m": solution.sigma(MOUNT_POSITION).tolist(),
            "time_shift_s": float(solution.sigma(slice(SHIFT, SHIFT + 1))[0]),
            "line_delay_s": float(solution.sigma(slice(DELAY, DELAY + 1))[0]),
            "focal_length": solution.focal_sigma,
            "gravity": solution.sigma(GRAVITY).tolist(),
        },
        "rms_px": solution.rms_px,
        "rms_gyro": solution.rms_gyro,
        "rms_accel": solution.rms_accel,
        "found": _numbers(solution.estimate.camera),
        "away": {quantity.key: plain(quantity.away) for quantity in quantities},
        "in_sigmas": {quantity.key: plain(quantity.in_sigmas) for quantity in quantities},
        "observable": {quantity.key: quantity.is_observable for quantity in quantities},
    }


def check_calibration(recording: LivelyRecording, progress: Progress) -> CalibrationCheck:
    """What the liveliest part of a recording says of its calibration, or why it says nothing."""
    told = recording.camera
    if len(recording.imu) < 2:
        return CalibrationCheck(told, ["the recording holds no inertial readings: record the IMU as well"], None, [])
    origin_ns = int(recording.imu.t_robot_ns[0])
    samples = Samples.of(recording.imu, recording.noise, origin_ns)
    begin_s, end_s = liveliest_part(samples)
    t_s = 1e-9 * (recording.frame_times_ns - origin_ns)
    inside = (t_s >= begin_s) & (t_s <= end_s)
    part = samples.between(begin_s, end_s)
    reasons = verdict.too_little(part, int(inside.sum()))
    if any(max(abs(d.pan_rad), abs(d.tilt_rad)) > MIN_HEAD_RAD for d in recording.drive):
        reasons.append("the camera's head was turned: record with the head looking straight ahead")
    if reasons:
        return CalibrationCheck(told, reasons, None, [])
    first, last = recording.frame_times_ns[inside][[0, -1]]
    progress.step("following corners", int(inside.sum()))
    frames = (frame for frame in recording.read_frames() if first <= frame.t_robot_ns <= last)
    seen = follow(frames, told, samples, origin_ns, int(inside.sum()), progress.advance)
    progress.step("turning")
    try:
        turns, agreeing = camera_turns(seen, told.fx)
        match = match_turning(turns, samples.t_s, samples.gyro)
        reasons = verdict.poor_turning(match)
        if reasons:
            reasons = verdict.planar_scene(match, planar_share(seen, told.fx)) or reasons
            return CalibrationCheck(told, reasons, None, [])
        inertial = Inertial(recording.imu, recording.noise, samples, origin_ns)
        seen = seen.chosen(agreeing)
        start = begin(told, seen, match, inertial, recording.gravity)
        problem = Problem(seen, inertial, Known(told, np.zeros(8), recording.gravity, recording.noise))
        with threadpool_limits(1):  # as in camera_imu/calibrate.py
            solution = solve(problem, start, progress.step)
            found = verdict.quantities(solution, told, match)
            if any(q.key == "focal_length" and q.is_observable and not q.fits for q in found):
                solution = with_focal_length(solution, progress.step)
                found = verdict.quantities(solution, told, match)
    except DegenerateGeometry as exc:
        return CalibrationCheck(told, [f"{exc}: {verdict.WAVE}"], None, [])
    reasons = verdict.poor_fit(solution, match)
    is_believed = not reasons
    if reasons:
        reasons = verdict.planar_scene(match, planar_share(seen, told.fx)) or reasons
    return CalibrationCheck(told, reasons or verdict.too_vague(found), solution, found, is_believed)
