"""Every derivative of the MonoSLAM filter against differences of what it is the derivative of."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray, so3_exp, so3_log
from station.slam.mono.config import MonoConfig
from station.slam.mono.measurement import Predicted, first_seen, predict, to_xyz
from station.slam.mono.motion import ATTITUDE, CAMERA, POSE, POSITION, TURN, VELOCITY, move
from station.slam.mono.state import State
from station.vision.bearings import angles_of, bearing, bearing_by_angles
from station.vision.lens import Lens
from tests.support.mono import hand_held_camera

H = 1e-6
seeds = st.integers(0, 10**6)


def differences(f: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences (..., n) of f by the last axis of `at` (n,)."""
    steps = H * np.eye(len(at))
    return np.stack([(f(at + step) - f(at - step)) / (2 * H) for step in steps], axis=-1)


def hand_held_lens() -> Lens:
    camera = hand_held_camera().camera
    assert camera is not None
    return Lens(camera)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_motion_derivatives_are_those_of_eq_2_2(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, n, dt, R = rng.normal(size=CAMERA), rng.normal(size=6), rng.uniform(-0.2, 0.2), so3_exp(rng.normal(size=3))
    x[ATTITUDE] = 0.0
    new, R_new, F, G = move(x, R, n, dt)

    def off(at: FloatArray, impulse: FloatArray) -> FloatArray:
        """The new state beside that without a step; at[ATTITUDE] turns the camera about its own axes."""
        moved, turned, _, _ = move(
            np.where(np.arange(CAMERA) // 3 == 1, 0.0, at), R @ so3_exp(at[ATTITUDE]), impulse, dt
        )
        difference = moved - new
        difference[ATTITUDE] = so3_log(R_new.T @ turned)
        return difference

    np.testing.assert_allclose(F, differences(lambda y: off(y, n), x), atol=1e-6)
    np.testing.assert_allclose(G, differences(lambda y: off(x, y), n), atol=1e-6)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_motion_is_eq_2_2(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, n, dt, R = rng.normal(size=CAMERA), rng.normal(size=6), rng.uniform(0.01, 0.2), so3_exp(rng.normal(size=3))
    x[ATTITUDE] = 0.0
    new, R_new, _, _ = move(x, R, n, dt)
    np.testing.assert_allclose(new[POSITION], x[POSITION] + (x[VELOCITY] + n[:3]) * dt)
    np.testing.assert_allclose(R_new, R @ so3_exp((x[TURN] + n[3:]) * dt))
    np.testing.assert_allclose(np.concatenate([new[VELOCITY], new[TURN]]), np.append(x[VELOCITY], x[TURN]) + n)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_bearing_derivatives_are_those_of_c4_and_its_inverse_undoes_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles, ray = rng.uniform(-1.2, 1.2, 2), rng.normal(size=3) + np.array([0.0, 0.0, 2.5])
    np.testing.assert_allclose(bearing_by_angles(angles), differences(bearing, angles), atol=1e-6)
    np.testing.assert_allclose(
        angles_of(ray[None])[1][0], differences(lambda x: angles_of(x[None])[0][0], ray), atol=1e-5
    )
    np.testing.assert_allclose(bearing(angles_of(ray[None])[0][0]), ray / np.linalg.norm(ray), atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_derivative_of_a_point_is_that_of_c3(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = np.concatenate([rng.normal(size=3), rng.uniform(-1.0, 1.0, 2), rng.uniform(0.2, 2.0, 1)])
    np.testing.assert_allclose(to_xyz(y[None])[1][0], differences(lambda x: to_xyz(x[None])[0][0], y), atol=1e-4)


def seen_from(pose: FloatArray, R: FloatArray, y: FloatArray, is_inverse: bool, lens: Lens) -> Predicted:
    """From a camera at pose (6,), whose last three turn it away from R about its own axes."""
    return predict(pose[POSITION], R @ so3_exp(pose[ATTITUDE]), y[None], np.array([is_inverse]), lens)


@given(seeds, st.booleans())
@settings(max_examples=40, deadline=None)
def test_measurement_derivatives_are_those_of_the_projection_through_the_lens(seed: int, is_inverse: bool) -> None:
    rng, lens = np.random.default_rng(seed), hand_held_lens()
    pose, R = np.append(rng.normal(0.0, 0.1, 3), np.zeros(3)), so3_exp(rng.normal(0.0, 0.05, 3))
    point = np.array([*rng.uniform(-0.4, 0.4, 2), 1.0]) * rng.uniform(1.0, 5.0)
    y = np.concatenate([point, np.zeros(3)])
    if is_inverse:
        origin = rng.normal(0.0, 0.1, 3)
        away = point - origin
        y = np.concatenate([origin, angles_of(away[None])[0][0], [1.0 / np.linalg.norm(away)]])
    seen = seen_from(pose, R, y, is_inverse, lens)
    h = R.T @ (point - pose[POSITION])  # eq. 2.4, of either kind of feature
    np.testing.assert_allclose(seen.uv_px[0], lens.project(h[:2] / h[2]), atol=1e-6)

    by_pose = differences(lambda p: seen_from(p, R, y, is_inverse, lens).uv_px[0], pose)
    by_feature = differences(lambda f: seen_from(pose, R, f, is_inverse, lens).uv_px[0], y)
    np.testing.assert_allclose(seen.by_pose[0], by_pose, rtol=1e-4, atol=1e-2)
    kept = 6 if is_inverse else 3
    np.testing.assert_allclose(seen.by_feature[0, :, :kept], by_feature[:, :kept], rtol=1e-4, atol=1e-2)
    assert is_inverse or not seen.by_feature[0, :, 3:].any()


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_first_view_derivatives_are_those_of_c2(seed: int) -> None:
    rng, lens = np.random.default_rng(seed), hand_held_lens()
    r, R, own = (
        rng.normal(size=3),
        so3_exp(rng.normal(0.0, 0.3, 3)),
        np.append(rng.uniform([100, 100], [540, 380]), 0.3),
    )

    def feature(pose: FloatArray, uv_rho: FloatArray) -> FloatArray:
        R_moved = R @ so3_exp(pose[ATTITUDE])
        return first_seen(pose[POSITION], R_moved, uv_rho[None, :2], float(uv_rho[2]), lens)[0][0]

    pose = np.append(r, np.zeros(3))
    _, by_pose, by_own = first_seen(r, R, own[None, :2], 0.3, lens)
    np.testing.assert_allclose(by_pose[0], differences(lambda p: feature(p, own), pose), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(by_own[0], differences(lambda o: feature(pose, o), own), rtol=1e-4, atol=1e-6)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_a_new_feature_is_as_uncertain_as_its_pixel_and_its_camera_are(seed: int) -> None:
    """C.2: covariance by the derivatives of the first view."""
    rng, lens, config = np.random.default_rng(seed), hand_held_lens(), MonoConfig()
    uv = rng.uniform([100, 100], [540, 380], (1, 2))
    state = State.first(config)
    x, P, R = state.x.copy(), state.P.copy(), so3_exp(rng.normal(0.0, 0.3, 3))
    x[POSITION] = rng.normal(size=3)
    P[:POSE, :POSE] = np.diag(rng.uniform(1e-6, 1e-4, POSE))
    A = rng.normal(size=(2, 2))
    noise = A @ A.T + np.eye(2)
    state = replace(state, x=x, R=R, P=P)
    state = state.with_features(np.zeros(1, dtype=np.int64), uv, noise[None], lens, config, config.sigma_px)
    _, by_pose, by_own = first_seen(x[POSITION], R, uv, config.first_inverse_depth, lens)
    own = np.zeros((3, 3))
    own[:2, :2], own[2, 2] = config.sigma_px**2 * noise, config.sigma_first_inverse_depth**2
    expected = by_pose[0] @ P[:POSE, :POSE] @ by_pose[0].T + by_own[0] @ own @ by_own[0].T
    np.testing.assert_allclose(state.P[CAMERA:, CAMERA:], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(state.P[CAMERA:, :POSE], by_pose[0] @ P[:POSE, :POSE], rtol=1e-9, atol=1e-12)
