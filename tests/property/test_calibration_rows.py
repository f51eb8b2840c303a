"""What camera and IMU should measure: derivatives by every unknown are those of finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray
from station.calibration.camera_imu.rows import KNOT, Corners, Rows, Samples, camera_rows, inertial_rows
from station.calibration.camera_imu.spline import ORDER, motion_through
from station.calibration.camera_imu.unknowns import BEND, BIASES, DELAY, INTRINSICS, SHIFT, Unknowns
from tests.support.calibration_sessions import ORIGIN_NS, HandheldMotion, Session, Waving, make_session

SESSION = make_session(3, duration_s=2.0)
SEEDS = st.integers(0, 10_000)
STEP = 1e-6


def true_unknowns(session: Session, seed: int) -> Unknowns:
    """About where the session is: corners in view, nothing at zero."""
    rng = np.random.default_rng(seed)
    t = np.arange(-0.4, 2.4, 0.01)
    handheld = HandheldMotion(rng, Waving(), session.target, session.camera.T_body_cam_matrix)
    motion = motion_through(t, *handheld.body(t), -0.3, 2.3, 0.02)
    return Unknowns(
        motion, session.camera, session.gravity_target, rng.normal(0.0, 0.1, (2, 6)), 1.02, rng.normal(0, 0.01, 3)
    )


def step_sizes(size: int) -> FloatArray:
    """Of the border: such that each changes the residuals by about as much."""
    sizes = np.ones(size)
    sizes[[SHIFT, DELAY]] = 1.0, 1e-3
    sizes[INTRINSICS] = [100, 100, 100, 100, 1, 1, 1, 1]
    sizes[BEND] = 0.1
    return sizes


def changes(rows: Rows, knots: FloatArray, border: FloatArray) -> FloatArray:
    """(N, m) first-order change of the residuals by a step."""
    acting = knots[rows.segment[:, None] + np.arange(ORDER)].reshape(len(rows.segment), KNOT * ORDER)
    by_knots = np.einsum("nmk,nk->nm", rows.by_knots, acting)
    return by_knots + np.einsum("nmc,c->nm", rows.by_border, border[rows.columns])


@settings(max_examples=12, deadline=None)
@given(SEEDS)
def test_inertial_rows_change_as_their_derivatives_say(seed: int) -> None:
    unknowns = true_unknowns(SESSION, seed)
    samples = Samples.of(SESSION.imu, SESSION.noise, ORIGIN_NS).between(-0.2, 2.2)
    rng = np.random.default_rng(seed)
    knots = rng.normal(0.0, 1.0, (len(unknowns.motion.p_knots), KNOT)) * 1e-2
    border = rng.normal(0.0, 1.0, unknowns.size)
    near, far = (inertial_rows(unknowns.moved(s * STEP * knots, s * STEP * border), samples) for s in (-0.5, 0.5))
    expected = changes(inertial_rows(unknowns, samples), knots, border)
    np.testing.assert_allclose(
        (far.residual - near.residual) / STEP, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max()
    )


@settings(max_examples=12, deadline=None)
@given(SEEDS)
def test_camera_rows_change_as_their_derivatives_say(seed: int) -> None:
    unknowns = true_unknowns(SESSION, seed)
    corners = Corners.of(SESSION.views, SESSION.target, ORIGIN_NS, 0.3)
    corners = replace(corners, t_s=corners.t_s + 0.05)
    rng = np.random.default_rng(seed)
    knots = rng.normal(0.0, 1.0, (len(unknowns.motion.p_knots), KNOT))
    border = rng.normal(0.0, 1.0, unknowns.size) * step_sizes(unknowns.size)
    border[BIASES:] = 0.0
    near, far = (camera_rows(unknowns.moved(s * STEP * knots, s * STEP * border), corners) for s in (-0.5, 0.5))
    expected = changes(camera_rows(unknowns, corners), knots, border)
    np.testing.assert_allclose(
        (far.residual - near.residual) / STEP, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max()
    )
