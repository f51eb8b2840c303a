"""The IMU belongs to the motion, and the motion respects walls."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.simulation.body import TICK_S, Body, CollisionBoxes, MotionState
from robot.simulation.config import BodyParameters, ImuImperfections, SimulationConfig, without_imperfections
from robot.simulation.sensors import ImuModel
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_IMU
from shared.geometry import FloatArray, so3_exp

GRAVITY = 9.81


def drive(body: Body, commands: list[tuple[float, float, float]]) -> list[MotionState]:
    """Motion under (seconds, m/s, rad/s) commands."""
    states = [body.state()]
    for seconds, linear, angular in commands:
        body.command(linear, angular)
        states += [body.step() for _ in range(round(seconds / TICK_S))]
    return states


def integrate(states: list[MotionState]) -> FloatArray:
    """Positions (N, 3) from noise-free samples alone, trapezoidal rule, starting from the true first state."""
    config = without_imperfections()
    imu = ImuModel(REFERENCE_IMU, config.imu, GRAVITY, 0)
    samples = [imu.measure(s) for s in states]
    R, v, p = states[0].R_world_body, states[0].v_world.copy(), states[0].p_world.copy()
    positions = [p.copy()]
    g = np.array([0.0, 0.0, GRAVITY])
    for before, after in pairwise(samples):
        R_next = R @ so3_exp(0.5 * (before.gyro_imu + after.gyro_imu) * TICK_S)
        a = 0.5 * (R @ before.accel_imu + R_next @ after.accel_imu) - g
        p = p + v * TICK_S + 0.5 * a * TICK_S**2
        v = v + a * TICK_S
        R = R_next
        positions.append(p.copy())
    return np.array(positions)


def test_noise_free_imu_integrates_to_the_true_path_within_millimetres_over_ten_seconds() -> None:
    body = Body(make_world("room", 1), BodyParameters(), (2.3, 2.2, 0.3), 5)
    states = drive(body, [(0.5, 0.0, 0.0), (4.0, 0.2, 1.6), (3.0, 0.1, -2.0), (2.5, -0.15, 0.5)])
    true = np.array([s.p_world for s in states])
    error = np.linalg.norm(integrate(states) - true, axis=1)
    assert np.linalg.norm(np.diff(true, axis=0), axis=1).sum() > 1.0
    assert error.max() < 3e-3


def test_imu_of_a_hijack_integrates_to_the_new_place() -> None:
    body = Body(make_world("room", 1), BodyParameters(), (2.3, 2.2, 0.3), 5)
    states = drive(body, [(1.5, 0.4, 1.0)])  # also out of full speed
    duration = body.hijack(3.0, 1.6, 2.5)
    states += drive(body, [(duration + 0.3, 0.0, 0.0)])[1:]
    assert max(s.p_world[2] for s in states) > 0.5
    assert max(s.carried for s in states) == 1.0 and states[-1].carried == 0.0
    assert states[-1].p_world[:2] == pytest.approx([3.0, 1.6], abs=1e-9)
    assert np.linalg.norm(integrate(states)[-1] - states[-1].p_world) < 0.02


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 3),
    moves=st.lists(st.tuples(st.floats(0.5, 3.0), st.floats(-0.6, 0.6), st.floats(-3.0, 3.0)), min_size=1, max_size=5),
)
def test_robot_never_enters_anything_solid(seed: int, moves: list[tuple[float, float, float]]) -> None:
    world = make_world("room", seed)
    parameters = BodyParameters()
    boxes = CollisionBoxes(world)
    x, y = world.rooms[0].centre
    push = boxes.push_out(x, y, parameters.radius_m)
    start = (x, y, 0.0) if push is None else (x + push[0], y + push[1], 0.0)
    states = drive(Body(world, parameters, start, seed), moves)
    clearance = boxes.clearance(np.array([s.p_world[:2] for s in states]))
    assert clearance.min() > parameters.radius_m - 0.005


def test_a_wall_stops_the_robot_and_the_accelerometer_feels_it() -> None:
    world = make_world("checker", 0)
    body = Body(world, BodyParameters(slip=False, wobble=False), (3.3, 3.3, 0.0), 0)
    states = drive(body, [(3.0, 0.5, 0.0)])
    assert states[-1].p_world[0] == pytest.approx(4.0 - 0.21, abs=0.01)
    assert min(s.a_world[0] for s in states) < -5.0
    assert abs(states[-1].v_world[0]) < 0.1


@pytest.mark.parametrize("speed", [0.2, 0.3, 0.5])
def test_a_wall_does_not_throw_the_robot_back(speed: float) -> None:
    body = Body(make_world("checker", 0), BodyParameters(slip=False, wobble=False), (3.3, 3.3, 0.0), 0)
    states = drive(body, [(9.0, speed, 0.0)])
    assert min(s.v_world[0] for s in states) > -0.01
    assert max(s.v_world[0] for s in states) < 1.1 * speed


def test_slip_turns_less_than_commanded_as_measured_on_a_real_robot() -> None:
    rates = []
    for seed in range(10):
        body = Body(make_world("room", 1), BodyParameters(), (2.3, 2.2, 0.0), seed)
        rates.append(drive(body, [(2.0, 0.0, 2.0)])[-1].omega_body[2])
    assert min(rates) > 0.35 and max(rates) < 0.95


def test_motors_stop_within_the_lag_of_the_platform() -> None:
    body = Body(make_world("room", 1), BodyParameters(), (2.3, 2.2, 0.0), 0)
    drive(body, [(1.0, 0.4, 0.0)])
    assert np.hypot(*drive(body, [(0.6, 0.0, 0.0)])[-1].v_world[:2]) < 0.01


def still() -> MotionState:
    zero = np.zeros(3)
    return MotionState(0.0, zero, np.eye(3), zero, zero, zero)


def test_imu_at_rest_shows_gravity_upwards_with_the_density_of_the_data_sheet() -> None:
    imu = ImuModel(REFERENCE_IMU, ImuImperfections(bias=False, bias_walk=False), GRAVITY, 3)
    samples = [imu.measure(still()) for _ in range(4000)]
    gyro, accel = np.array([s.gyro_imu for s in samples]), np.array([s.accel_imu for s in samples])
    assert accel.mean(0) == pytest.approx([0.0, 0.0, GRAVITY], abs=0.005)
    assert gyro.std() == pytest.approx(REFERENCE_IMU.gyro_density * np.sqrt(225), rel=0.05)
    assert accel.std(0) == pytest.approx(REFERENCE_IMU.accel_density * np.sqrt(225), rel=0.06)


@pytest.mark.parametrize("switch", ["noise", "bias", "bias_walk", "vibration"])
def test_each_imperfection_of_the_imu_has_a_switch(switch: str) -> None:
    config = SimulationConfig()
    moving = MotionState(0.0, np.zeros(3), np.eye(3), np.array([0.4, 0.0, 0.0]), np.zeros(3), np.zeros(3))

    def samples(on: bool) -> FloatArray:
        names = ("noise", "bias", "bias_walk", "vibration")
        imperfections = ImuImperfections(**{n: on and n == switch for n in names})
        imu = ImuModel(REFERENCE_IMU, imperfections, GRAVITY, 3)
        return np.array([imu.measure(moving).accel_imu for _ in range(50)])

    assert config.imu.noise  # on by default
    assert np.ptp(samples(on=False), axis=0).max() == 0.0
    assert np.abs(samples(on=True) - samples(on=False)).max() > 0.0


def test_readings_saturate_at_the_range() -> None:
    hit = MotionState(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.array([99.0, 0, 0]), np.array([0, 0, -50.0]))
    measured = ImuModel(REFERENCE_IMU, ImuImperfections(), GRAVITY, 0).measure(hit)
    assert measured.accel_imu[0] == REFERENCE_IMU.accel_range
    assert measured.gyro_imu[2] == -REFERENCE_IMU.gyro_range
