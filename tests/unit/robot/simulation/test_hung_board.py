"""A board in a simulated world is seen where it hangs, and hands wave the robot before it and put it back."""

import numpy as np
import pytest

from robot.simulation.body import TICK_S, Body
from robot.simulation.calibration.board import Board, board_ahead
from robot.simulation.calibration.overlay import HungBoard
from robot.simulation.calibration.waving import FADE_S, Wave, WavedRig
from robot.simulation.config import BodyParameters, Faults, without_imperfections
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.sensors import ImuModel
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA, REFERENCE_IMU
from shared.geometry import FloatArray, inverse, se3, transform, yaw_rotation
from station.calibration.target import Target
from tests.support.tags import detect_tags, project

BOARD = Board(6, 6, 0.034)
CORNERS = Target("aprilgrid", 6, 6, BOARD.tag_m, BOARD.gap_m).corners
TURN_RATE = 0.4  # rad/s


def turning(t_s: float) -> FloatArray:
    return se3(yaw_rotation(0.1 + TURN_RATE * t_s), np.array([1.9, 1.2, 1.1]))


def test_a_hung_board_is_seen_where_it_hangs_while_the_camera_turns() -> None:
    imperfections = without_imperfections().camera
    camera = REFERENCE_CAMERA
    simulated = SimulatedCamera(Renderer(make_world("checker", 0), camera), camera, imperfections, seed=0)
    shuttered = SimulatedCamera(
        Renderer(make_world("checker", 0), camera),
        camera,
        type(imperfections)(noise=0.0, auto_exposure=False, motion_blur=False),
        seed=0,
    )
    turned = np.array([0.3, -0.4, 0.1])
    T_world_board = turning(0.0) @ camera.T_body_cam_matrix @ board_ahead(BOARD, 0.9, (0.03, -0.02), turned)
    for takes, line_delay_s in ((simulated, 0.0), (shuttered, camera.line_delay_s)):
        image = takes.expose(turning, 0.0, Faults(), hung=HungBoard(BOARD, T_world_board)).image[:, :, 0]
        ids, seen = detect_tags(np.ascontiguousarray(image))
        assert len(ids) > 100
        expected = np.empty_like(seen)
        for i, (corner, (_, v)) in enumerate(zip(CORNERS[ids], seen, strict=True)):
            T_world_cam = turning(line_delay_s * float(v)) @ camera.T_body_cam_matrix
            expected[i] = project(camera, transform(inverse(T_world_cam) @ T_world_board, corner[None]))[0]
        assert np.abs((seen - expected).mean(axis=0)).max() < 0.05
        assert np.median(np.linalg.norm(seen - expected, axis=1)) < 0.2


def test_a_board_behind_the_camera_or_seen_from_behind_is_not_drawn() -> None:
    camera = REFERENCE_CAMERA
    simulated = SimulatedCamera(
        Renderer(make_world("checker", 0), camera), camera, without_imperfections().camera, seed=0
    )
    empty = simulated.expose(turning, 0.0, Faults()).image.copy()
    T_world_cam = turning(0.0) @ camera.T_body_cam_matrix
    for T_cam_board in (board_ahead(BOARD, -0.9), board_ahead(BOARD, 0.9, turned_rad=np.array([0.0, np.pi, 0.0]))):
        hung = HungBoard(BOARD, T_world_cam @ T_cam_board)
        np.testing.assert_array_equal(simulated.expose(turning, 0.0, Faults(), hung=hung).image, empty)


def waved_body(duration_s: float) -> Body:
    world = make_world("room", 1)
    body = Body(world, BodyParameters(), world.start, seed=0)
    state = body.state()
    T_body_cam = REFERENCE_CAMERA.T_body_cam_matrix
    T_world_cam = se3(state.R_world_body, state.p_world) @ T_body_cam
    rig = WavedRig(Wave(), 0.9, T_body_cam, np.random.default_rng(1), T_world_cam, duration_s)
    body.wave(rig, duration_s)
    return body


def test_a_waved_robot_leaves_the_floor_without_a_jolt_and_comes_back_to_its_place() -> None:
    body = waved_body(6.0)
    before = body.state()
    states = [body.step() for _ in range(round(7.0 / TICK_S))]
    steps = np.diff([before.p_world, *(s.p_world for s in states)], axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 2.0 * TICK_S  # m: no hand moves faster than 2 m/s
    accelerations = np.array([s.a_world for s in states])
    assert np.linalg.norm(np.diff(accelerations, axis=0), axis=1).max() < 1.0
    middle = states[round(3.0 / TICK_S)]
    assert np.linalg.norm(middle.omega_body) > 0.05
    assert not states[-1].is_waved
    np.testing.assert_allclose(states[-1].p_world, before.p_world, atol=1e-3)


def test_hands_do_not_shake_as_motors_do() -> None:
    body = waved_body(2 * FADE_S)
    imperfections = type(without_imperfections().imu)(noise=False, bias=False, bias_walk=False, saturation=False)
    imu = ImuModel(REFERENCE_IMU, imperfections, 9.81, seed=0)
    for _ in range(100):
        state = body.step()
        np.testing.assert_array_equal(imu.measure(state).gyro_imu, state.omega_body)


def test_a_robot_that_moves_is_not_waved() -> None:
    world = make_world("room", 1)
    body = Body(world, BodyParameters(), world.start, seed=0)
    body.command(0.3, 0.0)
    for _ in range(50):
        body.step()
    rig = WavedRig(Wave(), 0.9, np.eye(4), np.random.default_rng(1), duration_s=5.0)
    with pytest.raises(ValueError, match="rest"):
        body.wave(rig, 5.0)
