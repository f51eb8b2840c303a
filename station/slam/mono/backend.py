"""The mono backend: MonoSLAM over the frames of one camera. Every frame gives a pose at once; the scale is arbitrary.

Reading path: `add_frame`, `MonoFilter.process` (filter.py), then motion.py, measurement.py and state.py with the
equations of thesis 2.1 and appendix C. docs/studies/monoslam.md says what to learn from it. Pure: nothing random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from shared.calibration import Calibration
from shared.errors import ConfigError, EstimationError
from shared.geometry import inverse, se3, upright
from station.model.frames import DriveSample, ImageArray, ImageFrame, ImuBatch
from station.model.navigation import Navigation, Trajectory
from station.model.slam_update import SlamUpdate, TrackingState
from station.slam.mapping.intake import FrameIntake
from station.slam.mapping.report import make_report
from station.slam.mono.config import MonoConfig
from station.slam.mono.filter import FrameResult, MonoFilter
from station.slam.mono.patches import PatchFinder
from station.slam.ukf.map.map_log import MapLog
from station.vision.camera_model import CameraModel

CAMERA_UP = np.array([0.0, -1.0, 0.0])  # cameras are mostly held upright, and nothing else says where up is


class MonoBackend:
    def __init__(self, calibration: Calibration, config: MonoConfig | None = None) -> None:
        if calibration.camera is None:
            raise ConfigError("the mono backend needs a camera, and the calibration has none; give one")
        cv2.setNumThreads(1)  # its images are patches
        self._calibration = calibration
        self._config = config or MonoConfig()
        self._camera = CameraModel.of(calibration.camera, self._config.sigma_px)
        self._intake = FrameIntake(calibration.camera)
        self._log = MapLog(self._camera, self._config.landmarks, self._config.keyframe_flow)
        self._finder = PatchFinder(self._camera.lens, self._config)
        self.filter: MonoFilter | None = None  # of the running segment
        self.last: FrameResult | None = None  # what it made of the last frame
        self._T_body_cam = calibration.camera.T_body_cam_matrix
        self._T_cam_body = inverse(self._T_body_cam)
        R_cam_body = self._T_cam_body[:3, :3]
        # The last one that is known: at first the origin, at yaw 0
        self._T_world_body = se3(upright(CAMERA_UP, R_cam_body) @ R_cam_body, np.zeros(3))
        self._segment = -1
        self._num_features = 0  # of all segments so far
        self._times_ns: list[int] = []  # times of the images that the running filter took
        self._found_ns = 0  # when enough features were found last
        self._lost_ns = 0
        self._messages: list[str] = []

    def add_imu(self, imu: ImuBatch) -> None:
        """Images only."""

    def add_drive(self, drive: DriveSample) -> None:
        """Images only."""

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        """Take one frame in. Raises ConfigError when the image has another size than the calibration's."""
        grey = self._intake.take(frame)
        if isinstance(grey, str):
            return self._update(frame, grey)
        self._finder.look_at(grey)
        if self.filter is None:
            return self._start(frame, grey)
        try:
            result = self.filter.process((frame.t_robot_ns - self._times_ns[-1]) * 1e-9, self._finder)
        except np.linalg.LinAlgError:
            return self._lose(frame, "the filter contradicts itself")
        self._take_over(self.filter, result, frame)
        if result.num_found >= self._config.min_found:
            return self._tracked(self.filter, result, frame, grey)
        if frame.t_robot_ns - self._found_ns > self._config.max_outage_s * 1e9:
            return self._lose(frame, "too few features are found again")
        return self._update(frame, f"tracking: only {result.num_found} features found")

    def _start(self, frame: ImageFrame, grey: ImageArray) -> SlamUpdate:
        """A filter whose world is this camera; it stands where the last one was lost, for want of a better place."""
        mono = MonoFilter(self._camera.lens, self._config, self._num_features)
        result = mono.process(0.0, self._finder)
        # Shades alone begin in a mirror image as easily as in the room: each counts as what it says beside a corner.
        if (np.linalg.det(mono.state.noise) ** -0.5).sum() < self._config.min_found:
            self._finder.keep(mono.state.ids[:0])
            return self._update(frame, "not initialised yet: needs something with corners in view")
        self.filter, self._segment, self._times_ns = mono, self._segment + 1, []
        self._T_world_filter = self._T_world_body @ self._T_body_cam
        if self._segment:
            self._lost_ns += frame.t_robot_ns - self._found_ns
        self._take_over(mono, result, frame)
        return self._tracked(mono, result, frame, grey)

    def _take_over(self, mono: MonoFilter, result: FrameResult, frame: ImageFrame) -> None:
        """What a frame gave, and what is better known by now of the poses before."""
        self.last = result
        self._finder.keep(mono.state.ids)
        self._times_ns.append(frame.t_robot_ns)
        for t_ns, state in zip(self._times_ns[-len(result.again) :], result.again, strict=False):
            if t_ns in self._log.poses:
                self._log.poses[t_ns] = self._T_world_filter @ state.T_world_cam @ self._T_cam_body

    def _tracked(self, mono: MonoFilter, result: FrameResult, frame: ImageFrame, grey: ImageArray) -> SlamUpdate:
        """A frame whose pose is known."""
        self._found_ns = frame.t_robot_ns
        self._T_world_body = self._T_world_filter @ mono.state.T_world_cam @ self._T_cam_body
        self._log.poses[frame.t_robot_ns] = self._T_world_body
        is_keyframe, points = self._log.add(frame, grey, result.ids, result.uv_px, self._segment)
        update = self._update(frame, f"tracking: {result.num_found} of {len(result.expected.rows)} features found")
        update = replace(update, T_world_body=self._T_world_body, is_keyframe=is_keyframe)
        return update if points is None else replace(update, new_points_world=points[0], new_points_rgb=points[1])

    def _lose(self, frame: ImageFrame, reason: str) -> SlamUpdate:
        """What was estimated before the trouble stays; the next start is a new segment with a scale of its own."""
        assert self.filter is not None
        self._num_features, self.filter = self.filter.next_id, None
        self._messages.append(f"tracking lost after {self._intake.elapsed_s:.1f} s: {reason}")
        return self._update(frame, f"tracking lost: {reason}")

    def _update(self, frame: ImageFrame, message: str) -> SlamUpdate:
        """A frame without a pose of its own."""
        state: TrackingState = "initialising" if self._segment < 0 else "lost"
        state, number = (state, 0) if self.filter is None else ("tracking", len(self.filter.state.ids))
        segment = max(self._segment, 0)
        return SlamUpdate(frame.t_robot_ns, state, message, None, number, False, segment=segment, scale="arbitrary")

    # ---- the end

    def catch_up(self) -> bool:
        """Nothing waits."""
        return False

    def keyframe_pictures(self) -> Sequence[bytes]:
        return self._log.encoded

    def keyframe_features(self, number: int) -> None:
        """None: its patches are not features that localisation uses."""

    def finish(self) -> Navigation:
        """End the navigation. Raises EstimationError, with the reason, when nothing could be reconstructed."""
        intake, poses = self._intake, self._log.poses
        if not poses:
            none = "no usable image came; the mono backend needs images"
            raise EstimationError("tracking never started: no image had enough corners" if intake.used else none)
        if self.filter is None:
            self._lost_ns += intake.last_t_ns - self._found_ns
        if self._segment:
            self._messages.append(f"{self._segment + 1} pieces, each with a scale and a frame of its own")
        keyframes, landmarks = self._log.map()
        report = make_report("mono", intake, self._config, self._lost_ns * 1e-9, 0, False, self._messages)
        shift_ns = round(self._camera.lens.camera.middle_row_shift_s * 1e9)
        trajectory = Trajectory(np.array(list(poses)) + shift_ns, np.array(list(poses.values())))
        report = replace(report, landmarks=len(landmarks))
        return Navigation(f"mono-{intake.first_t_ns}", self._calibration, trajectory, keyframes, landmarks, report)
