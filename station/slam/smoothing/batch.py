"""When the drive has ended: all keyframes and landmarks of a segment in one problem (docs/slam.md, "Smoothing")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from shared.calibration import ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray
from station.motion.preintegration import chain
from station.slam.mapping.inertial_graph import (
    WHEELS_KEY,
    bias_key,
    inertial_factor,
    landmark_key,
    odometry_factor,
    pose_key,
    prior_factors,
    reprojection_factor,
    standstill_factors,
    to_pose,
    velocity_key,
    wheel_factor,
)
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.fixed_lag import SIGMA_START, WHEEL_HUBER
from station.slam.smoothing.keyframe import SmoothKeyframe, camera_pose, reprojections
from station.slam.ukf.filter.constraints import WheelsKnown
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.landmark_map import TrackObservations, triangulate_with_covariance
from station.slam.ukf.map.pose_log import follow_poses
from station.vision.camera_model import CameraModel
from station.vision.lens import BoolArray

GATES = (6.0, 3.0)  # sigmas
MAX_DEPTH_SIGMA = 0.5  # relative; a landmark known worse says nothing of positions
MAX_ITERATIONS = 12
NO_SOLUTION = "keyframes and landmarks leave the equations without a single solution"
NUM_DROPS = 3  # of a track's worst observation


@dataclass(frozen=True, slots=True, eq=False)
class BatchInput:
    camera: CameraModel
    noise: ImuNoise
    gravity: float
    config: SmoothingConfig
    wheels: WheelsKnown | None


def smooth_segment(whole: list[SmoothKeyframe], given: BatchInput, gates: tuple[float, ...] = GATES) -> None:
    """Give all keyframes their final poses, velocities and biases, or leave them as they are.

    Args: gates: sigmas, one round of least squares each.

    Raises:
        DegenerateGeometry: the equations have no single solution.
    """
    keyframes = [replace(k) for k in thinned(whole, given.config.max_keyframes)]
    T_before = np.array([k.T_world_body for k in keyframes])
    for gate in gates:
        SegmentProblem(keyframes, gate, given).solve()
    _bring_along(whole, keyframes, T_before)


def thinned(keyframes: list[SmoothKeyframe], most: int) -> list[SmoothKeyframe]:
    """Every second one, with links joined, until they are few enough: the time of a solution grows with their cube."""
    while len(keyframes) > most:
        pairs = zip(keyframes[1::2], keyframes[2::2], strict=False)
        rest = keyframes[-1:] if len(keyframes) % 2 == 0 else []  # the newest one always stays
        keyframes = [keyframes[0], *(_joined(left_out, k) for left_out, k in pairs), *rest]
    return keyframes


def _joined(left_out: SmoothKeyframe, k: SmoothKeyframe) -> SmoothKeyframe:
    """A keyframe that follows the one before the one that is left out."""
    return replace(
        k,
        link=None if left_out.link is None or k.link is None else chain(left_out.link, k.link),
        frames_since=left_out.frames_since + k.frames_since,
        is_still=left_out.is_still and k.is_still,
        T_before=None if left_out.T_before is None or k.T_before is None else left_out.T_before @ k.T_before,
        is_poor=left_out.is_poor or k.is_poor,
    )


def _bring_along(whole: list[SmoothKeyframe], solved: list[SmoothKeyframe], T_before: FloatArray) -> None:
    """All keyframes get the solution; those left out move as their neighbours did."""
    moved = follow_poses(
        np.array([k.T_world_body for k in whole]),
        np.array([k.source.t_imu_ns for k in whole]),
        T_before,
        np.array([k.T_world_body for k in solved]),
        np.array([k.source.t_imu_ns for k in solved]),
    )
    of = {k.number: k for k in solved}
    for k, T in zip(whole, moved, strict=True):
        better = of.get(k.number)
        if better is None:
            k.v_world = T[:3, :3] @ k.T_world_body[:3, :3].T @ k.v_world
            k.T_world_body = T
        else:
            k.T_world_body, k.v_world, k.bias = better.T_world_body, better.v_world, better.bias


def as_keyframe(k: SmoothKeyframe) -> Keyframe:
    """As the map takes it, without colours."""
    return Keyframe(
        image=k.source.frame,
        tracked=k.tracked,
        rgb=np.zeros((len(k.tracked.ids), 3), dtype=np.uint8),
        T_world_head=k.T_world_body,
        v_world=k.v_world,
        omega_head=k.omega,
        bias=k.bias,
        segment=k.segment,
        link=k.link,
        wheels=k.wheels,
    )


def _triangulated(
    keyframes: Sequence[SmoothKeyframe], table: TrackObservations, camera: CameraModel, gate: float
) -> tuple[IntArray, FloatArray, TrackObservations]:
    """Landmarks (F,), (F, 3) that the present poses give, and the observations that fit them."""
    views = [as_keyframe(k) for k in keyframes]
    for last in range(NUM_DROPS + 1):
        ids, points = triangulate_with_covariance(views, table, camera)
        keep = points.is_good & (points.depth_sigma < MAX_DEPTH_SIGMA)
        ids, p = ids[keep], points.p[keep]
        known, at = _rows(ids, table.track)
        table, at = table.select(known), at[known]
        distance = distances(keyframes, table, p[at], camera)[2]
        bad = ~(distance < gate)
        if not bad.any():
            break
        worst = np.zeros(len(ids))
        size = np.where(np.isfinite(distance), distance, 1e9)
        np.maximum.at(worst, at, size)
        drop = bad if last == NUM_DROPS else bad & (size >= worst[at])
        table = table.select(~drop)
    known, at = _rows(ids, table.track)
    table, at = table.select(known), at[known]
    enough = np.bincount(at, minlength=len(ids)) >= 3
    return ids[enough], p[enough], table.select(enough[at])


def _rows(ids: IntArray, tracks: IntArray) -> tuple[BoolArray, IntArray]:
    """Which tracks are among the ascending ids, and where."""
    if not len(ids):
        return np.zeros(len(tracks), dtype=bool), np.zeros(len(tracks), dtype=np.int64)
    at = np.minimum(np.searchsorted(ids, tracks), len(ids) - 1)
    return ids[at] == tracks, at


def distances(
    keyframes: Sequence[SmoothKeyframe], table: TrackObservations, p: FloatArray, camera: CameraModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`reprojections` of all observations: coordinates (K, 2), sigmas (K,), whitened distances (K,)."""
    xy, sigma, distance = table.xy.copy(), np.zeros(len(p)), np.zeros(len(p))
    for number, view in enumerate(keyframes):
        rows = np.flatnonzero(table.keyframe == number)
        xy[rows], sigma[rows], distance[rows] = reprojections(view, camera, p[rows], table.uv_px[rows], table.xy[rows])
    return xy, sigma, distance


class SegmentProblem:
    """Keyframes of one segment, what is known of their motion, and the landmarks that their tracks show."""

    def __init__(self, keyframes: Sequence[SmoothKeyframe], gate: float, given: BatchInput) -> None:
        """Args: gate: sigmas within which observations fit."""
        self._keyframes = keyframes
        table = TrackObservations.of([as_keyframe(k) for k in keyframes])
        ids, points, table = _triangulated(keyframes, table, given.camera, gate)
        self.num_landmarks = len(points)
        self.graph, self._values = motion_graph(keyframes, given)
        for f, p in enumerate(points):
            self.add_landmark(f, p)
        _, at = _rows(ids, table.track)
        xy, sigma, distance = distances(keyframes, table, points[at], given.camera)
        T_body_cam = to_pose(camera_pose(np.eye(4), given.camera))
        for i in np.flatnonzero(np.isfinite(distance)).tolist():
            number = keyframes[int(table.keyframe[i])].number
            self.graph.push_back(
                reprojection_factor(number, int(at[i]), xy[i], sigma[i], given.config.huber, T_body_cam)
            )

    def add_landmark(self, number: int, p_world: FloatArray) -> None:
        self._values.insert(landmark_key(number), p_world)
        weak = gtsam.noiseModel.Isotropic.Sigma(3, 100.0)
        self.graph.push_back(gtsam.PriorFactorPoint3(landmark_key(number), p_world, weak))

    def solve(self) -> None:
        """Give the keyframes their most likely states. Raises DegenerateGeometry: there is no single solution."""
        values = optimised(self.graph, self._values)
        for k in self._keyframes:
            k.T_world_body = values.atPose3(pose_key(k.number)).matrix()
            k.v_world = values.atVector(velocity_key(k.number))
            k.bias = values.atVector(bias_key(k.number))


def motion_graph(
    keyframes: Sequence[SmoothKeyframe], given: BatchInput
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Keyframes with what IMU, wheels and standing still say of them."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    still = given.config.odometry.wheels
    if given.wheels is not None:
        values.insert(WHEELS_KEY, given.wheels.mean)
        model = gtsam.noiseModel.Diagonal.Sigmas(given.wheels.sigma)
        graph.push_back(gtsam.PriorFactorVector(WHEELS_KEY, given.wheels.mean, model))
    for i, k in enumerate(keyframes):
        n = k.number
        values.insert(pose_key(n), to_pose(k.T_world_body))
        values.insert(velocity_key(n), k.v_world)
        values.insert(bias_key(n), k.bias)
        if i == 0 or k.link is None:
            for factor in prior_factors(n, k.T_world_body, k.v_world, k.bias, SIGMA_START):
                graph.push_back(factor)
        else:
            before = keyframes[i - 1].number
            graph.push_back(inertial_factor(before, n, k.link, given.noise, given.gravity))
            if k.is_poor and k.T_before is not None:
                graph.push_back(odometry_factor(before, n, k.T_before))
            if k.is_still:
                for factor in standstill_factors(
                    before, n, still.sigma_still_rad, still.sigma_still_m, still.sigma_still_m_s
                ):
                    graph.push_back(factor)
        if given.wheels is not None and k.wheels is not None and k.wheels.by_wheels is not None and not k.is_still:
            sigma = k.wheels.sigma / np.sqrt(max(k.frames_since, 1))
            rolling = wheel_factor(n, k.wheels.by_wheels, sigma, WHEEL_HUBER)
            if rolling is not None:
                graph.push_back(rolling)
    return graph, values


def optimised(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Better values. Raises DegenerateGeometry where there is no step towards them."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(MAX_ITERATIONS)
    parameters.setRelativeErrorTol(1e-4)
    parameters.setlambdaInitial(1e-6)
    try:
        better = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        error = graph.error(better)
        if not error < graph.error(values):
            # It also returns the start where no step could be solved for; without damping, that is an error.
            graph.linearize(values).optimize()
    except RuntimeError as exc:  # GTSAM's own kind, for equations that are indeterminate
        raise DegenerateGeometry(NO_SOLUTION) from exc
    if not np.isfinite(error):
        raise DegenerateGeometry(NO_SOLUTION)
    return better
