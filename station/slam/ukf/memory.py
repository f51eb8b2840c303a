"""What stays of the frames: recent ones while their clones are in the filter, then poses, keyframes, live points."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse, rotation_angle, se3
from station.model.frames import ImageFrame
from station.motion.head import HeadPose, HeadThen
from station.motion.imu_buffer import ImuBuffer
from station.motion.preintegration import ImuSegment, Preintegration, preintegrate
from station.slam.ukf.filter.constraints import BodyVelocity
from station.slam.ukf.filter.filter import RetiredClone, VioFilter
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.filter.update import is_finite
from station.slam.ukf.map.calibration_check import CalibrationCheck
from station.slam.ukf.map.keyframes import Keyframe, KeyframeStore, sample_colours
from station.slam.ukf.map.landmark_map import LandmarkQuality, LiveMap
from station.slam.ukf.map.pose_log import PoseLog
from station.slam.ukf.map.views import MapViews, joined
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

NO_LINK_NS = 10**9  # frames further apart than that are not linked by the IMU
WAITING_NS = 4 * 10**9  # frames older than that no longer wait for a start
MOST_TURNED = 24  # pictures between two poses of the window: a turn out of view has ten, turning to and fro no end
Points = tuple[FloatArray, FloatArray]  # (n, 3) positions, (n, 3) colours


@dataclass(slots=True, eq=False)
class RecentFrame:
    """A frame whose clone is in the filter, or that waits for a start."""

    frame: ImageFrame
    tracked: TrackedFrame
    t_imu_ns: int
    link: Preintegration | None  # IMU since the frame before it in the window
    wheels: BodyVelocity | None  # where wheels know it
    rgb: npt.NDArray[np.uint8] | None  # (N, 3) where the image is grey; None: decoded when it becomes a keyframe
    head: HeadPose | None  # as told; None while it was never turned
    head_then: HeadThen | None = None  # the same, with what the filter knew of it
    is_still: bool = False  # the robot stands, by image and IMU
    turned: tuple[Keyframe, ...] = ()  # of a turn between the frame before it in the window and this one
    since_turned: Preintegration | None = None  # IMU since the last of these


class NavigationMemory:
    """Poses of all frames, keyframes, and the frames that may still become keyframes."""

    def __init__(
        self,
        camera: CameraModel,
        calibration: Calibration,
        quality: LandmarkQuality,
        max_keyframes: int,
        views: MapViews | None,
    ) -> None:
        """Args: views: where the map's views are collected; None: the map is made from tracks."""
        assert calibration.imu is not None
        self._noise = calibration.imu
        self.views = views
        self.chooses_views = True  # else a backend that builds on the filter does
        self.calibration_check = CalibrationCheck(camera, calibration.imu, calibration.gravity)
        self.recent: dict[int, RecentFrame] = {}  # by ImageFrame.index, ascending
        self.poses = PoseLog()
        self.keyframes = KeyframeStore(max_keyframes)
        self.live = LiveMap(camera, quality)
        self.segment = 0  # number of the present piece of unbroken tracking
        self._T_world_retired = np.eye(4)  # pose of the newest keyframe
        self._retired_ns = 0  # and its time, the IMU's

    def add(self, item: RecentFrame) -> None:
        self.recent[item.frame.index] = item

    def forget_waiting(self, t_imu_ns: int) -> None:
        """Drop the frames that waited too long for a start."""
        for index in [i for i, w in self.recent.items() if w.t_imu_ns < t_imu_ns - WAITING_NS]:
            del self.recent[index]

    def link_by(self, segment: ImuSegment, state: FilterState) -> Preintegration | None:
        """The IMU between two frames as one residual; None where too much of it is missing."""
        if not len(segment.dt_s) or segment.dt_s.sum() * 1e9 > NO_LINK_NS:
            return None
        return preintegrate(segment, np.concatenate([state.bias_gyro, state.bias_accel]), self._noise)

    def carry_on(self, first: RecentFrame, state: FilterState, imu: ImuBuffer) -> None:
        """The segment that begins with this frame is mapped with the one before: wheels and IMU have led here.

        Not where the IMU's readings of the outage are gone (they are kept for some seconds), nor where no views are.
        """
        since_ns = imu.first_t_ns
        if self.views is None or not self.keyframes.items or since_ns is None or since_ns > self._retired_ns:
            return
        segment = imu.segment(self._retired_ns, first.t_imu_ns)
        first.link = preintegrate(segment, np.concatenate([state.bias_gyro, state.bias_accel]), self._noise)
        self.views.carried_on.add(self.segment)

    def adopt(self, state: FilterState, clones: list[int], imu: ImuBuffer) -> list[RecentFrame]:
        """After a start in motion: only the frames of its window stay, linked to each other, with their poses."""
        kept = [self.recent[i] for i in clones]
        bias = np.concatenate([state.bias_gyro, state.bias_accel])
        for before, item in itertools.pairwise(kept):
            item.link = preintegrate(imu.segment(before.t_imu_ns, item.t_imu_ns), bias, self._noise)
        for k, item in enumerate(kept):
            self.poses.add(item.frame.index, item.t_imu_ns, se3(state.clone_R[k], state.clone_x[k]), self.segment)
        self.recent = {item.frame.index: item for item in kept}
        return kept

    def retire(self, retired: RetiredClone, state: FilterState) -> Points | None:
        """A pose left the window: log it, keep it as keyframe or join its IMU link to the next; new map points."""
        old = self.recent.pop(retired.frame_index, None)
        T_world_head, T_body_head = retired.T_world_head, None
        if old is not None and old.head_then is not None:  # of a turn its own images tell most
            T_body_head = old.head_then.T_body_head(state.head)
        self.poses.improve(
            retired.frame_index, T_world_head if T_body_head is None else T_world_head @ inverse(T_body_head)
        )
        if old is None:
            return None
        if not retired.is_keyframe:
            after = self.recent.get(min((i for i in self.recent if i > retired.frame_index), default=-1))
            if after is not None:
                self._pass_on(old, after, retired, state)
            return None
        rgb = old.rgb
        if rgb is None:
            rgb = sample_colours(old.frame.half_bgr(), 0.5 * old.tracked.uv_px - 0.25)
        keyframe = self._keyframe(old, rgb, retired, state)
        self.keyframes.add(keyframe)
        self.calibration_check.add(keyframe)
        if self.views is not None and self.chooses_views:
            for turned in old.turned:
                self.views.add(replace(turned, T_world_head=self._T_world_retired @ turned.T_world_head))
            self.views.add(replace(keyframe, link=old.since_turned) if old.turned else keyframe)
        self._T_world_retired, self._retired_ns = T_world_head, old.t_imu_ns
        return self.live.add(keyframe)

    def _keyframe(
        self, item: RecentFrame, rgb: npt.NDArray[np.uint8], retired: RetiredClone, state: FilterState
    ) -> Keyframe:
        return Keyframe(
            image=item.frame,
            tracked=item.tracked,
            rgb=rgb,
            T_world_head=retired.T_world_head,
            v_world=retired.v_world,
            omega_head=retired.omega_head,
            bias=np.concatenate([state.bias_gyro, state.bias_accel]),
            segment=self.segment,
            link=item.link,
            wheels=item.wheels,
            T_body_head=None if item.head_then is None else item.head_then.T_body_head(state.head),
            head=item.head_then,
        )

    def _pass_on(self, old: RecentFrame, after: RecentFrame, retired: RetiredClone, state: FilterState) -> None:
        """A frame without parallax to the one before leaves the window: what it knows goes to the one after."""
        since, link = old.since_turned if old.turned else old.link, after.link
        after.link = joined(old.link, link)
        after.turned, after.since_turned = old.turned, joined(since, link)
        turned = self._turned(old, retired, state)
        if turned is not None:
            after.turned, after.since_turned = (*old.turned, replace(turned, link=since)), link

    def _turned(self, item: RecentFrame, retired: RetiredClone, state: FilterState) -> Keyframe | None:
        """A picture that may become a view although it gives the filter no parallax: of a turn on the spot.

        Its pose is in the frame of the pose before in the window, which will be known better. None where the camera has
        hardly turned.
        """
        before = int(np.searchsorted(state.clone_frame, retired.frame_index)) - 1
        if self.views is None or not self.chooses_views or len(item.turned) >= MOST_TURNED or before < 0:
            return None
        T_before_world = inverse(se3(state.clone_R[before], state.clone_x[before]))
        T_before_head = T_before_world @ retired.T_world_head
        R_last = item.turned[-1].T_world_head[:3, :3] if item.turned else np.eye(3)
        if rotation_angle(R_last.T @ T_before_head[:3, :3]) < self.views.least_turn_rad:
            return None
        no_colours = np.zeros((0, 3), dtype=np.uint8)
        return replace(self._keyframe(item, no_colours, retired, state), T_world_head=T_before_head)

    def flush(self, vio: VioFilter, outage_since: int | None, retired: Sequence[RetiredClone] = ()) -> None:
        """All poses still in the window become keyframes: nothing will improve them any more.

        Args:
            retired: left the window with the filter's last frame: without them the next ones' IMU links begin too late.
        """
        state = vio.state
        if not is_finite(state):
            return
        left = [
            RetiredClone(int(state.clone_frame[k]), se3(state.clone_R[k], state.clone_x[k]), True, v, omega)
            for k, (v, omega) in enumerate(zip(state.clone_v, state.clone_omega, strict=True))
        ]
        for clone in (*retired, *left):
            item = self.recent.get(clone.frame_index)
            if item is None or outage_since is None or item.t_imu_ns < outage_since:
                self.retire(clone, state)
