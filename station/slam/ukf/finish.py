"""The end of a navigation: keyframes refined, tracks triangulated, all as a Navigation (docs/slam.md, sec. 10)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, se3
from station.model.best_camera import KnownCamera, corrected, misfit_of
from station.model.calibration_fit import CalibrationFit, newer
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.motion.imu_buffer import ImuCounts
from station.slam.mapping import report as mapping_report
from station.slam.mapping.assemble import make_keyframes
from station.slam.mapping.camera_fit import CameraFit
from station.slam.mapping.intake import FrameIntake
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.filter.constraints import WheelsKnown
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.landmark_map import TrackObservations, assemble, make_landmarks
from station.slam.ukf.map.pose_log import PoseLog
from station.slam.ukf.map.refine import refine_segment
from station.slam.ukf.map.view_map import BetterKnown, map_views
from station.slam.ukf.memory import NavigationMemory
from station.vision.camera_model import CameraModel


def make_navigation(
    navigation_id: str,
    memory: NavigationMemory,
    camera: CameraModel,
    calibration: Calibration,
    servo_errors: FloatArray,
    config: UkfConfig,
    report: NavigationReport,
    better: BetterKnown | None,
) -> Navigation:
    """Trajectory, keyframes and landmarks of the navigation; completes the report.

    Args:
        better: by a backend that builds on this one.
        calibration: as told; that of a map from views is corrected by what the drive says of it.
        servo_errors: (NUM_ERRORS,) of the head, as the drive's end knows them.
    """
    fit = memory.calibration_check.finish()
    made = _from_views(memory, camera, calibration, servo_errors, fit, config, better)
    made = made or _from_tracks(memory, camera, calibration, config)
    report = replace(
        report,
        landmarks=len(made.landmarks),
        config=report.config | made.facts,
        calibration_fit=fit if made.fit is None else newer(fit, made.fit),
        told_camera=None if made.calibration == calibration else calibration.camera,
    )
    report = replace(report, messages=tuple(filter(None, (*report.messages, *made.messages, misfit_of(report)))))
    trajectory = Trajectory(*memory.poses.arrays())
    return Navigation(navigation_id, made.calibration, trajectory, made.keyframes, made.landmarks, report)


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """The map of a navigation; the pose log has followed."""

    calibration: Calibration  # that it was made with
    keyframes: Keyframes
    landmarks: Landmarks
    fit: CalibrationFit | None  # what the map says of the told camera
    facts: dict[str, Any]  # for navigation.json
    messages: list[str]


def _from_views(
    memory: NavigationMemory,
    camera: CameraModel,
    calibration: Calibration,
    servo_errors: FloatArray,
    fit: CalibrationFit | None,
    config: UkfConfig,
    known: BetterKnown | None,
) -> _Made | None:
    """Loops closed and everything refined, by the camera as the drive's end knows it.

    Where views show little beside what was followed, their map places the keyframes and tracks are its landmarks.
    None where there are no views, or they share next to nothing.
    """
    if memory.views is None:
        return None
    assert calibration.camera is not None and calibration.imu is not None
    told = calibration.camera
    start = corrected(told, fit) if known is None else KnownCamera(known.camera, 0.0)
    made = map_views(
        memory.views,
        memory.poses,
        CameraFit.started(told, start),
        camera.sigma_px,
        calibration.imu,
        calibration.gravity,
        WheelsKnown.before_the_drive(config.wheels) if calibration.has_wheels else None,
        lambda: len(make_landmarks(memory.keyframes.items, camera, config.quality)),
        servo_errors,
        known,
    )
    if made is None:
        return None
    facts = {"mapped_from": "views", "loops": made.num_loops, "median_error_px": made.median_error_px}
    calibration = msgspec.structs.replace(calibration, camera=made.camera.camera)
    keyframes, landmarks = made.keyframes, made.landmarks
    if made.shows_little:  # but its loops, its metre and its camera are better than what tracks were followed with
        facts["mapped_from"] = "tracks"
        corrected_camera = CameraModel.of(made.camera.camera, camera.sigma_px)
        items = [moved_along(k, memory.poses, servo_errors, corrected_camera) for k in memory.keyframes.items]
        items = [replace(k, segment=made.piece_of.get(k.segment, k.segment)) for k in items]
        keyframes = _keyframes(items, corrected_camera)
        landmarks = make_landmarks(items, corrected_camera, config.quality, made.camera.late_s)
    return _Made(calibration, keyframes, landmarks, made.camera.judged(), facts, [])


def moved_along(keyframe: Keyframe, poses: PoseLog, servo_errors: FloatArray, camera: CameraModel) -> Keyframe:
    """The keyframe at the pose that its frame has now, its features seen by this camera."""
    tracked = replace(keyframe.tracked, xy=camera.lens.unproject(keyframe.tracked.uv_px))
    T = poses.pose_of(keyframe.image.index)
    if T is None:
        return replace(keyframe, tracked=tracked)
    T = T if keyframe.head is None else T @ keyframe.head.T_body_head(servo_errors)
    v_world = T[:3, :3] @ keyframe.T_world_head[:3, :3].T @ keyframe.v_world
    return replace(keyframe, tracked=tracked, T_world_head=T, v_world=v_world)


def _keyframes(items: list[Keyframe], camera: CameraModel) -> Keyframes:
    T_world_cam = np.array([k.T_world_head for k in items]) @ se3(camera.R_body_cam, camera.t_body_cam)
    segment = np.array([k.segment for k in items], dtype=np.int64)
    return replace(make_keyframes([k.image for k in items], T_world_cam), segment=segment)


def _from_tracks(memory: NavigationMemory, camera: CameraModel, calibration: Calibration, config: UkfConfig) -> _Made:
    """Keyframes refined window by window, every good track a landmark; or the landmarks as they entered the filter.

    By the told camera: a short flight, whose map this often is, knows its focal length no better (docs/robot.md).
    """
    is_thesis = config.landmarks == "thesis"
    messages = _refine(memory, camera, calibration) if config.refine and not is_thesis else []
    items = memory.keyframes.items
    keyframes = _keyframes(items, camera)
    if is_thesis:
        landmarks = assemble(*memory.live.as_entered(), TrackObservations.of(items))
    else:
        landmarks = make_landmarks(items, camera, config.quality)
    return _Made(calibration, keyframes, landmarks, None, {"mapped_from": "tracks"}, messages)


def _refine(memory: NavigationMemory, camera: CameraModel, calibration: Calibration) -> list[str]:
    """Better keyframes by least squares; the frames between follow their keyframes. What was not refined, in words."""
    assert calibration.imu is not None
    if any(k.T_body_head is not None for k in memory.keyframes.items):
        return ["the head was turned: keyframes were left as the filter had them"]
    refined: list[Keyframe] = []
    messages: list[str] = []
    for number in range(memory.segment + 1):
        part = memory.keyframes.segment(number)
        better, failed = refine_segment(part, camera, calibration.imu, calibration.gravity)
        messages += failed
        memory.poses.follow(
            [k.image.index for k in part],
            np.array([k.T_world_head for k in part]),
            np.array([k.T_world_head for k in better]),
            number,
        )
        refined += better
    memory.keyframes.items = refined
    return messages


def make_report(
    intake: FrameIntake, imu: ImuCounts, lost_s: float, seed: int, config: UkfConfig, messages: list[str]
) -> NavigationReport:
    """What a person should know of the run; times and the number of landmarks are filled in by others."""
    refused = {
        "IMU samples that were no numbers or absurd": imu.not_finite,
        "IMU samples that were repeated or late": imu.out_of_order,
        "IMU samples at the sensor's range": imu.saturated,
        "gaps in the IMU data": imu.gaps,
    }
    return mapping_report.make_report("ukf", intake, config, lost_s, seed, True, messages, refused)
