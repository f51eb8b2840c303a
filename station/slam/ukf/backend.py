"""The ukf backend: front end, start, filter, keyframes, landmarks; loses tracking honestly and starts again.

`_add_frame` is the reading path. Pure: no clock, no thread; the same data give the same result, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import cv2
import numpy as np
from threadpoolctl import ThreadpoolController

from shared.calibration import Calibration
from shared.errors import ConfigError, EstimationError
from shared.geometry import FloatArray, so3_exp
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate, TrackingState
from station.motion.drive_commands import WheelSpeed, commands_motion
from station.motion.head import NUM_ERRORS, PLAY, HeadPose, HeadThen, HeadTrack
from station.motion.imu_buffer import IN_THE_AIR, ON_WHEELS, ImuBuffer
from station.motion.preintegration import ImuSegment
from station.slam.mapping.intake import FrameIntake
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.filter.constraints import (
    BodyVelocity,
    Rolled,
    Standstill,
    WheelsKnown,
    wheel_velocity,
    with_way,
)
from station.slam.ukf.filter.filter import RetiredClone, SoftConstraint, VioFilter
from station.slam.ukf.filter.head import ServosKnown
from station.slam.ukf.filter.state import NO_HEAD, FilterState, add_wheels
from station.slam.ukf.filter.update import is_finite
from station.slam.ukf.finish import make_navigation, make_report
from station.slam.ukf.map.keyframes import is_grey, sample_grey
from station.slam.ukf.map.view_map import BetterKnown
from station.slam.ukf.map.views import MapViews
from station.slam.ukf.memory import NavigationMemory, Points, RecentFrame
from station.slam.ukf.monitor import CONTRADICTION, LIFTED, TrackingMonitor
from station.slam.ukf.start.coasting import Coasting
from station.slam.ukf.start.starter import (
    ORIGIN,
    Anchor,
    GivenState,
    Starter,
    WaitingFrame,
    driven_velocity,
    state_from_given,
)
from station.slam.ukf.start.stillness import StillnessDetector
from station.vision.camera_model import CameraModel
from station.vision.features import Features
from station.vision.klt import Tracker

IMU_REACH_S = 0.05  # the IMU may end that long before the frame: its last reading is held


class UkfBackend:
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
            raise ConfigError("this backend needs an IMU, and the calibration has none; use --backend sfm")
        cv2.setNumThreads(1)  # order of additions, hence every last bit, must not depend on the machine
        self._blas = ThreadpoolController()  # the same for BLAS
        self._calibration = calibration
        self._config = (config or UkfConfig()).for_robot(calibration.has_wheels)
        self._seed = seed
        self._given = initial_state
        self._camera = CameraModel.of(calibration.camera, self._config.filter.sigma_px)
        self._head = HeadTrack(calibration.head)
        self._previous_head: HeadPose | None = None
        self._servos_known: ServosKnown | None = None
        self._shift_ns = round(calibration.camera.middle_row_shift_s * 1e9)
        self._imu = ImuBuffer(calibration.imu, ON_WHEELS if calibration.has_wheels else IN_THE_AIR)
        self._tracker = Tracker(self._camera.lens, self._config.tracker, seed)
        self._intake = FrameIntake(calibration.camera)
        self._still = StillnessDetector(self._config.start)
        self._standstill = Standstill()
        self._starter = Starter(
            self._camera, calibration.imu, calibration.gravity, self._config.start, self._config.filter.error
        )
        self._filter: VioFilter | None = None
        self._monitor = TrackingMonitor(self._config)
        self._messages: list[str] = []
        self._memory = NavigationMemory(
            self._camera, calibration, self._config.quality, self._config.max_keyframes, self._make_views()
        )
        self._coasting = Coasting(ORIGIN, 0)
        self._is_lifted = False  # the robot was when tracking was lost
        self._drive: DriveSample | None = None  # the newest command
        # Recordings have changes of the command only, and a robot reports its rest.
        self._wheel_speed = WheelSpeed(hold_s=math.inf, efficiency=1.0)
        self._way_m = 0.0  # of the wheels, at the frame before
        self._wheels_known = WheelsKnown.before_the_drive(self._config.wheels)
        self._previous_t: int | None = None  # IMU time of the frame before
        self._lost_since: int | None = None
        self._lost_ns = 0
        self._last_message = "no image came"
        self.imu_needed_since_ns: int | None = None  # by a backend that builds on this one; None: by none
        self.newest: RecentFrame | None = None  # what was followed into the newest frame; None: it was left out

    def add_imu(self, imu: ImuBatch) -> None:
        """Samples that are not numbers, repeated or late are counted and left out."""
        self._imu.add(imu)

    def add_drive(self, drive: DriveSample) -> None:
        if np.isfinite(drive.linear_m_s) and np.isfinite(drive.angular_rad_s):
            self._drive = drive
            self._wheel_speed.add_drive(drive)
        if np.isfinite(drive.pan_rad) and np.isfinite(drive.tilt_rad):
            self._head.add(drive)

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        """Take one frame in. Raises ConfigError when the image has another size than the calibration's."""
        with self._blas.limit(limits=1):
            return self._add_frame(frame)

    def _add_frame(self, frame: ImageFrame) -> SlamUpdate:
        grey = self._intake.take(frame)
        self.newest = None
        if isinstance(grey, str):
            return self._update(frame, grey, self._filter.state if self._filter is not None else None)
        t_imu = frame.t_robot_ns + self._shift_ns
        if not self._has_imu_at(t_imu):
            self._intake.without_imu += 1
            if self._filter is not None and self._imu_missing_s(t_imu) > self._config.max_imu_gap_s:
                self._lose("the IMU stopped", t_imu, frame)
            if self._filter is None:
                return self._update(frame, "not initialised yet: needs IMU samples", None)
        previous = self._previous_t if self._previous_t is not None else t_imu
        segment = self._imu.segment(previous, t_imu)
        way_m = self._rolled_m(t_imu)
        head = self._head.pose(t_imu, previous)
        tracked = self._tracker.process(grey, self._predicted_turn(segment, head), self._filter is not None)
        is_still = self._still.update(t_imu, tracked, self._imu.samples(t_imu - 10**9, t_imu))
        is_still = is_still and (head is None or not head.is_turning)
        self._previous_t, self._previous_head = t_imu, head
        rgb = sample_grey(grey, tracked.uv_px) if is_grey(frame.encoded) else None
        current = RecentFrame(frame, tracked, t_imu, None, self._wheels(segment, is_still), rgb, head)
        current.is_still = is_still and not self._is_commanded_to_move()
        self.newest = current
        if self._filter is None:
            if self._lost_since is not None:
                efficiency = self._wheels_known.efficiency
                self._coasting.advance(segment, t_imu, None if way_m is None else efficiency * way_m)
            update = self._wait_for_start(current, is_still)
        else:
            update = self._track(self._filter, current, segment, is_still, way_m)
        oldest = t_imu - int((self._config.start.max_window_s + 0.5) * 1e9)
        self._imu.forget_before(min(oldest, oldest if self.imu_needed_since_ns is None else self.imu_needed_since_ns))
        return update

    # ---- tracking

    def _track(
        self, vio: VioFilter, current: RecentFrame, segment: ImuSegment, is_still: bool, way_m: float | None
    ) -> SlamUpdate:
        frame, memory = current.frame, self._memory
        soft = self._soft_constraints(vio.state, current, is_still)
        keep_previous = self._standstill.began_with_previous
        self._standstill.update(frame.index, is_still)
        link = memory.link_by(segment, vio.state)
        current.link = with_way(link, way_m, current.wheels, self._config.max_speed_m_s)
        memory.add(current)
        result = vio.process_frame(segment, current.tracked, frame.index, soft, keep_previous, current.head)
        current.head_then = self._head_then(vio, current.head)
        self._tracker.drop(result.rejected_ids)
        reason = self._monitor.why_lost(vio.state, current.tracked, current.t_imu_ns, current.wheels, result)
        if reason is not None:
            return self._lose(reason, current.t_imu_ns, frame, result.retired)
        memory.poses.add(frame.index, current.t_imu_ns, vio.state.T_world_body, memory.segment)
        new_points = [memory.retire(retired, vio.state) for retired in result.retired]
        if self._config.landmarks == "thesis":
            memory.live.entered(result.new_landmark_ids, vio.state)
        points = [p for p in new_points if p is not None]
        return self._update(
            frame,
            f"tracking: {result.num_landmarks} landmarks in the filter, {memory.live.count} in the map",
            vio.state,
            is_keyframe=any(r.is_keyframe for r in result.retired),
            points=points[0] if points else None,
        )

    def _soft_constraints(
        self, state: FilterState, current: RecentFrame, is_still: bool
    ) -> tuple[SoftConstraint, ...]:  # fmt: skip
        """What else is known of this moment: standing still, or what wheels can do."""
        wheels = self._config.wheels
        if is_still and wheels.use_zero_velocity and not self._is_commanded_to_move():
            still = BodyVelocity(np.zeros(3), np.full(3, wheels.sigma_still_m_s))
            since = self._standstill.since
            then = self._memory.recent.get(since) if since is not None else None
            same = self._standstill.same_place(
                None if then is None else then.tracked, current.tracked, state, self._camera.R_body_cam, wheels
            )
            return (still,) if same is None else (still, same)
        return () if current.wheels is None else (current.wheels,)

    # ---- starting and losing

    def _wait_for_start(self, current: RecentFrame, is_still: bool) -> SlamUpdate:
        frame = current.frame
        self._memory.add(current)
        if self._given is not None:
            given, self._given = replace(self._given, t_imu_ns=current.t_imu_ns), None
            return self._start(state_from_given(given, self._config.filter.error), current, False)
        ahead = current.head is None or not (current.head.is_turning or current.head.angles.any())
        waiting = WaitingFrame(frame.index, current.t_imu_ns, current.tracked, self._driven_velocity(current), ahead)
        found = self._starter.try_start(waiting, self._imu, is_still, self._coasting.at)
        if isinstance(found, str):
            self._memory.forget_waiting(current.t_imu_ns)
            return self._update(frame, f"not initialised yet: {found}", None)
        state, motion = found
        if motion is None:
            return self._start(state, current, is_still)
        return self._start_in_motion(state, motion.frame_index.tolist(), frame)

    def _start(self, state: FilterState, current: RecentFrame, is_still: bool) -> SlamUpdate:
        """Begin tracking at this frame, from a state without clones."""
        memory, frame = self._memory, current.frame
        self._begin_segment()
        memory.recent = {frame.index: current}
        self._filter = self._make_filter(state)
        empty = self._imu.segment(current.t_imu_ns, current.t_imu_ns)
        self._filter.process_frame(empty, current.tracked, frame.index, head=current.head)
        current.head_then = self._head_then(self._filter, current.head)
        self._standstill.update(frame.index, is_still)
        self._carry_on(current, self._filter.state)
        memory.poses.add(frame.index, current.t_imu_ns, self._filter.state.T_world_body, memory.segment)
        return self._update(frame, "tracking: started", self._filter.state)

    def _start_in_motion(self, state: FilterState, clones: list[int], frame: ImageFrame) -> SlamUpdate:
        """Begin tracking from a solved window: its frames are the first clones, its tracks the first landmarks."""
        self._begin_segment()
        vio = self._make_filter(state)
        self._filter = vio
        adopted = self._memory.adopt(state, clones, self._imu)
        self._carry_on(adopted[0], state)
        for item in adopted:
            vio.tracks.add_frame(item.tracked, np.zeros(0, dtype=np.int64))
        vio.adopt_landmarks()
        return self._update(frame, "tracking: started in motion", vio.state)

    def _carry_on(self, first: RecentFrame, state: FilterState) -> None:
        """Link a segment to the one before, where wheels have carried the robot on."""
        if self._memory.segment and self._calibration.has_wheels and not self._is_lifted:
            self._memory.carry_on(first, state, self._imu)

    def _make_filter(self, state: FilterState) -> VioFilter:
        known = self._wheels_known
        if self._calibration.has_wheels:
            state = add_wheels(state, known.mean, known.sigma)
        return VioFilter(self._calibration, self._config.filter, state, self._servos_known)

    def _begin_segment(self) -> None:
        if self._lost_since is not None:
            self._lost_ns += self._intake.last_t_ns - self._lost_since
            self._lost_since = None
            self._memory.segment += 1
        self._monitor.reset()
        self._standstill.reset()

    def _lose(self, reason: str, t_imu_ns: int, frame: ImageFrame, retired: Sequence[RetiredClone] = ()) -> SlamUpdate:
        """Stop tracking: what was estimated before the trouble stays, the next start is a new segment."""
        vio, memory = self._filter, self._memory
        assert vio is not None
        outage = self._monitor.outage_since
        memory.flush(vio, outage, retired)
        memory.poses.drop_after(t_imu_ns if outage is None else outage, memory.segment)
        self._coasting = Coasting(self._anchor(reason, vio.state), t_imu_ns)
        self._filter = None
        self._lost_since = self._intake.last_t_ns
        self._messages.append(f"tracking lost after {self._intake.elapsed_s:.1f} s: {reason}")
        if reason == CONTRADICTION:
            memory.calibration_check.contradict(self._intake.elapsed_s)
        self._starter.reset()
        memory.recent = {}
        return self._update(frame, f"tracking lost: {reason}", None)

    # ---- for a backend that builds on this one

    @property
    def state(self) -> FilterState | None:
        """At the newest frame; None while nothing is tracked."""
        return None if self._filter is None else self._filter.state

    @property
    def tracker(self) -> Tracker:
        return self._tracker

    @property
    def imu(self) -> ImuBuffer:
        return self._imu

    @property
    def memory(self) -> NavigationMemory:
        return self._memory

    @property
    def is_blind(self) -> bool:
        """Images have shown too little for a while: if tracking is lost by that, no poses are kept since then."""
        return self._monitor.outage_since is not None

    def one_thread(self) -> AbstractContextManager[object]:
        """In which additions have one order, whatever the machine."""
        return self._blas.limit(limits=1)

    # ---- the end

    def catch_up(self) -> bool:
        """Look at a window for the calibration, or describe a view of the map; see SlamBackend."""
        memory = self._memory
        with self._blas.limit(limits=1):
            return memory.calibration_check.work() or (memory.views is not None and memory.views.describe_next())

    def keyframe_pictures(self) -> Sequence[bytes]:
        """The views; of a map from tracks it is not known before the end."""
        return [] if self._memory.views is None else self._memory.views.pictures()

    def keyframe_features(self, number: int) -> Features | None:
        return None if self._memory.views is None else self._memory.views.seen(number)

    def finish(self) -> Navigation:
        """End the navigation. Raises EstimationError, with the reason, when nothing could be reconstructed."""
        return self.finish_improved(None)

    def finish_improved(self, improve: Callable[[NavigationMemory], BetterKnown] | None) -> Navigation:
        """The same; `improve` gives what somebody else knows of the keyframes by now, instead of refining them."""
        with self._blas.limit(limits=1):
            return self._finish(improve)

    def _finish(self, improve: Callable[[NavigationMemory], BetterKnown] | None) -> Navigation:
        memory, intake, config = self._memory, self._intake, self._config
        if improve is not None:
            config = replace(config, refine=False)
        if self._filter is not None:
            memory.flush(self._filter, self._monitor.outage_since)
        if self._lost_since is not None:
            self._lost_ns += intake.last_t_ns - self._lost_since
        if not intake.used:
            raise EstimationError("no usable image came; the ukf backend needs images and IMU samples")
        if not len(memory.poses) or not memory.keyframes.items:
            raise EstimationError(f"tracking never started: {self._last_message}")
        better = None if improve is None else improve(memory)
        report = make_report(intake, self._imu.counts, self._lost_ns * 1e-9, self._seed, config, self._messages)
        return make_navigation(
            f"ukf-{intake.first_t_ns}", memory, self._camera, self._calibration, self._servo_errors(), config, report,
            better,
        )  # fmt: skip

    # ---- small helpers

    def _servo_errors(self) -> FloatArray:
        """(NUM_ERRORS,) of the head, as they are known by now."""
        if self._filter is not None and len(self._filter.state.head):
            return self._filter.state.head
        return np.zeros(NUM_ERRORS) if self._servos_known is None else self._servos_known.mean

    def _make_views(self) -> MapViews | None:
        """Where the map's views are collected; None when the map is made from tracks."""
        config = self._config
        wanted = config.map == "views" or (config.map == "auto" and self._calibration.has_wheels)
        if not wanted or config.landmarks == "thesis":
            return None
        return MapViews(self._camera.lens, config.views, self._seed, self._calibration.up_in_image_deg)

    def _update(
        self,
        frame: ImageFrame,
        message: str,
        state: FilterState | None,
        is_keyframe: bool = False,
        points: Points | None = None,
    ) -> SlamUpdate:
        is_lost = self._lost_since is not None
        name: TrackingState = "tracking" if state is not None else ("lost" if is_lost else "initialising")
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
            segment=self._memory.segment,
            calibration_fit=self._memory.calibration_check.fit,
        )

    def _imu_missing_s(self, t_imu: int) -> float:
        last = self._imu.last_t_ns
        return 1e9 if last is None else (t_imu - last) * 1e-9

    def _has_imu_at(self, t_imu: int) -> bool:
        """Whether IMU samples reach to about this time and from the frame before."""
        first = self._imu.first_t_ns
        return first is not None and first <= t_imu and self._imu_missing_s(t_imu) < IMU_REACH_S

    def _predicted_turn(self, segment: ImuSegment, head: HeadPose | None) -> FloatArray:
        """R_prev_cur of the camera by the gyroscope, and by what the head was told."""
        bias = np.zeros(3)
        if self._filter is not None:
            bias = self._filter.state.bias_gyro
        elif self._coasting.bias_gyro is not None:
            bias = self._coasting.bias_gyro
        R = np.eye(3)
        for turn in so3_exp((segment.gyro - bias) * segment.dt_s[:, None]):
            R = R @ turn
        if head is not None:
            before = self._previous_head or head
            R = self._R_body_head(before).T @ R @ self._R_body_head(head)
        return self._camera.R_body_cam.T @ R @ self._camera.R_body_cam

    @staticmethod
    def _head_then(vio: VioFilter, head: HeadPose | None) -> HeadThen | None:
        return None if head is None else HeadThen(head, vio.state.head[PLAY])

    def _R_body_head(self, head: HeadPose) -> FloatArray:
        """By what it was told, and what is known of its servos."""
        learned = self._filter.state.head if self._filter is not None else NO_HEAD
        return head.T_body_head(head.by_errors @ learned if len(learned) else np.zeros(2))[:3, :3]

    def _is_commanded_to_move(self) -> bool:
        return self._drive is not None and commands_motion(self._drive)

    def _wheels(self, segment: ImuSegment, is_still: bool) -> BodyVelocity | None:
        """What the wheels say of the body velocity now; of a robot that stands while it should roll, nothing forward.

        It is blocked: its wheels' constants are not to be learnt from that.
        """
        if not self._calibration.has_wheels:
            return None
        bias = self._filter.state.bias_gyro if self._filter is not None else np.zeros(3)
        is_blocked = is_still and self._is_commanded_to_move()
        rolled = None
        if self._drive is not None and not is_blocked:
            rolled = Rolled(self._wheel_speed.speed_m_s, self._wheel_speed.missing_m_s)
        wheels = self._filter.state.wheels if self._filter is not None else self._wheels_known.mean
        return wheel_velocity(self._config.wheels, wheels, float(segment.end_gyro[2] - bias[2]), rolled)

    def _driven_velocity(self, current: RecentFrame) -> FloatArray | None:
        """Body velocity (3,) of a robot that its motors drive; None before the motors have followed their command."""
        if current.wheels is None or not self._is_commanded_to_move():
            return None
        lag_m_s = self._config.wheels.sigma_lag_share * abs(self._wheel_speed.missing_m_s)
        return driven_velocity(current.wheels, lag_m_s)

    def _rolled_m(self, t_imu: int) -> float | None:
        """Way of the wheels since the last frame, as if nothing slipped.

        None where there are none, or the robot is in somebody's hands.
        """
        before = self._way_m  # not the wheel's own: each command has taken it on since
        self._wheel_speed.advance(t_imu)
        self._way_m = self._wheel_speed.way_m
        rolled_m = self._way_m - before
        is_held = self._is_lifted and self._filter is None
        return rolled_m if self._calibration.has_wheels and not is_held else None

    def _anchor(self, reason: str, state: FilterState) -> Anchor:
        """Where the next segment begins: where wheels have carried the robot, else the last known place; and biases."""
        bias = np.concatenate([state.bias_gyro, state.bias_accel])
        sound = is_finite(state) and float(np.abs(bias[:3]).max()) < 0.2 and float(np.abs(bias[3:]).max()) < 1.0
        self._is_lifted = reason == LIFTED
        if self._calibration.has_wheels and sound:
            self._wheels_known = WheelsKnown.learned(state)
        if len(state.head) and sound:
            self._servos_known = ServosKnown.learned(state)
        T = self._memory.poses.last()
        if self._calibration.has_wheels and not self._is_lifted and sound:
            T = state.T_world_body  # dead reckoned through the outage, in which no poses were kept
        if T is None:
            T = np.eye(4)
        return Anchor(T[:3, 3].copy(), float(np.arctan2(T[1, 0], T[0, 0])), bias if sound else None)
