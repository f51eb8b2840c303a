"""Laws of trajectory errors: what an alignment takes away does not count, whatever the trajectories."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray, carry_poses, se3, sim3, so3_exp, yaw_rotation
from station.experiments.alignment import AlignmentKind
from station.experiments.trajectory_error import absolute_trajectory_error, relative_pose_error
from station.model.navigation import Trajectory

KINDS: tuple[AlignmentKind, ...] = get_args(AlignmentKind)
SEEDS = st.integers(0, 2**32 - 1)
COUNT = 25


def trajectory(rng: np.random.Generator) -> Trajectory:
    turns, steps = rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3))
    poses = [se3(so3_exp(turn), p) for turn, p in zip(turns, steps.cumsum(axis=0), strict=True)]
    return Trajectory(np.arange(COUNT, dtype=np.int64) * 250_000_000, np.array(poses))


def noisy(truth: Trajectory, rng: np.random.Generator) -> Trajectory:
    noise = [se3(so3_exp(rng.normal(0, 0.02, 3)), rng.normal(0, 0.05, 3)) for _ in range(COUNT)]
    return Trajectory(truth.t_robot_ns, truth.T_world_body @ np.array(noise))


def carried(T: FloatArray, path: Trajectory) -> Trajectory:
    return Trajectory(path.t_robot_ns, carry_poses(T, path.T_world_body))


def some_motion(rng: np.random.Generator, kind: AlignmentKind) -> FloatArray:
    R = yaw_rotation(float(rng.uniform(-3, 3))) if kind == "yaw" else so3_exp(rng.normal(size=3))
    return sim3(float(rng.uniform(0.2, 5.0)) if kind == "sim3" else 1.0, R, rng.normal(size=3))


@pytest.mark.parametrize("kind", KINDS)
@given(seed=SEEDS)
def test_the_frame_of_the_estimate_does_not_count(kind: AlignmentKind, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = trajectory(rng)
    estimate = noisy(truth, rng)
    before = absolute_trajectory_error(estimate, truth, kind)
    after = absolute_trajectory_error(carried(some_motion(rng, kind), estimate), truth, kind)
    assert after.rmse_m == pytest.approx(before.rmse_m, rel=1e-6)
    assert after.rotation_rmse_rad == pytest.approx(before.rotation_rmse_rad, rel=1e-6)


@given(seed=SEEDS)
def test_drift_does_not_depend_on_either_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = trajectory(rng)
    estimate = noisy(truth, rng)
    moved = carried(some_motion(rng, "se3"), estimate), carried(some_motion(rng, "se3"), truth)
    before, after = relative_pose_error(estimate, truth, 1.0), relative_pose_error(*moved, 1.0)
    assert after.translation_rmse_m == pytest.approx(before.translation_rmse_m, rel=1e-6)


@given(seed=SEEDS)
def test_more_freedom_never_makes_the_error_larger(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = trajectory(rng)
    estimate = carried(some_motion(rng, "sim3"), noisy(truth, rng))
    yaw, se3_error, sim3_error = (absolute_trajectory_error(estimate, truth, kind).rmse_m for kind in KINDS)
    assert sim3_error <= se3_error * (1 + 1e-9) and se3_error <= yaw * (1 + 1e-9)
