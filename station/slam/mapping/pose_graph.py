"""A pose graph: what odometry says between neighbours, and loops between what is far apart in time (GTSAM).

Roll and pitch are the accelerometer's: a loop moves position and yaw (4 degrees of freedom; Qin et al., VINS-Mono,
T-RO 34(4), 2018, section VIII).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from shared.geometry import FloatArray
from station.slam.mapping.inertial_graph import landmark_key, pose_key, reprojection_factor, to_pose
from station.slam.mapping.odometry import RelativeMotions

SIGMA_UPRIGHT_RAD = 0.003  # of a visual-inertial attitude, against gravity
SIGMA_HELD = 1e-6  # of the first pose, which is a definition
LOOP_SCALE = 3.0  # sigmas; a loop further off than that loses its say (Geman and McClure's loss)
HUBER = 1.5  # sigmas, of what is seen again
MAX_ITERATIONS = 20
UP = gtsam.Unit3(np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, slots=True, eq=False)
class LoopEdge:
    a: int
    b: int
    T_a_b: FloatArray  # (4, 4)
    cov: FloatArray  # (6, 6) rotation (rad), position (m), in b's frame


def solve_pose_graph(motions: RelativeMotions, loops: Sequence[LoopEdge], T_start: FloatArray) -> FloatArray:
    """(N, 4, 4) most likely poses.

    Args:
        motions: from each pose to the next; its poses say which way is up.
        T_start: (N, 4, 4) from which to search; the first one stays.
    """
    graph = _odometry_graph(motions, T_start[0])
    values = gtsam.Values()
    for k, T in enumerate(T_start):
        values.insert(pose_key(k), to_pose(T))
    # As if all loops were true, since the first one may be many sigmas off; then those that the others contradict go.
    for loss in (None, gtsam.noiseModel.mEstimator.GemanMcClure.Create(LOOP_SCALE)):
        whole = graph.clone()
        for loop in loops:
            noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(loop.cov)
            if loss is not None:
                noise = gtsam.noiseModel.Robust.Create(loss, noise)
            whole.push_back(gtsam.BetweenFactorPose3(pose_key(loop.a), pose_key(loop.b), to_pose(loop.T_a_b), noise))
        values = gtsam.LevenbergMarquardtOptimizer(whole, values, _parameters()).optimize()
    return np.array([values.atPose3(pose_key(k)).matrix() for k in range(len(T_start))])


def locate(
    T_world_body: FloatArray, points: FloatArray, cov: FloatArray, xy: FloatArray, sigma: float, T_body_cam: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Pose (4, 4) of a body whose camera sees points that are not exactly known; its covariance (6, 6) as of a loop.

    A narrow camera can hardly tell a turn from a step aside: covariance, not sigmas, says what it does tell.

    Args:
        T_world_body: about where it is.
        points, cov: (n, 3), (n, 3, 3); xy: (n, 2) normalised coordinates, each known to sigma.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(pose_key(0), to_pose(T_world_body))
    on_body = to_pose(T_body_cam)
    for i, p in enumerate(points):
        values.insert(landmark_key(i), p)
        graph.push_back(gtsam.PriorFactorPoint3(landmark_key(i), p, gtsam.noiseModel.Gaussian.Covariance(cov[i])))
        graph.push_back(reprojection_factor(0, i, xy[i], sigma, HUBER, on_body))
    try:
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, _parameters()).optimize()
        known = gtsam.Marginals(graph, values).marginalCovariance(pose_key(0))
    except RuntimeError:  # GTSAM's own kind, for equations that are indeterminate
        return None
    return values.atPose3(pose_key(0)).matrix(), known


def _parameters() -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(MAX_ITERATIONS)
    return parameters


def _odometry_graph(motions: RelativeMotions, T_first: FloatArray) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    held = gtsam.noiseModel.Isotropic.Sigma(6, SIGMA_HELD)
    graph.push_back(gtsam.PriorFactorPose3(pose_key(0), to_pose(T_first), held))
    level = gtsam.noiseModel.Isotropic.Sigma(2, SIGMA_UPRIGHT_RAD)
    for k in range(len(motions.p)):
        sigma = np.concatenate([np.repeat(motions.sigma_rotation[k], 3), motions.sigma_position[k]])
        step = gtsam.Pose3(gtsam.Rot3(motions.R[k]), motions.p[k])
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigma)
        graph.push_back(gtsam.BetweenFactorPose3(pose_key(k), pose_key(k + 1), step, noise))
        up_body = gtsam.Unit3(motions.T_world_body[k + 1, 2, :3])
        graph.push_back(gtsam.AttitudeFactorPose3(pose_key(k + 1), UP, level, up_body))
    return graph
