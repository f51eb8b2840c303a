"""What stays of the frames: recent ones while their clones are in the filter, then poses, keyframes, live points."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse, se3
from station.model.frames import ImageFrame
from station.motion.head import HeadPose
from station.motion.imu_buffer import ImuBuffer
from station.motion.preintegration import ImuSegment, Preintegration, chain, preintegrate
from station.slam.ukf.filter.constraints import BodyVelocity
from station.slam.ukf.filter.filter import RetiredClone, VioFilter
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.filter.update import is_finite
from station.slam.ukf.map.calibration_check import CalibrationCheck
from station.slam.ukf.map.keyframes import Keyframe, KeyframeStore, sample_colours
from station.slam.ukf.map.landmark_map import LandmarkQuality, LiveMap
from station.slam.ukf.map.pose_log import PoseLog
from station.slam.ukf.map.views import MapViews
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

NO_LINK_NS = 10**9  # frames further apart than that are not linked by the IMU
WAITING_NS = 4 * 10**9  # frames older than that no longer wait for a start
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
    T_body_head: FloatArray | None = None  # (4, 4) as the filter knew it then
    is_still: bool = False  # the robot stands, by image and IMU


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
        self.calibration_check = CalibrationCheck(camera, calibration.imu, calibration.gravity)
        self.recent: dict[int, RecentFrame] = {}  # by ImageFrame.index, ascending
        self.poses = PoseLog()
        self.keyframes = KeyframeStore(max_keyframes)
        self.live = LiveMap(camera, quality)
        self.segment = 0  # number of the present piece of unbroken tracking

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
        T_world_head, T_body_head = retired.T_world_head, None if old is None else old.T_body_head
        self.poses.improve(
            retired.frame_index, T_world_head if T_body_head is None else T_world_head @ inverse(T_body_head)
        )
        if old is None:
            return None
        if not retired.is_keyframe:
            after = self.recent.get(min((i for i in self.recent if i > retired.frame_index), default=-1))
            if after is not None:
                after.link = None if old.link is None or after.link is None else chain(old.link, after.link)
            return None
        keyframe = Keyframe(
            image=old.frame,
            tracked=old.tracked,
            rgb=old.rgb
            if old.rgb is not None
            else sample_colours(old.frame.half_bgr(), 0.5 * old.tracked.uv_px - 0.25),
            T_world_head=T_world_head,
            v_world=retired.v_world,
            omega_head=retired.omega_head,
            bias=np.concatenate([state.bias_gyro, state.bias_accel]),
            segment=self.segment,
            link=old.link,
            wheels=old.wheels,
            T_body_head=T_body_head,
        )
        self.keyframes.add(keyframe)
        self.calibration_check.add(keyframe)
        if self.views is not None:
            self.views.add(keyframe)
        return self.live.add(keyframe)

    def flush(self, vio: VioFilter, outage_since: int | None) -> None:
        """All poses still in the window become keyframes: nothing will improve them any more."""
        state = vio.state
        if not is_finite(state):
            return
        for k in range(state.num_clones):
            index = int(state.clone_frame[k])
            item = self.recent.get(index)
            if item is not None and outage_since is not None and item.t_imu_ns >= outage_since:
                continue
            T = se3(state.clone_R[k], state.clone_x[k])
            self.retire(RetiredClone(index, T, True, state.clone_v[k], state.clone_omega[k]), state)
