"""The ukf backend: front end, start, filter, keyframes, landmarks; loses tracking honestly and starts again.

`add_frame` is the reading path. Pure: no clock, no thread; the same data give the same result, bit for bit.
"""

from __future__ import annotations

import platform
from dataclasses import asdict, replace

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import scipy
from threadpoolctl import ThreadpoolController

from shared.calibration import Calibration
from shared.errors import ConfigError, DataError, EstimationError
from shared.geometry import FloatArray, se3
from station.frames import DriveSample, ImageFrame, ImuBatch
from station.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.slam.backend import SlamUpdate, TrackingState
from station.slam.frontend.tracker import TrackedFrame, Tracker
from station.slam.ukf import lie
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.constraints import BodyVelocity, SamePlace, turn_between, wheel_velocity
from station.slam.ukf.filter import FrameResult, RetiredClone, SoftConstraint, VioFilter
from station.slam.ukf.inertial import ImuBuffer
from station.slam.ukf.keyframes import Keyframe, KeyframeStore, is_grey, sample_colours, sample_grey
from station.slam.ukf.landmark_map import Observations, assemble, make_landmarks
from station.slam.ukf.live_map import LiveMap
from station.slam.ukf.measurement import CameraModel
from station.slam.ukf.pose_log import PoseLog
from station.slam.ukf.preintegration import Preintegration, chain, preintegrate
from station.slam.ukf.propagation import ImuSegment
from station.slam.ukf.refine import refine_segment
from station.slam.ukf.start import ORIGIN, Anchor, GivenState, Starter, WaitingFrame, state_from_given
from station.slam.ukf.state import FilterState
from station.slam.ukf.stillness import StillnessDetector
from station.slam.ukf.update import is_finite

NO_LINK_NS = 10**9  # frames further apart than that are not linked by the IMU


class UkfBackend:
    """A SlamBackend."""

    def __init__(
        self,
        calibration: Calibration,
        config: UkfConfig | None = None,
        seed: int = 0,
        initial_state: GivenState | None = None,
    ) -> None:
        """Args: initial_state: when given, the filter starts from it at the first frame instead of by itself."""
        if calibration.camera is None:
            raise ConfigError("the ukf backend needs a camera, and the calibration has none; give one")
        if calibration.imu is None:
            raise ConfigError("the ukf backend needs an IMU, and the calibration has none; use --backend sfm")
        cv2.setNumThreads(1)  # order of additions, hence every last bit, must not depend on the machine
        self._blas = ThreadpoolController()  # the same for BLAS
        self._calibration = calibration
        self._config = config or UkfConfig()
        self._seed = seed
        self._given = initial_state
        self._camera = CameraModel.of(calibration.camera, self._config.filter.sigma_px)
        self._shift_ns = round(
            (calibration.camera.time_shift_s + self._camera.middle_row * self._camera.line_delay_s) * 1e9
        )
        self._imu = ImuBuffer(calibration.imu)
        self._tracker = Tracker(self._camera.lens, self._config.tracker, seed)
        self._still = StillnessDetector(self._config.start)
        self._starter = Starter(
            self._camera, calibration.imu, calibration.gravity, self._config.start, self._config.filter.error
        )
        self._filter: VioFilter | None = None
        self._anchor = ORIGIN
        self._segment = 0
        self._is_lost = False
        self._drive: DriveSample | None = None  # the newest command
        self._speed_since = 0  # when the commanded speed last changed
        self._keyframes = KeyframeStore(self._config.max_keyframes)
        self._poses = PoseLog()
        self._live = LiveMap(self._camera, self._config.quality)
        self._window: dict[int, _WindowFrame] = {}  # frames whose clones are in the filter, or waiting for a start
        self._previous_t: int | None = None  # IMU time of the frame before
        self._frame_times: list[int] = []
        self._lost_since: int | None = None
        self._lost_ns = 0
        self._outage_since: int | None = None
        self._counts = {"frames_out_of_order": 0, "frames_undecodable": 0, "frames_without_imu": 0}
        self._messages: list[str] = []

    def add_imu(self, imu: ImuBatch) -> None:
        """Samples that are not numbers, repeated or late are counted and left out."""
        self._imu.add(imu)

    def add_drive(self, drive: DriveSample) -> None:
        if np.isfinite(drive.linear_m_s) and np.isfinite(drive.angular_rad_s):
            if self._drive is None or abs(drive.linear_m_s - self._drive.linear_m_s) > 0.02:
                self._speed_since = drive.t_robot_ns
            self._drive = drive

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        """Take one frame in. Raises ConfigError when the image has another size than the calibration's."""
        with self._blas.limit(limits=1):
            return self._add_frame(frame)

    def _add_frame(self, frame: ImageFrame) -> SlamUpdate:
        t_imu = frame.t_robot_ns + self._shift_ns
        if self._frame_times and frame.t_robot_ns <= self._frame_times[-1]:
            self._counts["frames_out_of_order"] += 1
            return self._refused(frame, "image out of order: left out")
        try:
            grey = frame.grey()
        except DataError as exc:
            self._counts["frames_undecodable"] += 1
            return self._refused(frame, str(exc))
        self._check_size(frame, grey.shape)
        self._frame_times.append(frame.t_robot_ns)
        if not self._has_imu_at(t_imu):
            self._counts["frames_without_imu"] += 1
            if self._filter is not None and self._imu_missing_s(t_imu) > self._config.max_imu_gap_s:
                self._lose("the IMU stopped", t_imu)
            if self._filter is None:
                return self._update(frame, "not initialised yet: needs IMU samples", None)
        previous = self._previous_t if self._previous_t is not None else t_imu
        segment = self._imu.segment(previous, t_imu)
        tracked = self._tracker.process(grey, self._predicted_turn(segment), self._filter is not None)
        is_still = self._still.update(t_imu, tracked, self._imu.samples(t_imu - 10**9, t_imu))
        self._previous_t = t_imu
        rgb = sample_grey(grey, tracked.uv_px) if is_grey(frame.encoded) else None
        current = _WindowFrame(frame, tracked, t_imu, None, self._wheels(segment, t_imu), rgb)
        if self._filter is None:
            update = self._wait_for_start(current, is_still)
        else:
            update = self._track(self._filter, current, segment, is_still)
        self._imu.forget_before(t_imu - int((self._config.start.max_window_s + 0.5) * 1e9))
        return update

    # ---- tracking

    def _track(self, vio: VioFilter, current: _WindowFrame, segment: ImuSegment, is_still: bool) -> SlamUpdate:
        frame = current.frame
        soft: list[SoftConstraint] = []
        if is_still and self._config.wheels.use_zero_velocity and not self._is_commanded_to_move():
            soft.append(BodyVelocity(np.zeros(3), np.full(3, self._config.wheels.sigma_still_m_s)))
            same = self._same_place(vio, current)
            soft += [] if same is None else [same]
        elif current.wheels is not None:
            soft.append(BodyVelocity(*current.wheels, gate=4.0))
        keep_previous = self._still_since == self._newest_frame
        if not is_still:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = frame.index
        self._newest_frame = frame.index
        current.link = self._link(vio, segment)
        self._window[frame.index] = current
        result = vio.process_frame(segment, current.tracked, frame.index, tuple(soft), keep_previous)
        self._tracker.drop(result.rejected_ids)
        reason = self._why_lost(vio, current, result)
        if reason is not None:
            return self._lose(reason, current.t_imu_ns, frame)
        self._poses.add(frame.index, current.t_imu_ns, vio.state.T_world_body, self._segment)
        new_points = [self._retire(retired, vio.state) for retired in result.retired]
        if result.new_landmark_ids.size:
            self._live.entered(result.new_landmark_ids, vio.state)
        points = [p for p in new_points if p is not None]
        return self._update(
            frame,
            f"tracking: {result.num_landmarks} landmarks in the filter, {self._live.count} in the map",
            vio.state,
            is_keyframe=any(r.is_keyframe for r in result.retired),
            points=points[0] if points else None,
        )

    _still_since: int | None = None  # frame index with which standing still began
    _newest_frame = -1

    def _same_place(self, vio: VioFilter, current: _WindowFrame) -> SamePlace | None:
        """Standing still: the pose of the frame with which that began, and the turn since then by the image."""
        since = self._still_since
        if since is None or since not in self._window or since not in vio.state.clone_frame:
            self._still_since = None
            return None
        then, now = self._window[since].tracked, current.tracked
        _, i, j = np.intersect1d(then.ids, now.ids, assume_unique=True, return_indices=True)
        turn = turn_between(then.xy[i], now.xy[j], self._camera.R_body_cam)
        wheels = self._config.wheels
        return None if turn is None else SamePlace(since, turn, wheels.sigma_still_rad, wheels.sigma_still_m)

    def _why_lost(self, vio: VioFilter, current: _WindowFrame, result: FrameResult) -> str | None:
        """The reason to give up tracking, in words; None while it is sound."""
        if not is_finite(vio.state):
            return "the estimate stopped making sense"
        if current.tracked.num_tracked < self._config.min_features:
            if self._outage_since is None:
                self._outage_since = current.t_imu_ns
            limit = self._config.max_outage_s if current.wheels is None else self._config.max_outage_wheels_s
            if (current.t_imu_ns - self._outage_since) * 1e-9 > limit:
                return "the image shows nothing to follow"
        else:
            self._outage_since = None
        if current.wheels is not None:
            climbs = abs(float(vio.state.v[2])) > self._config.max_climb_m_s
            tilts = float(vio.state.R[2, 2]) < self._config.min_upright
            self._lifted = self._lifted + 1 if climbs or tilts else 0
            if self._lifted >= 3:
                return "the robot is being lifted"
        speed = float(np.linalg.norm(vio.state.v))
        if speed > self._config.max_speed_m_s:
            return f"the estimated speed of {speed:.0f} m/s is impossible"
        tried = result.num_landmarks_observed
        if tried >= 6 and result.num_landmarks_passed < 0.3 * tried:
            self._disagreements += 1
        else:
            self._disagreements = 0
        if self._disagreements >= self._config.max_disagreements:
            return "image and IMU contradict each other"
        return None

    _disagreements = 0
    _lifted = 0

    def _retire(self, retired: RetiredClone, state: FilterState) -> tuple[FloatArray, FloatArray] | None:
        """A pose left the window: log it, keep it as keyframe or join its IMU link to the next; new map points."""
        old = self._window.pop(retired.frame_index, None)
        self._poses.improve(retired.frame_index, retired.T_world_body)
        if old is None:
            return None
        if not retired.is_keyframe:
            after = self._window.get(min((i for i in self._window if i > retired.frame_index), default=-1))
            if after is not None:
                joined = None if old.link is None or after.link is None else chain(old.link, after.link)
                after.link = joined
            return None
        keyframe = Keyframe(
            image=old.frame,
            tracked=old.tracked,
            rgb=old.rgb if old.rgb is not None else sample_colours(old.frame.bgr(), old.tracked.uv_px),
            T_world_body=retired.T_world_body,
            v_world=retired.v_world,
            omega_body=retired.omega_body,
            bias=np.concatenate([state.bias_gyro, state.bias_accel]),
            segment=self._segment,
            link=old.link,
            wheels=old.wheels,
        )
        self._keyframes.add(keyframe)
        return self._live.add(keyframe)

    def _link(self, vio: VioFilter, segment: ImuSegment) -> Preintegration | None:
        if not len(segment.dt_s) or segment.dt_s.sum() * 1e9 > NO_LINK_NS:
            return None
        assert self._calibration.imu is not None
        bias = np.concatenate([vio.state.bias_gyro, vio.state.bias_accel])
        return preintegrate(segment, bias, self._calibration.imu)

    # ---- starting and losing

    def _wait_for_start(self, current: _WindowFrame, is_still: bool) -> SlamUpdate:
        frame = current.frame
        kind = self._config.filter.error
        self._window[frame.index] = current
        if self._given is not None:
            given, self._given = replace(self._given, t_imu_ns=current.t_imu_ns), None
            return self._start(state_from_given(given, kind), current, False)
        v_body, sigma = current.wheels or (np.zeros(3), np.full(3, np.inf))
        waiting = WaitingFrame(frame.index, current.t_imu_ns, current.tracked, v_body, sigma)
        found = self._starter.try_start(waiting, self._imu, is_still, self._anchor)
        if isinstance(found, str):
            for index in [i for i, w in self._window.items() if w.t_imu_ns < current.t_imu_ns - 4 * 10**9]:
                del self._window[index]
            return self._update(frame, f"not initialised yet: {found}", None)
        state, motion = found
        if motion is None:
            return self._start(state, current, True)
        return self._start_in_motion(state, motion.frame_index.tolist(), current)

    def _start(self, state: FilterState, current: _WindowFrame, is_still: bool) -> SlamUpdate:
        """Begin tracking at this frame, from a state without clones."""
        self._begin_segment()
        self._window = {current.frame.index: current}
        self._filter = VioFilter(self._calibration, self._config.filter, state)
        empty = self._imu.segment(current.t_imu_ns, current.t_imu_ns)
        self._filter.process_frame(empty, current.tracked, current.frame.index)
        self._newest_frame = current.frame.index
        self._still_since = current.frame.index if is_still else None
        self._poses.add(current.frame.index, current.t_imu_ns, self._filter.state.T_world_body, self._segment)
        return self._update(current.frame, "tracking: started", self._filter.state)

    def _start_in_motion(self, state: FilterState, clones: list[int], current: _WindowFrame) -> SlamUpdate:
        """Begin tracking from a solved window: its frames are the first clones, its tracks the first landmarks."""
        self._begin_segment()
        vio = VioFilter(self._calibration, self._config.filter, state)
        self._filter = vio
        kept = {i: self._window[i] for i in clones}
        bias = np.concatenate([state.bias_gyro, state.bias_accel])
        assert self._calibration.imu is not None
        before: _WindowFrame | None = None
        for index in clones:
            item = kept[index]
            if before is not None:
                item.link = preintegrate(self._imu.segment(before.t_imu_ns, item.t_imu_ns), bias, self._calibration.imu)
            vio.tracks.add_frame(item.tracked, np.zeros(0, dtype=np.int64))
            before = item
        vio.adopt_landmarks()
        for k, index in enumerate(clones):
            item = kept[index]
            T = se3(vio.state.clone_R[k], vio.state.clone_x[k])
            self._poses.add(index, item.t_imu_ns, T, self._segment)
        self._window = kept
        return self._update(current.frame, "tracking: started in motion", vio.state)

    def _begin_segment(self) -> None:
        if self._lost_since is not None:
            self._lost_ns += self._frame_times[-1] - self._lost_since
            self._lost_since = None
            self._segment += 1
        self._is_lost = False
        self._outage_since = None
        self._disagreements = self._lifted = 0

    def _lose(self, reason: str, t_imu_ns: int, frame: ImageFrame | None = None) -> SlamUpdate:
        """Stop tracking: what was estimated before the trouble stays, the next start is a new segment."""
        vio = self._filter
        assert vio is not None
        self._flush_window(vio)
        began = self._outage_since if self._outage_since is not None else t_imu_ns
        self._poses.drop_after(began, self._segment)
        last = self._poses.last()
        bias = np.concatenate([vio.state.bias_gyro, vio.state.bias_accel])
        sound = is_finite(vio.state) and float(np.abs(bias[:3]).max()) < 0.2 and float(np.abs(bias[3:]).max()) < 1.0
        T = last if last is not None else np.eye(4)
        yaw = float(np.arctan2(T[1, 0], T[0, 0]))
        self._anchor = Anchor(T[:3, 3].copy(), yaw, bias if sound else None)
        self._filter = None
        self._is_lost = True
        self._lost_since = self._frame_times[-1]
        self._outage_since = None
        self._messages.append(f"tracking lost after {self._elapsed_s():.1f} s: {reason}")
        self._starter.reset()
        self._window = {}
        if frame is None:
            frame = ImageFrame(-1, self._frame_times[-1], 0, b"")
        return self._update(frame, f"tracking lost: {reason}", None)

    def _flush_window(self, vio: VioFilter) -> None:
        """All poses still in the window become keyframes: nothing will improve them any more."""
        if not is_finite(vio.state):
            return
        state = vio.state
        outage = self._outage_since
        for k in range(state.num_clones):
            index = int(state.clone_frame[k])
            item = self._window.get(index)
            if item is not None and outage is not None and item.t_imu_ns >= outage:
                continue
            clone = RetiredClone(
                index, se3(state.clone_R[k], state.clone_x[k]), True, state.clone_v[k], state.clone_omega[k]
            )
            self._retire(clone, state)

    # ---- the end

    def finish(self) -> Navigation:
        """End the navigation. Raises EstimationError, with the reason, when nothing could be reconstructed."""
        with self._blas.limit(limits=1):
            return self._finish()

    def _finish(self) -> Navigation:
        if self._filter is not None:
            self._flush_window(self._filter)
        if self._lost_since is not None:
            self._lost_ns += self._frame_times[-1] - self._lost_since
        if not self._frame_times:
            raise EstimationError("no usable image came; the ukf backend needs images and IMU samples")
        if not len(self._poses) or not self._keyframes.items:
            raise EstimationError(f"tracking never started: {self._last_message}")
        if self._config.refine and self._config.landmarks == "default":
            self._refine()
        keyframes = self._keyframes.items
        landmarks = self._landmarks(keyframes)
        t, T = self._poses.arrays()
        trajectory = Trajectory(t, T)
        return Navigation(
            id=f"ukf-{self._frame_times[0]}",
            calibration=self._calibration,
            trajectory=trajectory,
            keyframes=Keyframes(
                frame_index=np.array([k.image.index for k in keyframes], dtype=np.int64),
                t_robot_ns=np.array([k.image.t_robot_ns for k in keyframes], dtype=np.int64),
                T_world_cam=np.array([k.T_world_body for k in keyframes]) @ self._T_body_cam(),
                encoded=tuple(k.image.encoded for k in keyframes),
                segment=np.array([k.segment for k in keyframes], dtype=np.int64),
            ),
            landmarks=landmarks,
            report=self._report(len(landmarks)),
        )

    def _refine(self) -> None:
        """Better keyframes by least squares; the frames between follow their keyframes."""
        assert self._calibration.imu is not None
        refined: list[Keyframe] = []
        for number in range(self._segment + 1):
            part = self._keyframes.segment(number)
            better, messages = refine_segment(part, self._camera, self._calibration.imu, self._calibration.gravity)
            self._messages += messages
            self._poses.follow(
                [k.image.index for k in part],
                np.array([k.T_world_body for k in part]),
                np.array([k.T_world_body for k in better]),
                number,
            )
            refined += better
        self._keyframes.items = refined

    def _landmarks(self, keyframes: list[Keyframe]) -> Landmarks:
        if self._config.landmarks == "thesis":
            ids, p, cov = self._live.as_entered()
            return assemble(ids, p, cov, Observations.of(keyframes))
        return make_landmarks(keyframes, self._camera, self._config.quality)

    def _report(self, num_landmarks: int) -> NavigationReport:
        counts = self._imu.counts
        messages = list(self._messages)
        refused = {
            "IMU samples that were no numbers or absurd": counts.not_finite,
            "IMU samples that were repeated or late": counts.out_of_order,
            "IMU samples at the sensor's range": counts.saturated,
            "gaps in the IMU data": counts.gaps,
            "images out of order": self._counts["frames_out_of_order"],
            "images that could not be decoded": self._counts["frames_undecodable"],
            "images without IMU samples": self._counts["frames_without_imu"],
        }
        messages += [f"{count} {what}" for what, count in refused.items() if count]
        return NavigationReport(
            backend="ukf",
            frames=len(self._frame_times),
            duration_s=self._elapsed_s(),
            wall_s=0.0,
            realtime_factor=0.0,
            cpu_s=0.0,
            landmarks=num_landmarks,
            tracking_lost_s=self._lost_ns * 1e-9,
            scale="metric",
            gravity_aligned=True,
            seed=self._seed,
            versions={
                "python": platform.python_version(),
                "numpy": np.__version__,
                "scipy": scipy.__version__,
                "opencv": cv2.__version__,
            },
            config=msgspec.to_builtins(asdict(self._config)),
            messages=tuple(messages),
        )

    # ---- small helpers

    def _update(
        self,
        frame: ImageFrame,
        message: str,
        state: FilterState | None,
        is_keyframe: bool = False,
        points: tuple[FloatArray, FloatArray] | None = None,
    ) -> SlamUpdate:
        name: TrackingState = "tracking" if state is not None else ("lost" if self._is_lost else "initialising")
        self._last_message = message
        return SlamUpdate(
            t_robot_ns=frame.t_robot_ns,
            state=name,
            message=message,
            T_world_body=None if state is None else state.T_world_body,
            num_landmarks=0 if state is None else state.num_landmarks,
            is_keyframe=is_keyframe,
            new_points_world=None if points is None else points[0],
            new_points_rgb=None if points is None else points[1],
            segment=self._segment,
        )

    _last_message = "no image came"

    def _refused(self, frame: ImageFrame, message: str) -> SlamUpdate:
        """The answer to a frame that was left out: the state stays what it was."""
        state = self._filter.state if self._filter is not None else None
        return self._update(frame, message, state)

    def _check_size(self, frame: ImageFrame, shape: tuple[int, ...]) -> None:
        camera = self._camera.lens.camera
        if shape[:2] != (camera.height, camera.width):
            raise ConfigError(
                f"image {frame.name or frame.index} is {shape[1]}x{shape[0]}, the calibration is for "
                f"{camera.width}x{camera.height}; give the calibration of these images"
            )

    def _imu_missing_s(self, t_imu: int) -> float:
        last = self._imu.last_t_ns
        return 1e9 if last is None else (t_imu - last) * 1e-9

    def _has_imu_at(self, t_imu: int) -> bool:
        """Whether IMU samples reach to about this time and from the frame before."""
        first = self._imu.first_t_ns
        return first is not None and first <= t_imu and self._imu_missing_s(t_imu) < 0.05

    def _predicted_turn(self, segment: ImuSegment) -> FloatArray:
        """R_prev_cur of the camera by the gyroscope."""
        bias = np.zeros(3)
        if self._filter is not None:
            bias = self._filter.state.bias_gyro
        elif self._anchor.bias is not None:
            bias = self._anchor.bias[:3]
        R = np.eye(3)
        for turn in lie.so3_exp((segment.gyro - bias) * segment.dt_s[:, None]):
            R = R @ turn
        return self._camera.R_body_cam.T @ R @ self._camera.R_body_cam

    def _is_commanded_to_move(self) -> bool:
        return self._drive is not None and (self._drive.linear_m_s != 0.0 or self._drive.angular_rad_s != 0.0)

    def _wheels(self, segment: ImuSegment, t_imu: int) -> tuple[FloatArray, FloatArray] | None:
        """What the wheels say of the body velocity now."""
        if self._calibration.robot_kind != "sentinel":
            return None
        bias = self._filter.state.bias_gyro if self._filter is not None else np.zeros(3)
        command, since = None, 0.0
        if self._drive is not None:
            command, since = self._drive.linear_m_s, (t_imu - self._speed_since) * 1e-9
        known = wheel_velocity(self._config.wheels, float(segment.end_gyro[2] - bias[2]), command, since)
        return None if known is None else (known.v_body, known.sigma)

    def _elapsed_s(self) -> float:
        return (self._frame_times[-1] - self._frame_times[0]) * 1e-9

    def _T_body_cam(self) -> FloatArray:
        return se3(self._camera.R_body_cam, self._camera.t_body_cam)


class _WindowFrame:
    """A frame whose clone is in the filter, or that waits for a start."""

    def __init__(
        self,
        frame: ImageFrame,
        tracked: TrackedFrame,
        t_imu_ns: int,
        link: Preintegration | None,
        wheels: tuple[FloatArray, FloatArray] | None,
        rgb: npt.NDArray[np.uint8] | None,
    ) -> None:
        self.frame, self.tracked, self.t_imu_ns, self.link, self.wheels = frame, tracked, t_imu_ns, link, wheels
        self.rgb = rgb  # (N, 3) where the image is grey; None: to be decoded when it becomes a keyframe
