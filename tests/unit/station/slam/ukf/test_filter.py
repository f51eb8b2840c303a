"""Propagation, camera update and the whole filter, against finite differences, closed forms and statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from shared.calibration import Calibration, CameraCalibration, ImuNoise
from shared.geometry import FloatArray, se3, so3_exp, so3_log
from station.motion.error_coordinates import ErrorKind, difference_group, pose_jacobian, retract_group
from station.motion.imu_buffer import ImuBuffer
from station.motion.preintegration import ImuSegment, chain, preintegrate
from station.slam.ukf.filter.config import FilterConfig
from station.slam.ukf.filter.constraints import (
    BodyVelocity,
    Rolled,
    SamePlace,
    WheelConfig,
    wheel_velocity,
    with_way,
)
from station.slam.ukf.filter.filter import VioFilter
from station.slam.ukf.filter.landmarks import measure_landmarks
from station.slam.ukf.filter.measurement import linearise, regress
from station.slam.ukf.filter.propagation import PropagationConfig, propagate
from station.slam.ukf.filter.state import (
    PHI,
    XI_X,
    FilterState,
    add_clone,
    add_wheels,
    initial_state,
    keep_landmarks,
    remove_clone,
    retract,
)
from station.slam.ukf.filter.update import Gate, Measurements, update
from station.vision.camera_model import CameraModel, normalised_points
from station.vision.triangulation import triangulate
from tests.support.synthetic_run import observe, room_points, sine_path

KINDS = list(ErrorKind)
NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
# The optical axis along the body's x: camera x right (-y body), y down (-z body).
R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CAMERA = CameraCalibration(
    width=752,
    height=480,
    fx=458.0,
    fy=457.0,
    cx=367.0,
    cy=248.0,
    distortion=(-0.28, 0.074, 0.0002, 1.8e-5),
    T_body_cam=tuple(se3(R_BODY_CAM, np.array([0.05, 0.02, -0.01])).ravel().tolist()),
)
CALIBRATION = Calibration(camera=CAMERA, imu=NOISE)


def random_state(seed: int, landmarks: int = 3, sigma: float = 0.01) -> FilterState:
    rng = np.random.default_rng(seed)
    state = initial_state(
        0,
        so3_exp(rng.normal(size=3)),
        rng.normal(size=3),
        rng.normal(size=3) * 2,
        rng.normal(size=3) * 0.02,
        rng.normal(size=3) * 0.1,
        np.tril(rng.normal(size=(15, 15))) * sigma,
    )
    state = add_clone(state, 0)
    p = state.x + (state.R @ (rng.normal(size=(landmarks, 3)) * 0.5 + [4.0, 0.0, 0.0]).T).T
    n = state.size
    S = np.zeros((n + 3 * landmarks, state.S.shape[1] + 3 * landmarks))
    S[:n, : state.S.shape[1]] = state.S
    S[n:] = rng.normal(size=(3 * landmarks, S.shape[1])) * sigma
    fields = {f: getattr(state, f) for f in state.__dataclass_fields__}
    return FilterState(**{**fields, "S": S, "landmark_id": np.arange(landmarks), "landmark_p": p})


def imu_segment(seed: int, steps: int = 10) -> ImuSegment:
    rng = np.random.default_rng(seed)
    return ImuSegment(
        dt_s=np.full(steps, 0.005),
        gyro=rng.normal(size=(steps, 3)) * 0.8,
        accel=rng.normal(size=(steps, 3)) * 2.0 + [0, 0, 9.81],
        end_t_ns=50_000_000,
        end_gyro=np.zeros(3),
        noise_scale=np.ones((steps, 6)),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_difference_inverts_retract(kind: ErrorKind) -> None:
    rng = np.random.default_rng(0)
    R, X = so3_exp(rng.normal(size=3)), rng.normal(size=(4, 3))
    phi, xi = rng.normal(size=(6, 3)) * 0.7, rng.normal(size=(6, 4, 3))
    back_phi, back_xi = difference_group(kind, R, X, *retract_group(kind, R, X, phi, xi))
    assert np.allclose(back_phi, phi) and np.allclose(back_xi, xi)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("use_sigma_points", [True, False])
def test_propagated_covariance_is_that_of_moved_samples(kind: ErrorKind, use_sigma_points: bool) -> None:
    """Columns of S, walked through the true dynamics one by one, must come out as P says (noise off)."""
    if kind is not ErrorKind.RIGHT and not use_sigma_points:
        pytest.skip("the analytic Jacobian exists for the right-invariant error only")
    state = random_state(3, sigma=1e-4)
    imu = imu_segment(4)
    silent = ImuNoise(gyro_density=1e-12, accel_density=1e-12, gyro_walk=1e-12, accel_walk=1e-12, rate_hz=200.0)
    config = PropagationConfig(kind, use_sigma_points, 1.0, 9.81)
    end = propagate(state, imu, silent, config)
    columns = []
    for column in state.S.T:
        moved = propagate(retract(kind, state, column), imu, silent, config)
        phi, xi = difference_group(kind, end.R, end.X, moved.R, moved.X)
        bias = np.concatenate([moved.bias_gyro - end.bias_gyro, moved.bias_accel - end.bias_accel])
        clone = column[15:21]
        columns.append(np.concatenate([bias, phi, xi[0], xi[1], clone, xi[2:].ravel()]))
    expected = np.array(columns).T @ np.array(columns)
    scale = np.sqrt(np.diag(expected))
    # The analytic bias Jacobian treats the bias' effect within a step to first order in the step.
    tolerance = 2e-3 if use_sigma_points else 2e-2
    assert np.allclose(end.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=tolerance)


def test_six_sigma_columns_suffice_for_the_right_invariant_error() -> None:
    """Log-linear property: without bias uncertainty the group error, large as it is, propagates exactly linearly."""
    state = random_state(5, sigma=0.0)
    rng = np.random.default_rng(1)
    imu = imu_segment(6)
    config = PropagationConfig(ErrorKind.RIGHT, True, 1.0, 9.81)
    dx = np.zeros(state.size)
    dx[6:15] = rng.normal(size=9)  # about a radian and a metre
    S = np.zeros_like(state.S)
    S[:, 10] = dx
    fields = {f: getattr(state, f) for f in state.__dataclass_fields__}
    silent = ImuNoise(gyro_density=1e-12, accel_density=1e-12, gyro_walk=1e-12, accel_walk=1e-12, rate_hz=200.0)
    end = propagate(FilterState(**{**fields, "S": S}), imu, silent, config)
    moved = propagate(retract(ErrorKind.RIGHT, state, dx), imu, silent, config)
    phi, xi = difference_group(ErrorKind.RIGHT, end.R, end.X, moved.R, moved.X)
    truth = np.concatenate([phi, xi[0], xi[1]])
    assert np.allclose(end.covariance[6:15, 6:15], np.outer(truth, truth), atol=1e-9)


def test_noise_covariance_agrees_with_monte_carlo() -> None:
    loud = ImuNoise(gyro_density=2e-2, accel_density=5e-2, gyro_walk=1e-9, accel_walk=1e-9, rate_hz=200.0)
    state = random_state(7, landmarks=2, sigma=0.0)
    imu = imu_segment(8)
    rng = np.random.default_rng(9)
    for kind in KINDS:
        config = PropagationConfig(kind, True, 1.0, 9.81)
        end = propagate(state, imu, loud, config)
        samples = []
        for _ in range(400):
            noisy = ImuSegment(
                imu.dt_s,
                imu.gyro + rng.normal(size=imu.gyro.shape) * loud.gyro_density / np.sqrt(0.005),
                imu.accel + rng.normal(size=imu.gyro.shape) * loud.accel_density / np.sqrt(0.005),
                imu.end_t_ns,
                imu.end_gyro,
                imu.noise_scale,
            )
            other = propagate(state, noisy, loud, config)
            phi, xi = difference_group(kind, end.R, end.X, other.R, other.X)
            samples.append(np.concatenate([phi, xi.ravel()]))
        found = np.sqrt(np.mean(np.square(samples), axis=0))
        rows = np.r_[6:15, state.first_landmark_row : state.size]
        predicted = np.sqrt(np.diag(end.covariance))[rows]
        assert np.allclose(found, predicted, rtol=0.2, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_camera_jacobians_are_finite_differences(kind: ErrorKind) -> None:
    camera = CameraModel.of(CAMERA, 1.0)
    state = random_state(11)
    p = state.landmark_p
    xy, _, _ = normalised_points(camera, state.R, state.x, p)
    W = np.broadcast_to(np.eye(2), (len(p), 2, 2))
    fit = linearise(camera, kind, state.R, state.x, p, xy, W)
    h = 1e-6
    for column in range(9):
        values = []
        for sign in (1.0, -1.0):
            d = np.zeros(9)
            d[column] = sign * h
            X = np.stack([np.broadcast_to(state.x, p.shape), p], axis=1)
            R, X = retract_group(
                kind, state.R, X, np.broadcast_to(d[:3], p.shape), np.tile(d[3:].reshape(2, 3), (3, 1, 1))
            )
            values.append(normalised_points(camera, R, X[:, 0], X[:, 1])[0])
        assert np.allclose(fit.H[..., column], (values[0] - values[1]) / (2 * h), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_clone_jacobian_is_the_finite_difference(kind: ErrorKind) -> None:
    rng = np.random.default_rng(2)
    R, x, p = so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3) * 3
    J = pose_jacobian(kind, R, x, p)
    h = 1e-6
    for column in range(6):
        d = np.eye(6)[column] * h
        a = retract_group(kind, R, x[None], d[:3], d[None, 3:])
        b = retract_group(kind, R, x[None], -d[:3], -d[None, 3:])
        difference = (a[0].T @ (p - a[1][0]) - b[0].T @ (p - b[1][0])) / (2 * h)
        assert np.allclose(J[:, column], difference, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_small_sigma_points_give_the_jacobian(kind: ErrorKind) -> None:
    camera = CameraModel.of(CAMERA, 1.0)
    state = random_state(12)
    p = state.landmark_p
    xy = normalised_points(camera, state.R, state.x, p)[0] + 0.001
    W = camera.lens.whitening(xy, 1.0)
    L = np.tile(np.tril(np.random.default_rng(1).normal(size=(9, 9)) + 2 * np.eye(9)) * 1e-5, (len(p), 1, 1))
    exact = linearise(camera, kind, state.R, state.x, p, xy, W)
    found = regress(camera, kind, state.R, state.x, p, xy, W, L, 1.0)
    assert np.allclose(found.H, exact.H, rtol=1e-4, atol=1e-2)
    assert np.allclose(found.residual, exact.residual, atol=1e-6)
    assert np.abs(found.extra).max() < 1e-6


def test_update_is_the_kalman_update() -> None:
    state = random_state(13)
    rng = np.random.default_rng(3)
    H = rng.normal(size=(7, state.size))
    r = rng.normal(size=7) * 1e-3
    P = state.covariance
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(7))
    after = update(state, ErrorKind.RIGHT, Measurements(r, H @ state.S))
    assert np.allclose(after.covariance, P - K @ H @ P, atol=1e-12)
    assert np.allclose(after.bias_gyro - state.bias_gyro, (K @ r)[:3], atol=1e-12)


def test_clone_and_marginalisation_keep_the_rest() -> None:
    state = random_state(14)
    P = state.covariance
    cloned = add_clone(state, 5)
    C = cloned.covariance
    new = cloned.clone_rows(1)
    core = np.r_[PHI, XI_X]
    assert np.allclose(C[new, new], P[np.ix_(core, core)])
    assert np.allclose(remove_clone(cloned, 1).covariance, P)
    fewer = keep_landmarks(state, np.array([True, False, True]))
    rows = np.r_[0 : state.first_landmark_row, state.landmark_rows(0), state.landmark_rows(2)]
    assert np.allclose(fewer.covariance, P[np.ix_(rows, rows)])


@pytest.mark.parametrize("kind", KINDS)
def test_body_velocity_row_is_the_finite_difference(kind: ErrorKind) -> None:
    state = random_state(15)
    constraint = BodyVelocity(np.zeros(3), np.ones(3))
    A = constraint.rows(state, kind).A
    h = 1e-6
    for column in range(state.S.shape[1]):
        a, b = (retract(kind, state, sign * h * state.S[:, column]) for sign in (1.0, -1.0))
        assert np.allclose(A[:, column], (a.R.T @ a.v - b.R.T @ b.v) / (2 * h), atol=1e-6)


def test_wheels_are_believed_less_while_they_follow_a_new_command() -> None:
    config, constants = WheelConfig(), np.array([0.96, 0.02])
    steady = wheel_velocity(config, constants, 0.0, Rolled(0.4, 0.0))
    changing = wheel_velocity(config, constants, 0.0, Rolled(0.2, 0.2))
    assert steady is not None and changing is not None
    assert steady.sigma[0] == pytest.approx(config.sigma_speed_m_s + config.sigma_speed_share * 0.4)
    assert changing.v_body[0] == pytest.approx(0.96 * 0.2)
    assert changing.sigma[0] > config.sigma_lag_share * 0.2
    unknown = wheel_velocity(config, constants, 0.0, None)
    assert unknown is not None and np.isinf(unknown.sigma[0])


def test_ways_of_all_frames_join_to_the_arc_and_are_as_sure_as_so_many_velocities() -> None:
    speed, rate, dt, frames, offset = 0.4, 0.8, 0.07, 12, 0.03
    steps = np.full(14, dt / 14)
    readings = ImuSegment(
        steps, np.tile([0.0, 0.0, rate], (14, 1)), np.zeros((14, 3)), 0, np.zeros(3), np.ones((14, 6))
    )
    wheels = wheel_velocity(WheelConfig(), np.array([1.0, offset]), rate, Rolled(speed, 0.0))
    link = preintegrate(readings, np.zeros(6), NOISE)
    one = with_way(link, speed * dt, wheels, 15.0)
    assert one is not None and wheels is not None
    whole = one
    for _ in range(frames - 1):
        whole = chain(whole, one)
    assert whole.rolled is not None
    turned, radius = rate * dt * frames, speed / rate
    arc = radius * np.array([np.sin(turned), 1.0 - np.cos(turned), 0.0])
    aside = offset * np.array([np.cos(turned) - 1.0, np.sin(turned), 0.0])  # of the turning centre
    assert np.allclose(whole.rolled.by_constants @ [1.0, offset], arc + aside, atol=2e-4)
    assert np.trace(whole.rolled.covariance) == pytest.approx(frames * float(((wheels.sigma * dt) ** 2).sum()))
    blocked = wheel_velocity(WheelConfig(), np.array([1.0, offset]), rate, None)
    anything = with_way(link, speed * dt, blocked, 15.0)
    assert anything is not None and anything.rolled is not None
    assert np.linalg.eigvalsh(anything.rolled.covariance)[-1] == pytest.approx((15.0 * dt) ** 2)
    assert with_way(link, None, wheels, 15.0) is link  # in somebody's hands


@pytest.mark.parametrize("kind", KINDS)
def test_wheel_velocity_row_is_the_finite_difference(kind: ErrorKind) -> None:
    config = WheelConfig()
    state = add_wheels(random_state(17), np.array([0.9, 0.03]), np.array([0.1, 0.05]))
    constraint = wheel_velocity(config, state.wheels, 0.6, Rolled(0.4, 0.0))
    assert constraint is not None
    rows = replace(constraint, sigma=np.ones(3), gate=np.inf).rows(state, kind)
    h = 1e-6

    def missing(s: FilterState) -> FloatArray:
        """What the wheels say of the velocity and the state does not."""
        return np.array([s.wheels[0] * 0.4, s.wheels[1] * 0.6, 0.0]) - s.R.T @ s.v

    assert np.allclose(rows.r, missing(state))
    for column in range(state.S.shape[1]):
        a, b = (retract(kind, state, sign * h * state.S[:, column]) for sign in (1.0, -1.0))
        assert np.allclose(rows.A[:, column], (missing(b) - missing(a)) / (2 * h), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_same_place_rows_are_finite_differences(kind: ErrorKind) -> None:
    state = add_clone(random_state(16), 99)
    constraint = SamePlace(0, state.clone_R[0].T @ state.R, 1.0, 1.0)
    h = 1e-4

    def value(s: FilterState) -> FloatArray:
        turned = so3_log(s.clone_R[0].T @ s.clone_R[-1] @ (state.clone_R[0].T @ state.R).T)
        return np.concatenate([turned, s.clone_x[-1] - s.clone_x[0]])

    state = retract(kind, state, np.random.default_rng(0).normal(size=state.size) * 1e-3)  # clone and pose differ
    A = constraint.rows(state, kind).A
    for column in range(state.S.shape[1]):
        a, b = (retract(kind, state, sign * h * state.S[:, column]) for sign in (1.0, -1.0))
        assert np.allclose(A[:, column], (value(a) - value(b)) / (2 * h), atol=1e-4)


def test_triangulation_recovers_points_and_their_spread() -> None:
    camera = CameraModel.of(CAMERA, 1.0)
    rng = np.random.default_rng(4)
    p = np.column_stack([rng.uniform(3, 8, 200), rng.uniform(-2, 2, 200), rng.uniform(-1, 1, 200)])
    x = np.array([[0.0, 0.3 * k, 0.05 * k] for k in range(6)])
    R = so3_exp(rng.normal(size=(6, 3)) * 0.05)
    xy = np.stack([normalised_points(camera, R[k], x[k], p)[0] for k in range(6)], axis=1)
    uv = camera.lens.project(xy) + rng.normal(size=xy.shape)
    seen = np.ones((200, 6), dtype=bool)
    R_all, x_all = np.broadcast_to(R, (200, 6, 3, 3)), np.broadcast_to(x, (200, 6, 3))
    exact = triangulate(camera, R_all, x_all, xy, seen)
    assert np.allclose(exact.p, p, atol=1e-4) and exact.is_good.all()
    noisy = triangulate(camera, R_all, x_all, camera.lens.unproject(uv), seen)
    error = noisy.p - p
    d2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(noisy.cov), error)
    assert 1.9 < np.median(d2) < 2.9  # chi-square with three degrees: 2.37, of 200 samples: +- 0.2
    assert (d2 < chi2.ppf(0.95, 3)).mean() > 0.88


def consistency(kind: ErrorKind, seed: int, use_sigma_points: bool = True) -> tuple[FloatArray, float, float]:
    """NEES (6 degrees) per frame, NIS per degree, final position error of a synthetic run."""
    config = FilterConfig(error=kind, use_sigma_points=use_sigma_points, num_clones=10)
    imu, truth = sine_path(CALIBRATION, seed, 5.0)
    frames = observe(CALIBRATION, truth, room_points(truth.x_world, seed), 1.0, seed, num_features=60)
    buffer = ImuBuffer(NOISE)
    buffer.add(imu)
    rng = np.random.default_rng(seed + 1000)
    sd = np.array([0.005] * 3 + [0.05] * 3 + [0.01, 0.01, 1e-4] + [0.05] * 3 + [1e-4] * 3)
    state = initial_state(
        int(truth.t_ns[0]),
        truth.R_world_body[0],
        truth.v_world[0],
        truth.x_world[0],
        truth.bias_gyro[0],
        truth.bias_accel[0],
        np.diag(sd),
    )
    vio = VioFilter(CALIBRATION, config, retract(kind, state, -sd * rng.normal(size=15)))
    nees, nis, dof = [], 0.0, 0
    for k, frame in enumerate(frames):
        result = vio.process_frame(buffer.segment(vio.state.t_imu_ns, int(truth.t_ns[k])), frame, k)
        nis, dof = nis + result.nis, dof + result.nis_dof
        s = vio.state
        phi, xi = difference_group(kind, s.R, s.x[None], truth.R_world_body[k], truth.x_world[k][None])
        error = np.concatenate([phi, xi[0]])
        rows = np.r_[PHI, XI_X]
        nees.append(error @ np.linalg.solve(s.covariance[np.ix_(rows, rows)], error))
    return np.array(nees), nis / dof, float(np.linalg.norm(vio.state.x - truth.x_world[-1]))


@pytest.mark.parametrize(
    ("kind", "use_sigma_points"),
    [(ErrorKind.RIGHT, True), (ErrorKind.RIGHT, False), (ErrorKind.LEFT, True), (ErrorKind.PLAIN, True)],
)
def test_filter_is_accurate_and_knows_how_accurate(kind: ErrorKind, use_sigma_points: bool) -> None:
    runs = [consistency(kind, seed, use_sigma_points) for seed in range(1)]
    assert max(error for _, _, error in runs) < 0.10
    for nees, nis, _ in runs:
        assert 0.85 < nis < 1.15
        assert np.median(nees) < chi2.ppf(0.99, 6)


def test_landmark_gate_throws_out_a_wrong_match() -> None:
    imu, truth = sine_path(CALIBRATION, 3, 2.0)
    frames = observe(CALIBRATION, truth, room_points(truth.x_world, 3), 0.5, 3, num_features=80)
    buffer = ImuBuffer(NOISE)
    buffer.add(imu)
    state = initial_state(
        0, truth.R_world_body[0], truth.v_world[0], truth.x_world[0], truth.bias_gyro[0], truth.bias_accel[0],
        np.eye(15) * 1e-3,
    )  # fmt: skip
    vio = VioFilter(CALIBRATION, FilterConfig(), state)
    for k, frame in enumerate(frames[:-1]):
        vio.process_frame(buffer.segment(vio.state.t_imu_ns, int(truth.t_ns[k])), frame, k)
    assert vio.state.num_landmarks >= 5
    last = frames[-1]
    at = int(np.flatnonzero(np.isin(last.ids, vio.state.landmark_id))[0])
    last.xy[at] += 0.1
    end = propagate(
        vio.state,
        buffer.segment(vio.state.t_imu_ns, int(truth.t_ns[-1])),
        NOISE,
        PropagationConfig(ErrorKind.RIGHT, True, 1.0, 9.81),
    )
    end = add_clone(end, len(frames) - 1)
    measured = measure_landmarks(vio.camera, ErrorKind.RIGHT, end, last, Gate(0.99), 1.0, True, 1.5)
    wrong = int(np.flatnonzero(end.landmark_id == last.ids[at])[0])
    assert not measured.passed[measured.index == wrong].any()
    assert measured.passed.mean() > 0.7
