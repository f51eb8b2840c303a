"""The smoothing backend: the filter as odometry, keyframes and landmarks smoothed behind it.

See docs/slam.md, "Smoothing". `add_frame` is the reading path. Pure: no clock; the same data give the same
result, bit for bit.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version

import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, inverse, se3
from station.model.best_camera import unless_it_fits
from station.model.frames import DriveSample, ImageArray, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.motion.preintegration import preintegrate
from station.slam.mapping.report import plain_settings
from station.slam.smoothing.batch import GATES, BatchInput, as_keyframe, smooth_segment
from station.slam.smoothing.closing import LoopCloser
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.fixed_lag import FixedLagWindow
from station.slam.smoothing.keyframe import SmoothKeyframe
from station.slam.smoothing.landmarks import LandmarkTable
from station.slam.smoothing.newest import NewestInFilter
from station.slam.smoothing.search import Recaller
from station.slam.smoothing.view_adjuster import ViewAdjuster
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.filter.constraints import WheelsKnown
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.map.keyframes import Keyframe, sample_colours
from station.slam.ukf.map.pose_log import follow_poses
from station.slam.ukf.map.view_map import BetterKnown
from station.slam.ukf.memory import NavigationMemory, RecentFrame
from station.vision.camera_model import CameraModel
from station.vision.features import Features
from station.vision.klt import TrackedFrame

NOTHING = np.zeros(0, dtype=np.int64)
HEAD_TURNED = "the camera's head turned, which smoothing does not follow yet: the filter's result"


@dataclass(frozen=True, slots=True, eq=False)
class FrameBetween:
    """A frame by the keyframe before it."""

    frame_index: int
    t_imu_ns: int
    keyframe: int
    T_keyframe_frame: FloatArray  # (4, 4)


class SmoothingBackend:
    def __init__(self, calibration: Calibration, config: SmoothingConfig | None = None, seed: int = 0) -> None:
        config = config or SmoothingConfig()
        self._odometry = UkfBackend(calibration, config.odometry, seed)
        assert calibration.camera is not None and calibration.imu is not None
        self._config = config.for_robot(calibration.has_wheels)
        self._calibration = calibration
        self._camera = CameraModel.of(calibration.camera, self._config.sigma_px)
        self._noise = calibration.imu
        self._keyframes: list[SmoothKeyframe] = []
        self._window: FixedLagWindow | None = None
        self._recaller = Recaller(self._camera, self._config.recall)
        self._newest = NewestInFilter(np.eye(4))
        self._frames_since = 0
        self._all_still = True
        self._tables: dict[int, LandmarkTable] = {}
        self._between: list[FrameBetween] = []
        self._closer: LoopCloser | None = None
        self._odometry.memory.chooses_views = not self._config.closes_loops
        self._not_yet_views: list[Keyframe] = []  # of a blind while, until it has ended well
        self._T_map_odom = np.eye(4)
        self._num_closed = 0  # loops of pieces of tracking that have ended
        self._head_turned = False
        self._restarts = 0  # of the window, where its equations had no single solution
        self._messages: list[str] = []

    # ---- data in

    def add_imu(self, imu: ImuBatch) -> None:
        self._odometry.add_imu(imu)

    def add_drive(self, drive: DriveSample) -> None:
        self._odometry.add_drive(drive)

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        """Follow the frame by the filter; make it a keyframe where it is one; carry the newest keyframe on to it.

        And look a step further for what its views show again. What the keyframe before changes is solved for first,
        unless an idle moment has done so: its own frame did not wait for it.
        """
        self._solve()
        update = self._odometry.add_frame(frame)
        state, current = self._odometry.state, self._odometry.newest
        if current is not None and current.head is not None and not self._head_turned:
            self._leave_to_filter()
        if self._head_turned or state is None:
            self._end_window()
            return replace(update, T_map_world=self._T_map_odom)
        if current is not None:
            self._follow(state, current)
        assert self._window is not None
        T_newest_now = self._since_keyframe(state)
        newest = self._window.keyframes[-1]
        if current is not None:
            self._between.append(FrameBetween(frame.index, current.t_imu_ns, newest.number, T_newest_now))
        points = update.new_points_world
        if points is not None:
            T = newest.T_world_body @ inverse(self._newest.T_filter)  # of the filter's world
            points = points @ T[:3, :3].T + T[:3, 3]
        if self._closer is not None:
            with self._odometry.one_thread():
                self._closer.look()
            self._T_map_odom = self._closer.T_map_odom
        return replace(
            update,
            T_world_body=newest.T_world_body @ T_newest_now,
            new_points_world=points,
            T_map_world=self._T_map_odom,
        )

    def _follow(self, state: FilterState, current: RecentFrame) -> None:
        self._frames_since += 1
        self._all_still = self._all_still and current.is_still
        if self._window is None:
            self._begin(state, current)
        elif self._is_keyframe(current):
            self._add_keyframe(state, current)

    def _end_window(self) -> None:
        self._solve()
        self._num_closed += 0 if self._closer is None else len(self._closer.closed)
        self._window, self._closer, self._not_yet_views = None, None, []
        self._odometry.imu_needed_since_ns = None

    def _leave_to_filter(self) -> None:
        """Keyframes are poses of the body to which the camera is fixed; on a turned head only the filter knows it."""
        self._head_turned = True
        self._messages.append(HEAD_TURNED)
        self._keyframes, self._tables, self._between = [], {}, []
        memory = self._odometry.memory
        if memory.views is not None and not memory.chooses_views:
            memory.chooses_views = True
            memory.views.begin_anew(memory.keyframes.items)

    def _since_keyframe(self, state: FilterState) -> FloatArray:
        """T_keyframe_now (4, 4) by the filter."""
        assert self._window is not None
        return self._newest.moved(self._window.keyframes[-1].source.frame.index, state)

    # ---- keyframes

    def _begin(self, state: FilterState, current: RecentFrame) -> None:
        """A new piece of tracking: its frames so far become the first keyframes."""
        memory = self._odometry.memory
        wheels = WheelsKnown.before_the_drive(self._config.odometry.wheels) if self._calibration.has_wheels else None
        table = LandmarkTable(self._config.recall.stored_px)
        self._tables[memory.segment] = table
        self._window = FixedLagWindow(self._camera, self._noise, self._calibration.gravity, self._config, table, wheels)
        at_clone = {int(f): i for i, f in enumerate(state.clone_frame)}
        last_ns = None
        for index, item in sorted(memory.recent.items()):
            i = at_clone.get(index)
            if i is None or (last_ns is not None and item.t_imu_ns - last_ns < self._config.min_interval_s * 1e9):
                continue
            self._solve()
            last_ns = item.t_imu_ns
            T = se3(state.clone_R[i], state.clone_x[i])
            self._all_still = item.is_still
            keyframe = self._make(item, T, state.clone_v[i], state, state.clone_omega[i], item.tracked, NOTHING)
            self._append(keyframe, item.frame.grey())
            self._between.append(FrameBetween(index, item.t_imu_ns, keyframe.number, np.eye(4)))
        if not self._window.keyframes:
            keyframe = self._make(
                current, state.T_world_body, state.v, state, state.omega_body, current.tracked, NOTHING
            )
            self._append(keyframe, current.frame.grey())
        self._newest = NewestInFilter(state.T_world_body)
        if self._config.closes_loops and memory.views is not None:
            self._closer = LoopCloser(
                memory.views, memory.segment, self._pose_at, self._camera, self._noise, self._T_map_odom
            )

    def _pose_at(self, frame_index: int) -> FloatArray | None:
        """(4, 4) of a frame, as its keyframe is known now."""
        row = bisect_right(self._between, frame_index, key=lambda frame: frame.frame_index) - 1
        if row < 0 or self._between[row].frame_index != frame_index:
            return None
        found = self._between[row]
        return self._keyframes[found.keyframe].T_world_body @ found.T_keyframe_frame

    def _is_keyframe(self, current: RecentFrame) -> bool:
        assert self._window is not None
        config, last = self._config, self._window.keyframes[-1].source
        since_s = (current.t_imu_ns - last.t_imu_ns) * 1e-9
        if since_s < config.min_interval_s:
            return False
        if since_s > config.max_interval_s:
            return True
        _, i, j = np.intersect1d(last.tracked.ids, current.tracked.ids, assume_unique=True, return_indices=True)
        if len(i) < 10:
            return True
        flow = np.linalg.norm(last.tracked.uv_px[i] - current.tracked.uv_px[j], axis=1)
        return float(np.median(flow)) > config.min_flow * self._camera.lens.camera.width

    def _add_keyframe(self, state: FilterState, current: RecentFrame) -> None:
        assert self._window is not None
        image = self._odometry.tracker.image
        assert image is not None
        newest = self._window.keyframes[-1]
        T_newest_now = self._since_keyframe(state)
        self._between.append(FrameBetween(current.frame.index, current.t_imu_ns, newest.number, T_newest_now))
        T = newest.T_world_body @ T_newest_now
        table = self._window.landmarks
        tracked, trusted = self._recall(table, image, current.tracked, T)
        turn = T[:3, :3] @ state.R.T
        self._append(
            self._make(current, T, turn @ state.v, state, state.omega_body, tracked, trusted, T_newest_now), image
        )

    def _recall(
        self, table: LandmarkTable, image: ImageArray, tracked: TrackedFrame, T_world_body: FloatArray
    ) -> tuple[TrackedFrame, np.ndarray[tuple[int], np.dtype[np.int64]]]:
        """What the image shows with the landmarks found again in it; and which of them agree on another pose."""
        assert self._window is not None
        found = self._recaller.search(table, image, tracked, T_world_body, self._window.oldest)
        for track, landmark in found.same:
            table.rename(track, landmark)
        if len(found.landmarks):
            xy = self._camera.lens.unproject(found.uv_px)
            new = self._odometry.tracker.follow(found.uv_px, xy)
            for track, landmark in zip(new.tolist(), found.landmarks.tolist(), strict=True):
                table.rename(track, landmark)
            tracked = replace(
                tracked,
                ids=np.concatenate([tracked.ids, new]),
                uv_px=np.concatenate([tracked.uv_px, found.uv_px]),
                xy=np.concatenate([tracked.xy, xy]),
            )
        return tracked, found.trusted

    def _make(
        self,
        source: RecentFrame,
        T_world_body: FloatArray,
        v_world: FloatArray,
        state: FilterState,
        omega: FloatArray,
        tracked: TrackedFrame,
        trusted: np.ndarray[tuple[int], np.dtype[np.int64]],
        T_before: FloatArray | None = None,
    ) -> SmoothKeyframe:
        window = self._window
        assert window is not None
        link = None
        bias = np.concatenate([state.bias_gyro, state.bias_accel])
        if window.keyframes:
            before = window.keyframes[-1]
            segment = self._odometry.imu.segment(before.source.t_imu_ns, source.t_imu_ns, is_link=True)
            link = preintegrate(segment, before.bias, self._noise)
        return SmoothKeyframe(
            number=len(self._keyframes),
            source=source,
            tracked=window.landmarks.named(tracked),
            link=link,
            wheels=source.wheels,
            frames_since=self._frames_since,
            is_still=self._all_still and link is not None,
            T_world_body=T_world_body,
            v_world=v_world,
            bias=bias,
            omega=omega,
            segment=self._odometry.memory.segment,
            trusted=trusted,
            T_before=T_before,
        )

    def _append(self, keyframe: SmoothKeyframe, image: ImageArray) -> None:
        assert self._window is not None
        self._window.add(keyframe, image)
        self._keyframes.append(keyframe)
        self._choose_view(keyframe)
        self._odometry.imu_needed_since_ns = keyframe.source.t_imu_ns  # the next one is linked to this one
        self._frames_since, self._all_still = 0, True

    def _solve(self) -> bool:
        """Solve for what the newest keyframe changes; False where that was done."""
        if self._window is None or self._window.is_solved:
            return False
        self._restarts += not self._window.solve()
        return True

    def _choose_view(self, keyframe: SmoothKeyframe) -> None:
        """Where loops are closed a keyframe may be a view at once; the filter would have it wait in its window."""
        memory = self._odometry.memory
        if memory.views is None or memory.chooses_views:
            return
        self._not_yet_views.append(as_keyframe(keyframe))
        if self._odometry.is_blind:
            return
        for waiting in self._not_yet_views:
            memory.views.add(waiting)
        self._not_yet_views = []

    # ---- the rest of the interface

    def catch_up(self) -> bool:
        if self._solve():
            return True
        if self._closer is not None:
            with self._odometry.one_thread():
                if self._closer.look_ahead():
                    return True
        return self._odometry.catch_up()

    def keyframe_pictures(self) -> Sequence[bytes]:
        return self._odometry.keyframe_pictures()

    def keyframe_features(self, number: int) -> Features | None:
        return self._odometry.keyframe_features(number)

    def finish(self) -> Navigation:
        """End the navigation. Raises EstimationError, with the reason, when nothing could be reconstructed."""
        self._end_window()
        nav = self._odometry.finish() if self._head_turned else self._odometry.finish_improved(self._improve)
        settings = plain_settings(self._config)
        del settings["odometry"]  # the rest of the report's settings
        restarts = f"{self._restarts} windows of keyframes begun anew, since the equations had no single solution"
        report = replace(
            nav.report,
            backend="smoothing",
            versions=nav.report.versions | {"gtsam": version("gtsam")},
            config=nav.report.config | {"smoothing": settings, "loops_while_driving": self._num_closed},
            messages=(*nav.report.messages, *self._messages, *((restarts,) if self._restarts else ())),
        )
        return replace(nav, id=nav.id.replace("ukf", "smoothing", 1), report=report)

    def _improve(self, memory: NavigationMemory) -> BetterKnown:
        """Everything in one problem; poses, keyframes and views of the map follow."""
        wheels = WheelsKnown.before_the_drive(self._config.odometry.wheels) if self._calibration.has_wheels else None
        camera = self._best_camera(memory)
        model = CameraModel.of(camera, self._config.sigma_px)
        given = BatchInput(model, self._noise, self._calibration.gravity, self._config, wheels)
        gates = GATES if memory.views is None else GATES[:1]  # the second round is that of the ViewAdjuster
        parts: dict[int, list[SmoothKeyframe]] = {}
        for segment, table in self._tables.items():
            # Of those since an outage that ended the segment no poses are kept.
            part = [k for k in self._keyframes if k.segment == segment and self._pose_of(k, memory) is not None]
            if len(part) < 3:
                continue
            for k in part:
                named = table.named(k.tracked)
                k.tracked = replace(named, xy=model.lens.unproject(named.uv_px))
            parts[segment] = part
            try:
                smooth_segment(part, given, gates)
            except DegenerateGeometry as exc:
                self._messages.append(f"piece {segment + 1} of the way stays as it was known on the way: {exc}")
            self._hand_over(part, memory, segment)
        return BetterKnown(camera, {segment: partial(ViewAdjuster, part, given) for segment, part in parts.items()})

    def _best_camera(self, memory: NavigationMemory) -> CameraCalibration:
        """As told, unless the drive contradicts it. Tracks of a map without views know it no better than was told."""
        told = self._calibration.camera
        assert told is not None
        return told if memory.views is None else unless_it_fits(told, memory.calibration_check.finish())

    @staticmethod
    def _pose_of(keyframe: SmoothKeyframe, memory: NavigationMemory) -> FloatArray | None:
        return memory.poses.pose_of(keyframe.source.frame.index)

    def _hand_over(self, part: list[SmoothKeyframe], memory: NavigationMemory, segment: int) -> None:
        index = [k.source.frame.index for k in part]
        T_old = np.array([memory.poses.pose_of(i) for i in index])
        T_new = np.array([k.T_world_body for k in part])
        memory.poses.follow(index, T_old, T_new, segment)
        self._place_between(part, memory)
        if memory.views is not None:
            memory.views.follow(memory.poses.pose_of, segment)
        items = []
        for k in part:
            colours = k.source.frame.half_bgr()
            items.append(replace(as_keyframe(k), rgb=sample_colours(colours, 0.5 * k.tracked.uv_px - 0.25)))
        others = [k for k in memory.keyframes.items if k.segment != segment]
        memory.keyframes.items = sorted([*others, *items], key=lambda k: k.image.index)

    def _place_between(self, part: list[SmoothKeyframe], memory: NavigationMemory) -> None:
        """Frames keep their motion since the keyframe before; what it is off by at the next one is spread over them."""
        of: dict[int, list[FrameBetween]] = {}
        for between in self._between:
            of.setdefault(between.keyframe, []).append(between)
        for before, after in itertools.pairwise(part):
            frames = of.get(before.number, [])
            if not frames or frames[-1].frame_index != after.source.frame.index:
                continue
            T = before.T_world_body @ np.array([f.T_keyframe_frame for f in frames])
            ends = np.array([before.source.t_imu_ns, after.source.t_imu_ns])
            T_old, T_new = np.array([before.T_world_body, T[-1]]), np.array([before.T_world_body, after.T_world_body])
            moved = follow_poses(T, np.array([f.t_imu_ns for f in frames]), T_old, T_new, ends)
            for f, pose in zip(frames, moved, strict=True):
                memory.poses.improve(f.frame_index, pose)
