"""Every derivative of the MonoSLAM filter against differences of what it is the derivative of."""

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.measurement import angles_of, bearing, bearing_by_angles, predict, project, to_xyz
from station.slam.mono.motion import ATTITUDE, POSE, POSITION, first_camera, move
from station.slam.mono.quaternion import from_rotation_vector, normalise, rotate, rotate_by_q
from station.slam.mono.start import Problem
from station.slam.mono.state import State
from station.vision.lens import Lens
from tests.support.mono import hand_held_camera

H = 1e-6
seeds = st.integers(0, 10**6)


def differences(f: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences (..., n) of f by the last axis of `at` (n,)."""
    steps = H * np.eye(len(at))
    return np.stack([(f(at + step) - f(at - step)) / (2 * H) for step in steps], axis=-1)


def unit_quaternion(rng: np.random.Generator) -> FloatArray:
    q = rng.normal(size=4)
    return np.asarray(q / np.linalg.norm(q))


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_quaternion_derivatives_are_those_of_their_functions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, a, phi = rng.normal(size=4), rng.normal(size=3), rng.normal(size=3) * 10.0 ** rng.integers(-9, 1)
    np.testing.assert_allclose(rotate_by_q(q, a), differences(lambda x: rotate(x, a), q), atol=1e-6)
    np.testing.assert_allclose(normalise(q)[1], differences(lambda x: normalise(x)[0], q), atol=1e-6 / np.dot(q, q))
    np.testing.assert_allclose(
        from_rotation_vector(phi)[1], differences(lambda x: from_rotation_vector(x)[0], phi), atol=1e-6
    )


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_motion_derivatives_are_those_of_eq_2_2(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, n, dt = rng.normal(size=13), rng.normal(size=6), rng.uniform(0.01, 0.2)
    x[ATTITUDE] = unit_quaternion(rng)
    _, F, G = move(x, n, dt)
    np.testing.assert_allclose(F, differences(lambda y: move(y, n, dt)[0], x), atol=1e-6)
    np.testing.assert_allclose(G, differences(lambda y: move(x, y, dt)[0], n), atol=1e-6)


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


@given(seeds, st.booleans())
@settings(max_examples=40, deadline=None)
def test_measurement_derivatives_are_those_of_the_projection_through_the_lens(seed: int, is_inverse: bool) -> None:
    rng = np.random.default_rng(seed)
    camera = hand_held_camera().camera
    assert camera is not None
    lens, kind = Lens(camera), np.array([is_inverse])
    x = np.zeros(13)
    x[POSITION] = rng.normal(0.0, 0.1, 3)
    x[ATTITUDE] = normalise(np.array([1.0, *rng.normal(0.0, 0.05, 3)]))[0]
    point = np.array([*rng.uniform(-0.4, 0.4, 2), 1.0]) * rng.uniform(1.0, 5.0)
    y = np.concatenate([point, np.zeros(3)])
    if is_inverse:
        origin = rng.normal(0.0, 0.1, 3)
        away = point - origin
        y = np.concatenate([origin, angles_of(away[None])[0][0], [1.0 / np.linalg.norm(away)]])
    seen = predict(x, y[None], kind, lens)

    def pixel(pose: FloatArray, feature: FloatArray) -> FloatArray:
        return project(pose[POSITION], pose[ATTITUDE], feature[None], kind, lens)[0][0]

    np.testing.assert_allclose(seen.uv_px[0], pixel(x, y))
    np.testing.assert_allclose(seen.by_pose[0], differences(lambda p: pixel(p, y), x[:POSE]), rtol=1e-4, atol=1e-2)
    by_feature = differences(lambda f: pixel(x, f), y)
    np.testing.assert_allclose(seen.by_feature[0], by_feature, rtol=1e-4, atol=1e-2)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_a_new_feature_is_as_uncertain_as_its_pixel_and_its_camera_are(seed: int) -> None:
    """C.2: covariance by the derivatives of the first view, against moved cameras and pixels."""
    rng = np.random.default_rng(seed)
    camera = hand_held_camera().camera
    assert camera is not None
    lens, config, uv = Lens(camera), FilterConfig(), rng.uniform([100, 100], [540, 380], (1, 2))
    x, P = first_camera(config)
    x[:POSE] = np.concatenate([rng.normal(size=3), normalise(np.array([1.0, *rng.normal(0.0, 0.3, 3)]))[0]])
    P[:POSE, :POSE] = np.diag(rng.uniform(1e-6, 1e-4, POSE))
    nothing = np.zeros(0, dtype=np.int64)

    def added(moved: FloatArray, pixel: FloatArray) -> State:
        first = State(np.concatenate([moved, x[POSE:]]), P, nothing, nothing.astype(bool))
        return first.with_features(np.zeros(1, dtype=np.int64), pixel[None], lens, config, config.sigma_px)

    by_pose = differences(lambda p: added(p, uv[0]).features()[0], x[:POSE])
    by_pixel = differences(lambda p: added(x[:POSE], p).features()[0], uv[0])
    expected = by_pose @ P[:POSE, :POSE] @ by_pose.T + config.sigma_px**2 * by_pixel @ by_pixel.T
    expected[5, 5] += config.sigma_first_inverse_depth**2
    state = added(x[:POSE], uv[0])
    np.testing.assert_allclose(state.P[13:, 13:], expected, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(state.P[13:, :POSE], by_pose @ P[:POSE, :POSE], rtol=1e-4, atol=1e-9)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_gradient_of_the_start_is_that_of_its_cost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = hand_held_camera().camera
    assert camera is not None
    K, N = 3, 4
    frame, ids = np.repeat(np.arange(K + 1), N), np.tile(np.arange(N), K + 1)
    seen = ids <= frame  # each picture shows one more
    first = rng.uniform([200, 200], [440, 280], (N, 2))
    uv = first[ids] + rng.uniform(-2.0, 2.0, (len(ids), 2))
    problem = Problem(Lens(camera), FilterConfig(), np.array([0.03, 0.05, 0.04]), ids[seen], frame[seen], uv[seen], 1.0)
    u = problem.mean + rng.normal(0.0, 0.1, len(problem.mean)) * problem.sigma

    def cost(at: FloatArray) -> FloatArray:
        return np.array([problem.linearised(at)[0].cost])

    expected = 0.5 * differences(cost, u)[0]
    np.testing.assert_allclose(problem.linearised(u)[2], expected, rtol=1e-4, atol=1e-3 * np.abs(expected).max())
