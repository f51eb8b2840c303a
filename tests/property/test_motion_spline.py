"""The continuous-time motion: its derivatives by time and by knots are those of finite differences."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray, so3_exp, so3_log
from station.calibration.camera_imu.spline import ORDER, Motion, blending_polynomials, motion_through

SEEDS = st.integers(0, 10_000)
STEP = 1e-6


def drawn_motion(rng: np.random.Generator, num_knots: int = 9) -> Motion:
    """Turns by about half a radian from knot to knot."""
    R = np.empty((num_knots, 3, 3))
    R[0] = so3_exp(rng.normal(0.0, 1.0, 3))
    for i in range(1, num_knots):
        R[i] = R[i - 1] @ so3_exp(rng.normal(0.0, 0.3, 3))
    return Motion(2.0, 0.1, R, rng.normal(0.0, 1.0, (num_knots, 3)))


def drawn_times(rng: np.random.Generator, motion: Motion) -> FloatArray:
    return rng.uniform(motion.start_s + 0.01, motion.end_s - 0.01, 12)


def rates(R_before: FloatArray, R_after: FloatArray, seconds: float) -> FloatArray:
    """(N, 3) rad/s in the body's frame."""
    return so3_log(np.swapaxes(R_before, 1, 2) @ R_after) / seconds


def test_weights_of_a_time_sum_to_one() -> None:
    u = np.linspace(0.0, 1.0, 5)
    for order in (1, 2, 4, ORDER):
        weights = u[:, None] ** np.arange(order) @ blending_polynomials(order).T
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        assert (weights >= -1e-15).all()


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_velocity_acceleration_and_rate_are_derivatives_by_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = drawn_motion(rng)
    t, h = drawn_times(rng, motion), 1e-5
    now, before, after = (motion.weights(t + s) for s in (0.0, -h, h))
    _, v, a = motion.positions(now)
    (p_before, v_before, _), (p_after, v_after, _) = motion.positions(before), motion.positions(after)
    np.testing.assert_allclose((p_after - p_before) / (2 * h), v, atol=1e-4)
    np.testing.assert_allclose((v_after - v_before) / (2 * h), a, atol=1e-2)
    measured = rates(motion.orientations(before).R, motion.orientations(after).R, 2 * h)
    np.testing.assert_allclose(measured, motion.orientations(now).omega, atol=1e-4)


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_derivatives_by_knots_are_those_of_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = drawn_motion(rng)
    weights = motion.weights(drawn_times(rng, motion))
    here = motion.orientations(weights)
    step = rng.normal(0.0, 1.0, (len(motion.p_knots), 6))
    near, far = (motion.moved(s * STEP * step).orientations(weights) for s in (-0.5, 0.5))
    acting = step[weights.segment[:, None] + np.arange(ORDER), :3]
    own, none = np.broadcast_to(np.eye(3), (2, len(acting), 3, 3)) * np.array([1.0, 0.0])[:, None, None, None]
    by_knots = np.einsum("nikj,nkj->ni", here.by_knots(own), acting)
    np.testing.assert_allclose(rates(near.R, far.R, STEP), by_knots, atol=1e-6)
    by_knots = np.einsum("nikj,nkj->ni", here.by_knots(none, own), acting)
    np.testing.assert_allclose((far.omega - near.omega) / STEP, by_knots, atol=1e-4)


def test_a_motion_through_poses_passes_near_them() -> None:
    t = np.linspace(0.0, 2.0, 201)
    R = so3_exp(np.stack([np.sin(t), 0.3 * np.cos(2 * t), 0.2 * t], axis=1))
    p = np.stack([np.cos(t), t, np.sin(2 * t)], axis=1)
    motion = motion_through(t, R, p, -0.1, 2.1, 0.02)
    weights = motion.weights(t[10:-10])
    np.testing.assert_allclose(motion.orientations(weights).R, R[10:-10], atol=1e-3)
    np.testing.assert_allclose(motion.positions(weights)[0], p[10:-10], atol=1e-3)
