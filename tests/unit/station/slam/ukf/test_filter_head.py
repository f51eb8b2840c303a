"""The head in the filter: clones where the camera is, with the errors that body and servos give them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, REFERENCE_HEAD, Calibration, ImuNoise
from shared.geometry import FloatArray, inverse, se3, so3_exp
from station.motion.error_coordinates import ErrorKind, as_displacement, difference_group, from_displacement
from station.motion.head import NUM_ERRORS, PLAY, SIGMA_PLAY_RAD, HeadPose, errors_before_the_drive
from station.motion.imu_buffer import ImuBuffer
from station.slam.ukf.filter.config import FilterConfig
from station.slam.ukf.filter.filter import FrameResult, VioFilter
from station.slam.ukf.filter.head import ServosKnown, add_head_clone, turn_head
from station.slam.ukf.filter.state import FilterState, initial_state, retract
from tests.support.synthetic_run import observe, room_points, sine_path

KINDS = list(ErrorKind)
NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
LENS = msgspec.structs.replace(REFERENCE_CAMERA, fx=458.0, fy=457.0, line_delay_s=0.0, time_shift_s=0.0)
CALIBRATION = Calibration(camera=LENS, imu=NOISE, head=REFERENCE_HEAD)
RNG = np.random.default_rng(0)


def head_at(pan: float, tilt: float, change: float = 0.0) -> HeadPose:
    return HeadPose(REFERENCE_HEAD, np.array([pan, tilt]), np.array([0.7, -0.2]), np.full(2, change))


def turned_state(seed: int) -> FilterState:
    """A state whose head was turned, with errors of all kinds that hang together."""
    rng = np.random.default_rng(seed)
    state = initial_state(
        0, so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3), np.zeros(3), np.zeros(3),
        1e-3 * rng.normal(size=(15, 15)),
    )  # fmt: skip
    state = turn_head(state, head_at(0.5, 0.1), None)
    mixed = state.S + 1e-4 * rng.normal(size=state.S.shape)
    return replace(state, S=mixed, head=1e-2 * rng.normal(size=NUM_ERRORS), omega_body=np.array([0.1, -0.2, 0.5]))


@pytest.mark.parametrize("kind", KINDS)
def test_displacements_are_what_the_errors_do_to_the_pose(kind: ErrorKind) -> None:
    state = turned_state(1)
    phi, xi = 1e-6 * RNG.normal(size=(3, 1)), 1e-6 * RNG.normal(size=(3, 1))
    dx = np.zeros(state.size)
    dx[6:9], dx[12:15] = phi[:, 0], xi[:, 0]
    moved = retract(kind, state, dx)
    turn, shift = as_displacement(kind, state.R, state.x, phi, xi)
    np.testing.assert_allclose(shift[:, 0], moved.x - state.x, atol=1e-11)
    back = from_displacement(kind, state.R, state.x, turn, shift)
    np.testing.assert_allclose(back[0], phi, atol=1e-15)
    np.testing.assert_allclose(back[1], xi, atol=1e-15)


@pytest.mark.parametrize("kind", KINDS)
def test_a_clones_errors_are_the_finite_differences_of_where_the_head_is(kind: ErrorKind) -> None:
    state, head, h = turned_state(2), head_at(0.9, -0.2), 1e-3
    cloned = add_head_clone(kind, state, head, 7)
    rows = cloned.S[cloned.clone_rows(0)]
    for column in range(state.S.shape[1]):
        ends = []
        for sign in (1.0, -1.0):
            end = add_head_clone(kind, retract(kind, state, sign * h * state.S[:, column]), head, 7)
            phi, xi = difference_group(kind, cloned.clone_R[0], cloned.clone_x, end.clone_R[0], end.clone_x)
            ends.append(np.concatenate([phi, xi[0]]))
        np.testing.assert_allclose(rows[:, column], (ends[0] - ends[1]) / (2 * h), atol=1e-6)


def test_the_clone_is_the_head_and_moves_as_it_does() -> None:
    state, head, dt = turned_state(3), head_at(0.9, -0.2), 1e-5
    cloned = add_head_clone(ErrorKind.RIGHT, state, head, 7)
    off = head.by_errors @ state.head
    T = state.T_world_body @ head.T_body_head(off)
    np.testing.assert_allclose(se3(cloned.clone_R[0], cloned.clone_x[0]), T, atol=1e-12)
    turn = state.omega_body * dt
    later = replace(state, R=state.R @ so3_exp(turn), x=state.x + dt * state.v)
    moved = later.T_world_body @ head.T_body_head(off + dt * head.rates)
    step = inverse(T) @ moved
    np.testing.assert_allclose(cloned.clone_v[0], (moved[:3, 3] - T[:3, 3]) / dt, atol=1e-4)
    np.testing.assert_allclose(cloned.clone_omega[0], vee(step[:3, :3]) / dt, atol=1e-4)


def test_no_landmark_is_in_the_state_of_a_head_that_turned() -> None:
    fresh = initial_state(0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 1e-3 * np.eye(15))
    S = np.vstack([fresh.S, 1e-3 * RNG.normal(size=(6, fresh.S.shape[1]))])
    with_two = replace(fresh, landmark_id=np.arange(2), landmark_p=RNG.normal(size=(2, 3)), S=S)
    state = turn_head(with_two, head_at(0.5, 0.1), None)
    assert state.num_landmarks == 0
    np.testing.assert_allclose(state.covariance[:15, :15], fresh.covariance, atol=1e-15)
    assert state.size == 15 + NUM_ERRORS


def test_turning_changes_the_play_and_leaves_the_constants() -> None:
    state = turned_state(5)
    before = state.covariance[state.head_rows, state.head_rows]
    after = turn_head(state, head_at(0.6, 0.1, SIGMA_PLAY_RAD), None)
    P = after.covariance[after.head_rows, after.head_rows]
    np.testing.assert_allclose(P[2:, 2:], before[2:, 2:], atol=1e-15)
    np.testing.assert_allclose(P[PLAY, PLAY], SIGMA_PLAY_RAD**2 * np.eye(2), atol=1e-12)
    assert (after.head[PLAY] == 0).all() and (after.head[2:] == state.head[2:]).all()


def test_what_was_learned_is_known_after_tracking_was_lost() -> None:
    state = turned_state(6)
    known = ServosKnown.learned(state)
    fresh = initial_state(0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 1e-3 * np.eye(15))
    again = turn_head(fresh, head_at(0.5, 0.1), known)
    rows = state.head_rows
    np.testing.assert_allclose(again.covariance[again.head_rows, again.head_rows], state.covariance[rows, rows])
    assert (again.head == state.head).all()


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """What the filter made of a head that sweeps over a made-up room, frame by frame."""

    vio: VioFilter
    results: list[FrameResult]  # since it turns
    wrong: FloatArray  # (N,) rad, pan as estimated less the true one
    sigma: FloatArray  # (N,) rad, what the filter says of that
    x_end: FloatArray  # (3,) m, true


def sweep(
    calibration: Calibration, corners: dict[float, float], off: Callable[[HeadPose], float], num_points: int
) -> Sweep:
    """Pan (degrees) at the times (s) of `corners`; the servos are `off` by so much, rad, more than they are told."""
    times = list(corners)
    imu, truth = sine_path(calibration, 0, times[-1])
    t_s = (truth.t_ns - truth.t_ns[0]) * 1e-9
    pan = np.radians(np.interp(t_s, times, list(corners.values())))
    heads = [
        HeadPose(REFERENCE_HEAD, np.array([p, 0.0]), np.array([r, 0.0]), np.full(2, np.radians(0.08)))
        for p, r in zip(pan, np.gradient(pan, t_s), strict=True)
    ]
    true_off = np.array([off(head) for head in heads])
    T_body_head = np.array([h.T_body_head(np.array([e, 0.0])) for h, e in zip(heads, true_off, strict=True)])
    R, x = truth.R_world_body, truth.x_world
    x_head = x + np.einsum("nij,nj->ni", R, T_body_head[:, :3, 3])
    of_head = replace(truth, R_world_body=R @ T_body_head[:, :3, :3], x_world=x_head)
    frames = observe(calibration, of_head, room_points(x, 0, num_points), 1.0, 0, num_features=80)
    buffer = ImuBuffer(NOISE)
    buffer.add(imu)
    first = initial_state(
        0, R[0], truth.v_world[0], x[0], truth.bias_gyro[0], truth.bias_accel[0], 1e-3 * np.eye(15)
    )  # fmt: skip
    vio = VioFilter(calibration, FilterConfig(), first)
    results, wrong, sigma = [], [], []
    for k, frame in enumerate(frames):
        turned = t_s[k] > times[0]
        segment = buffer.segment(vio.state.t_imu_ns, int(truth.t_ns[k]))
        result = vio.process_frame(segment, frame, k, head=heads[k] if turned else None)
        if turned:
            state, by = vio.state, heads[k].by_errors
            results.append(result)
            wrong.append(float((by @ state.head)[0] - true_off[k]))
            sigma.append(float(np.linalg.norm((by @ state.S[state.head_rows])[0])))
    assert np.degrees(np.abs(true_off).max()) > 2.0  # else nothing was to be found
    return Sweep(vio, results, np.array(wrong), np.array(sigma), x[-1])


def test_the_filter_finds_the_servos_errors_and_knows_how_well() -> None:
    """The servos' errors are drawn from what is believed of them beforehand."""
    errors = errors_before_the_drive(REFERENCE_HEAD) @ np.random.default_rng(77).normal(size=NUM_ERRORS)
    errors[PLAY] = 0.0
    found = sweep(
        CALIBRATION, {0.5: 0.0, 2.0: 60.0, 5.0: -60.0, 8.0: 60.0}, lambda h: float((h.by_errors @ errors)[0]), 1200
    )
    later = slice(len(found.wrong) // 5, None)
    assert all(result.num_landmarks == 0 for result in found.results)
    assert np.degrees(np.sqrt(np.mean(found.wrong[later] ** 2))) < 0.5
    assert np.mean((found.wrong[later] / found.sigma[later]) ** 2) < 4.0
    assert np.linalg.norm(found.vio.state.x - found.x_end) < 0.1


def test_images_follow_servos_that_turn_further_than_they_were_told() -> None:
    """By up to 7 degrees within the 30 that a track is in view for: before the first turn nobody knows that."""
    camera = msgspec.structs.replace(REFERENCE_CAMERA, line_delay_s=0.0, time_shift_s=0.0)
    narrow = msgspec.structs.replace(CALIBRATION, camera=camera)
    found = sweep(
        narrow, {0.5: 0.0, 2.0: 60.0, 4.0: -20.0}, lambda h: np.radians(6.0) * np.sin(4.1 * float(h.angles[0])), 4000
    )
    tried = sum(r.num_window_tried + r.num_window_misfits for r in found.results)
    assert sum(r.num_window_used for r in found.results) > 0.8 * tried > 100
    assert np.mean((found.wrong / found.sigma) ** 2) < 4.0


def vee(R: FloatArray) -> FloatArray:
    return 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
