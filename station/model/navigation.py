"""A navigation: one recorded drive and what SLAM made of it. Every SLAM backend ends in this; places start from it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from shared.calibration import Calibration, CameraCalibration, DepthCalibration
from shared.geometry import FloatArray, IntArray, transform
from station.model.calibration_fit import CalibrationFit

if TYPE_CHECKING:  # it brings OpenCV, which commands that read reports alone do not wait for
    from station.model.frames import DepthArray


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over time. World frame: of this navigation; z up and metres where the navigation says so."""

    t_robot_ns: IntArray  # (N,) increasing; the IMU's time (frame time + CameraCalibration.time_shift_s)
    T_world_body: FloatArray  # (N, 4, 4); body = IMU, or the camera where there is no IMU

    def __len__(self) -> int:
        return len(self.t_robot_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Keyframes:
    """The frames that landmarks are observed from."""

    frame_index: IntArray  # (F,) ImageFrame.index
    t_robot_ns: IntArray  # (F,)
    T_world_cam: FloatArray  # (F, 4, 4)
    encoded: tuple[bytes, ...]  # (F,) JPEG or PNG files
    segment: IntArray  # (F,) number of the piece of unbroken tracking this keyframe belongs to

    def __len__(self) -> int:
        return len(self.t_robot_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """3D points and who saw them: row i of (M, ...) is a landmark, row k of (K, ...) an observation."""

    p_world: FloatArray  # (M, 3)
    rgb: npt.NDArray[np.uint8]  # (M, 3)
    cov_world: FloatArray  # (M, 3, 3); zero where unknown
    observed_landmark: IntArray  # (K,) index into p_world
    observed_keyframe: IntArray  # (K,) index into Keyframes
    observed_uv_px: FloatArray  # (K, 2) as measured, distorted pixels

    def __len__(self) -> int:
        return len(self.p_world)

    @property
    def num_observations(self) -> IntArray:
        """(M,) how often each landmark was observed in keyframes."""
        return np.bincount(self.observed_landmark, minlength=len(self)).astype(np.int64)

    def first_keyframe(self) -> IntArray:
        """(M,) the keyframe each landmark was first seen from (thesis: its generating image); -1 for none."""
        first = np.full(len(self), np.iinfo(np.int64).max)
        np.minimum.at(first, self.observed_landmark, self.observed_keyframe)
        first[first == np.iinfo(np.int64).max] = -1
        return first

    def moved(self, T: FloatArray) -> Landmarks:
        """Carried into another frame by a similarity T (4, 4)."""
        A = T[:3, :3]
        return replace(self, p_world=transform(T, self.p_world), cov_world=A @ self.cov_world @ A.T)

    def observations_by_keyframe(self, num_keyframes: int) -> list[IntArray]:
        """For each keyframe the rows of its observations, in the order in which they are stored."""
        order = np.argsort(self.observed_keyframe, kind="stable")
        begin = np.searchsorted(self.observed_keyframe[order], np.arange(num_keyframes + 1))
        return [order[a:b] for a, b in itertools.pairwise(begin)]


@dataclass(frozen=True, slots=True, eq=False)
class DepthScans:
    """What a depth sensor measured on the way, with fewer pixels than it has. Where it was, the trajectory says."""

    t_robot_ns: IntArray  # (D,) increasing, the trajectory's clock
    millimetres: DepthArray  # (D, h, w) along the sensor's axis; 0: nothing was measured
    sensor: DepthCalibration  # of these pixels

    def __len__(self) -> int:
        return len(self.t_robot_ns)

    def points_body(self, number: int) -> FloatArray:
        """(n, 3) m what one scan measured."""
        v, u = np.nonzero(self.millimetres[number])
        z = self.millimetres[number][v, u] * 1e-3
        s = self.sensor
        return transform(s.T_body_depth_matrix, np.column_stack([(u - s.cx) / s.fx * z, (v - s.cy) / s.fy * z, z]))


def join_depth(first: DepthScans | None, second: DepthScans | None, shift_ns: int) -> DepthScans | None:
    """The scans of both, the second's so much later. Of two sensors the first one's: scans have one shape."""
    if second is None or (first is not None and first.sensor != second.sensor):
        return first
    second = replace(second, t_robot_ns=second.t_robot_ns + shift_ns)
    if first is None:
        return second
    return DepthScans(
        np.concatenate([first.t_robot_ns, second.t_robot_ns]),
        np.concatenate([first.millimetres, second.millimetres]),
        first.sensor,
    )


def join_maps(parts: Sequence[tuple[Keyframes, Landmarks]]) -> tuple[Keyframes, Landmarks]:
    """All keyframes and landmarks of several parts, in their order; what observes what stays."""
    keyframes, landmarks = [k for k, _ in parts], [m for _, m in parts]
    first_keyframe = np.cumsum([0, *map(len, keyframes)]).tolist()
    first_landmark = np.cumsum([0, *map(len, landmarks)]).tolist()
    return Keyframes(
        frame_index=np.concatenate([k.frame_index for k in keyframes]),
        t_robot_ns=np.concatenate([k.t_robot_ns for k in keyframes]),
        T_world_cam=np.concatenate([k.T_world_cam for k in keyframes]),
        encoded=tuple(file for k in keyframes for file in k.encoded),
        segment=np.concatenate([k.segment for k in keyframes]),
    ), Landmarks(
        p_world=np.concatenate([m.p_world for m in landmarks]),
        rgb=np.concatenate([m.rgb for m in landmarks]),
        cov_world=np.concatenate([m.cov_world for m in landmarks]),
        observed_landmark=np.concatenate([m.observed_landmark + first_landmark[i] for i, m in enumerate(landmarks)]),
        observed_keyframe=np.concatenate([m.observed_keyframe + first_keyframe[i] for i, m in enumerate(landmarks)]),
        observed_uv_px=np.concatenate([m.observed_uv_px for m in landmarks]),
    )


@dataclass(frozen=True, slots=True)
class NavigationReport:
    """What `navigation.json` says of the run (CONTRACT: Files written)."""

    backend: str
    frames: int
    duration_s: float
    wall_s: float
    realtime_factor: float
    cpu_s: float
    landmarks: int
    tracking_lost_s: float
    scale: Literal["metric", "arbitrary"]
    gravity_aligned: bool
    seed: int
    versions: dict[str, str]
    config: dict[str, Any]
    messages: tuple[str, ...] = ()  # what a person should know, in sentences
    calibration_fit: CalibrationFit | None = None  # None: not asked, or too little was followed
    told_camera: CameraCalibration | None = None  # before the fit corrected it; None: the calibration's is as told
    unsure: str = ""  # why nothing of the map of a navigation that was joined to it may be said for sure, in a sentence


@dataclass(frozen=True, slots=True, eq=False)
class Navigation:
    """One navigation, finished."""

    id: str
    calibration: Calibration  # that the map was made with: as told, its camera corrected where the drive knew better
    trajectory: Trajectory
    keyframes: Keyframes
    landmarks: Landmarks
    report: NavigationReport
    depth: DepthScans | None = None  # None: nothing measured depth

    @property
    def is_metric(self) -> bool:
        return self.report.scale == "metric"

    @property
    def is_gravity_aligned(self) -> bool:
        return self.report.gravity_aligned
