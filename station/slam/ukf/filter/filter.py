"""The visual-inertial filter: one frame at a time, from a given state (docs/slam.md).

`process_frame` is the table of contents: propagate, clone, measure, update, let landmarks in, let poses out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from shared.calibration import Calibration
from shared.errors import ConfigError
from shared.geometry import FloatArray, IntArray, se3
from station.motion.error_coordinates import ErrorKind
from station.motion.head import HeadPose
from station.motion.preintegration import ImuSegment
from station.slam.ukf.filter.config import FilterConfig
from station.slam.ukf.filter.head import ServosKnown, add_head_clone, turn_head
from station.slam.ukf.filter.landmarks import add_landmarks, measure_landmarks
from station.slam.ukf.filter.propagation import PropagationConfig, propagate
from station.slam.ukf.filter.state import FilterState, add_clone, keep_landmarks, remove_clone
from station.slam.ukf.filter.tracks import TrackTable
from station.slam.ukf.filter.update import Gate, Measurements, stack, update
from station.slam.ukf.filter.window import gated_window_rows, triangulate_window, window_rows
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    frame_index: int
    nis: float  # sum of normalised innovations squared of all landmark and window measurements tried
    nis_dof: int
    num_landmarks: int
    num_landmarks_passed: int
    num_landmarks_observed: int
    num_window_used: int
    num_window_tried: int
    num_window_misfits: int  # tracks with parallax that no point explains, so that they were not even tried
    rejected_ids: IntArray  # tracks the gates threw out
    new_landmark_ids: IntArray
    retired: tuple[RetiredClone, ...]  # poses that left the window, as last estimated


@dataclass(frozen=True, slots=True, eq=False)
class RetiredClone:
    """A pose of the head that leaves the window: its best estimate."""

    frame_index: int
    T_world_head: FloatArray
    is_keyframe: bool
    v_world: FloatArray
    omega_head: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class WindowMeasurement:
    """The window's part of one frame's measurements."""

    rows: Measurements
    distance2: FloatArray  # (t,) of all tracks tried
    dof: IntArray  # (t,)
    num_used: int
    num_misfits: int
    rejected_ids: IntArray

    @classmethod
    def none(cls, state: FilterState, num_misfits: int = 0) -> WindowMeasurement:
        empty = np.zeros(0, dtype=np.int64)
        return cls(Measurements.none(state), np.zeros(0), empty, 0, num_misfits, empty)


class SoftConstraint(Protocol):
    """Something else that is known at this time: standstill, wheel speed, ..."""

    def rows(self, state: FilterState, kind: ErrorKind) -> Measurements: ...


class VioFilter:
    """State, window and their rules."""

    def __init__(
        self, calibration: Calibration, config: FilterConfig, state: FilterState, servos: ServosKnown | None = None
    ) -> None:
        """`servos`: what an earlier piece of tracking has learned of the head's."""
        if calibration.camera is None or calibration.imu is None:
            raise ConfigError("the ukf backend needs a camera and an IMU in the calibration; use --backend sfm")
        self.config = config
        self.state = state
        self._servos = servos
        self.tracks = TrackTable()
        self.camera = CameraModel.of(calibration.camera, config.sigma_px)
        self.noise = calibration.imu
        self._coming = np.zeros(0, dtype=np.int64)  # tracks that enter the state in this frame
        self._propagation = PropagationConfig(config.error, config.use_sigma_points, config.spread, calibration.gravity)
        self._window_gate = Gate(config.gate_probability)
        self._landmark_gate = Gate(config.landmark_gate_probability)

    def process_frame(
        self,
        imu: ImuSegment,
        frame: TrackedFrame,
        frame_index: int,
        soft: tuple[SoftConstraint, ...] = (),
        keep_previous: bool = False,
        head: HeadPose | None = None,
    ) -> FrameResult:
        """Bring the state to this frame's time and use what it saw.

        keep_previous: the frame before stays in the window whatever its parallax (standstill refers to it).
        head: of this frame; None while it was never turned.
        """
        config = self.config
        state = self.state if head is None else turn_head(self.state, head, self._servos)
        state = propagate(state, imu, self.noise, self._propagation)
        state = self._end_landmarks(state, frame)
        if head is None:
            state = add_clone(state, frame_index)
        else:
            state = add_head_clone(config.error, state, head, frame_index)
        self.tracks.add_frame(frame, state.landmark_id)

        landmarks = measure_landmarks(
            self.camera,
            config.error,
            state,
            frame,
            self._landmark_gate,
            config.spread,
            config.use_sigma_points,
            config.huber,
        )
        leaving = self._leaving_clone(state)
        if leaving is not None and keep_previous:
            leaving = 0
        window = self._measure_window(state, leaving)
        rows = [landmarks.rows, window.rows, *(constraint.rows(state, config.error) for constraint in soft)]
        state = update(state, config.error, stack(rows))

        rejected = state.landmark_id[landmarks.index[~landmarks.passed]]
        rejected = np.concatenate([rejected, window.rejected_ids])
        state = keep_landmarks(state, ~np.isin(state.landmark_id, rejected))
        state, new_ids = self._promote(state)
        state, retired = self._retire(state, leaving)
        self.state = state
        return FrameResult(
            frame_index=frame_index,
            nis=float(landmarks.distance2.sum() + window.distance2.sum()),
            nis_dof=2 * len(landmarks.distance2) + int(window.dof.sum()),
            num_landmarks=state.num_landmarks,
            num_landmarks_passed=int(landmarks.passed.sum()),
            num_landmarks_observed=len(landmarks.index),
            num_window_used=window.num_used,
            num_window_tried=len(window.distance2),
            num_window_misfits=window.num_misfits,
            rejected_ids=rejected,
            new_landmark_ids=new_ids,
            retired=retired,
        )

    def adopt_landmarks(self) -> None:
        """After a start in motion: let the best tracks of its window enter the state, forget the others' views.

        The window's solution used what its tracks say of the poses; where the points are is still unused.
        """
        config, tracks = self.config, self.tracks
        count = tracks.seen.sum(axis=1)
        ripe = np.flatnonzero(tracks.seen[:, -1] & (count >= config.min_track_observations))
        ripe = np.sort(ripe[np.argsort(-count[ripe], kind="stable")][: 2 * config.num_landmarks])
        points = triangulate_window(self.camera, self.state, tracks.uv_px[ripe], tracks.xy[ripe], tracks.seen[ripe])
        good = points.is_good & (points.depth_sigma < config.landmark_depth_sigma) & (points.rms < config.max_track_rms)
        good &= np.cumsum(good) <= config.num_landmarks
        self._coming = tracks.ids[ripe[good]]
        self.state, _ = self._promote(self.state)
        tracks.drop_all_rows()

    def _end_landmarks(self, state: FilterState, frame: TrackedFrame) -> FilterState:
        """Landmarks whose track ended leave the state."""
        return keep_landmarks(state, np.isin(state.landmark_id, frame.ids))

    def _leaving_clone(self, state: FilterState) -> int | None:
        """Which clone leaves after this frame: the oldest, or the last but one while the image hardly moves.

        So the window spans motion rather than time, and a standing robot keeps the views it has parallax to.
        """
        M = state.num_clones
        if self.config.num_clones >= M:
            return None
        a, b = self.tracks.seen[:, M - 3], self.tracks.seen[:, M - 2]
        both = a & b
        if both.sum() < 10:
            return 0
        turn = state.clone_R[M - 3] @ self.camera.R_body_cam
        turn = turn.T @ state.clone_R[M - 2] @ self.camera.R_body_cam
        rays = np.column_stack([self.tracks.xy[both, M - 2], np.ones(int(both.sum()))]) @ turn.T
        moved = rays[:, :2] / np.maximum(rays[:, 2:], 0.1) - self.tracks.xy[both, M - 3]
        parallax_deg = float(np.degrees(np.median(np.linalg.norm(moved, axis=1))))
        return M - 2 if parallax_deg < self.config.keyframe_parallax_deg else 0

    def _measure_window(self, state: FilterState, leaving: int | None) -> WindowMeasurement:
        """Rows of the tracks that ended, of those about to lose their oldest view, and of coming landmarks."""
        config, tracks = self.config, self.tracks
        count = tracks.seen.sum(axis=1)
        is_live = tracks.seen[:, -1]
        enough = count >= config.min_track_observations
        due = enough & ~is_live
        if leaving == 0:
            due |= enough & tracks.seen[:, 0]
        free = 0 if len(state.head) else config.num_landmarks - state.num_landmarks
        wanted = min(free, config.max_new_landmarks)
        coming = np.zeros_like(due)
        if wanted > 0:
            ripe = np.flatnonzero(is_live & (count >= config.min_landmark_observations))
            coming[ripe[np.argsort(-count[ripe], kind="stable")][: 2 * wanted]] = True
        chosen = np.flatnonzero(due | coming)
        chosen = chosen[np.argsort(-(count[chosen] + 100 * coming[chosen]), kind="stable")][: config.max_window_tracks]
        if not len(chosen):
            tracks.keep_rows(is_live)
            return WindowMeasurement.none(state)

        uv, xy, seen = tracks.uv_px[chosen], tracks.xy[chosen], tracks.seen[chosen]
        points = triangulate_window(self.camera, state, uv, xy, seen)
        good = points.is_good & (points.depth_sigma < config.window_depth_sigma)
        # Only images tell how a head turned from clone to clone: no point fits before they have told. By how much the
        # poses may be off, the gate knows.
        fits = (points.rms < config.max_track_rms) | bool(len(state.head))
        misfits = int((good & ~fits).sum())
        good &= fits
        is_landmark = coming[chosen] & good & (points.depth_sigma < config.landmark_depth_sigma)
        is_landmark &= np.cumsum(is_landmark) <= wanted
        good &= is_landmark | due[chosen]  # a track that is neither waits for more views
        chosen, is_landmark, points = chosen[good], is_landmark[good], points.take(good)
        if not len(chosen):
            tracks.keep_rows(is_live)
            return WindowMeasurement.none(state, misfits)
        rows = window_rows(self.camera, config.error, state, uv[good], xy[good], seen[good], points.p)
        measured, passed, distance2 = gated_window_rows(rows, self._window_gate, config.window_gate_slack)
        ids = tracks.ids[chosen]
        result = WindowMeasurement(
            rows=measured,
            distance2=distance2,
            dof=rows.dof,
            num_used=int(passed.sum()),
            num_misfits=misfits,
            rejected_ids=ids[~passed],
        )
        self._coming = ids[is_landmark & passed]
        used_up = np.isin(tracks.ids, ids) & ~np.isin(tracks.ids, self._coming)
        tracks.keep_rows(tracks.seen[:, -1] & ~used_up)
        return result

    def _promote(self, state: FilterState) -> tuple[FilterState, IntArray]:
        """Let the chosen tracks enter the state as landmarks, from the updated poses."""
        ids, self._coming = self._coming, np.zeros(0, dtype=np.int64)
        if not len(ids):
            return state, ids
        row = np.searchsorted(self.tracks.ids, ids)
        uv, xy, seen = self.tracks.uv_px[row], self.tracks.xy[row], self.tracks.seen[row]
        points = triangulate_window(self.camera, state, uv, xy, seen)
        good = points.is_good
        rows = window_rows(self.camera, self.config.error, state, uv[good], xy[good], seen[good], points.p[good])
        state = add_landmarks(self.config.error, state, ids[good], points.p[good], rows)
        self.tracks.keep_rows(~np.isin(self.tracks.ids, ids))
        return state, ids[good]

    def _retire(self, state: FilterState, leaving: int | None) -> tuple[FilterState, tuple[RetiredClone, ...]]:
        if leaving is None:
            return state, ()
        retired = RetiredClone(
            frame_index=int(state.clone_frame[leaving]),
            T_world_head=se3(state.clone_R[leaving], state.clone_x[leaving]),
            is_keyframe=leaving == 0,
            v_world=state.clone_v[leaving],
            omega_head=state.clone_omega[leaving],
        )
        self.tracks.remove_column(leaving)
        return remove_clone(state, leaving), (retired,)
