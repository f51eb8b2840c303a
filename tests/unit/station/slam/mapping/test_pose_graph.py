"""The pose graph: loops take out what odometry drifted by, upright; one that the others contradict is left."""

from __future__ import annotations

import itertools

import numpy as np

from shared.geometry import FloatArray, inverse, se3, so3_log, yaw_rotation
from station.slam.mapping.odometry import DEAD_RECKONED, RelativeMotions
from station.slam.mapping.pose_graph import LoopEdge, solve_pose_graph

LAPS, PER_LAP = 3, 40
COV = np.diag(np.repeat([0.004, 0.02], 3) ** 2)


def laps() -> FloatArray:
    """(N, 4, 4) three times around a room of 4 m by 4 m."""
    angle = 2.0 * np.pi * np.arange(LAPS * PER_LAP) / PER_LAP
    return np.array([se3(yaw_rotation(a), np.array([2.0 * np.cos(a), 2.0 * np.sin(a), 0.3])) for a in angle])


def drifted(T_true: FloatArray, yaw_per_step: float, scale: float) -> RelativeMotions:
    """Odometry that turns a bit too far and goes a bit too short, always the same way."""
    step = np.array([inverse(a) @ b for a, b in itertools.pairwise(T_true)])
    step[:, :3, :3] = step[:, :3, :3] @ yaw_rotation(yaw_per_step)
    step[:, :3, 3] *= scale
    T = [T_true[0]]
    for move in step:
        T.append(T[-1] @ move)
    n = len(step)
    return RelativeMotions(
        T_world_body=np.array(T),
        R=step[:, :3, :3],
        R_sum=np.zeros((n, 3, 3)),
        p=step[:, :3, 3],
        sigma_rotation=np.full(n, 0.002),
        sigma_position=np.full((n, 3), 0.01),
        drift=DEAD_RECKONED,
        slips=np.zeros(n, dtype=bool),
    )


def loop(T_true: FloatArray, a: int, b: int, aside_m: float = 0.0) -> LoopEdge:
    T = inverse(T_true[a]) @ T_true[b]
    T[0, 3] += aside_m
    return LoopEdge(a, b, T, COV)


def worst_m(T: FloatArray, T_true: FloatArray) -> float:
    return float(np.linalg.norm(T[:, :3, 3] - T_true[:, :3, 3], axis=1).max())


def test_loops_take_out_the_drift() -> None:
    T_true = laps()
    odometry = drifted(T_true, yaw_per_step=0.0015, scale=0.998)
    assert worst_m(odometry.T_world_body, T_true) > 0.3  # 15 sigmas of a loop
    loops = [loop(T_true, k - PER_LAP, k) for k in range(PER_LAP, LAPS * PER_LAP, 10)]
    T = solve_pose_graph(odometry, loops, odometry.T_world_body)
    assert worst_m(T, T_true) < 0.08
    assert np.allclose(T[0], T_true[0], atol=1e-5)
    assert np.linalg.norm(so3_log(np.swapaxes(T_true[:, :3, :3], 1, 2) @ T[:, :3, :3]), axis=1).max() < 0.03


def test_a_loop_that_the_others_contradict_is_not_followed() -> None:
    T_true = laps()
    odometry = drifted(T_true, yaw_per_step=0.0, scale=1.0)
    loops = [loop(T_true, k - PER_LAP, k) for k in range(PER_LAP, LAPS * PER_LAP, 10)]
    false = loop(T_true, 5, 95, aside_m=1.0)
    assert worst_m(solve_pose_graph(odometry, [*loops, false], odometry.T_world_body), T_true) < 0.03


def test_a_tilted_loop_tilts_nothing() -> None:
    T_true = laps()
    odometry = drifted(T_true, yaw_per_step=0.0, scale=1.0)
    tilt = np.eye(4)
    tilt[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.9998, -0.02], [0.0, 0.02, 0.9998]])
    edge = LoopEdge(0, PER_LAP, inverse(T_true[0]) @ T_true[PER_LAP] @ tilt, COV)
    T = solve_pose_graph(odometry, [edge], odometry.T_world_body)
    assert np.abs(T[:, 2, 2] - 1.0).max() < 1e-5  # 0.25 degrees; the loop says 1.1
