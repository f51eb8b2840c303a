"""A robot that drives to and fro before a board and turns on the spot, so that its wheels can be measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from robot.simulation.asl import START_NS, AslWriter
from robot.simulation.body import TICK_RATE_HZ, Body
from robot.simulation.calibration.board import Board, board_ahead
from robot.simulation.calibration.board_camera import BoardCamera
from robot.simulation.calibration.conduct import Conduct
from robot.simulation.calibration.sensors import motor_vibration, write_inertial
from robot.simulation.calibration.waving import R_WORLD_CAM_AHEAD, Motion
from robot.simulation.config import BodyParameters
from robot.simulation.sensors import REFERENCE_SPEED_M_S
from robot.simulation.world import Obstacle, World
from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse, se3, slerp

COMMAND_EVERY_TICKS = 15
SPEEDS_M_S, TURNS_RAD_S, TURN_S = (0.12, 0.2, 0.3), (0.8, -0.8, 1.6, -1.6, 1.2, -1.2), 4.0
FRAME_RATE_HZ = 5.0  # only those at rest matter
# Of a board of tags 6 cm wide: the nearest that the image holds, and how far away its tags are still read.
NEAR_M_PER_PX, WAY_M_PER_PX, MAX_WAY_M = 0.0007, 0.0014, 0.8

MARGIN_S = 0.2  # the IMU starts that long before the camera and ends that long after it
GOOD_FILL = 0.62

Command = tuple[float, float, float]  # seconds, m/s, rad/s


def draw_wheels(rng: np.random.Generator) -> BodyParameters:
    """Wheels on an even floor: what they make of a command, and how late."""
    return BodyParameters(
        lag_s=float(rng.uniform(0.05, 0.12)),
        yaw_efficiency=float(rng.uniform(0.35, 0.9)),
        yaw_efficiency_spread=0.0,
        yaw_waves=0.01,
        linear_efficiency=float(rng.uniform(0.85, 1.1)),
    )


def record_wheels(
    writer: AslWriter,
    board: Board,
    true: Calibration,
    conduct: Conduct,
    rng: np.random.Generator,
    on_progress: Callable[[float], None],
) -> dict[str, Any]:
    """Drive, and write what the robot senses; returns what is true of its wheels."""
    camera = true.camera
    assert camera is not None
    wheels = draw_wheels(rng)
    way_m = min(WAY_M_PER_PX * camera.fx, MAX_WAY_M)
    start_yaw = float(rng.uniform(-0.05, 0.05))
    body = Body(_floor(conduct, way_m), wheels, (0.0, 0.0, start_yaw), int(rng.integers(2**31)))
    first = body.state()
    T_world_cam = se3(first.R_world_body, first.p_world) @ camera.T_body_cam_matrix
    distance_m = (NEAR_M_PER_PX * camera.fx + way_m) * GOOD_FILL / conduct.fill
    T_world_board = se3(R_WORLD_CAM_AHEAD, T_world_cam[:3, 3]) @ board_ahead(board, distance_m)
    motion = _drive(body, conduct, way_m, writer)
    speed = np.hypot(*motion.v_world[:, :2].T) + 0.15 * np.abs(motion.omega_body[:, 2])
    shaking = motor_vibration(rng, len(speed)) * np.minimum(speed / REFERENCE_SPEED_M_S, 2.0)[:, None]
    biases = write_inertial(writer, motion, true, conduct.has_imu, rng, shaking)

    def pose(times: FloatArray) -> FloatArray:
        return np.asarray(inverse(T_world_board) @ _between(motion, times) @ camera.T_body_cam_matrix)

    shots = BoardCamera(board, camera, conduct.optics, rng)
    times = np.arange(MARGIN_S, motion.t_s[-1] - MARGIN_S, 1 / FRAME_RATE_HZ)
    for number, t_s in enumerate(times.tolist()):
        stamp_ns = START_NS + round((t_s - camera.time_shift_s) * 1e9)
        writer.add_frame(stamp_ns, shots.expose(pose, t_s), conduct.optics.exposure_s)
        on_progress((number + 1) / len(times))
    return {"wheels": msgspec.to_builtins(wheels), "T_world_board": T_world_board.tolist(), "way_m": way_m, **biases}


def on_wheels(true: Calibration) -> Calibration:
    """The sensors on the simulated body, which moves at ticks of its own."""
    assert true.camera is not None and true.imu is not None
    return msgspec.structs.replace(
        true,
        camera=msgspec.structs.replace(true.camera, rate_hz=FRAME_RATE_HZ),
        imu=msgspec.structs.replace(true.imu, rate_hz=TICK_RATE_HZ),
    )


def _floor(conduct: Conduct, way_m: float) -> World:
    """An empty one; or a box stands where half of the way forward is done."""
    box = Obstacle(way_m / 2 + 0.21 + 0.1, 0.0, 0.1, 0.5, 0.0, 0.05, "box", 0)
    return World("floor", 0, (), (), (), (box,) if conduct.is_blocked else (), (0.0, 0.0, 0.0))


def _plan(conduct: Conduct, way_m: float) -> list[Command]:
    """To and fro at several speeds, then turns to both sides; the robot rests before, between and after."""
    moves: list[Command] = []
    if conduct.drives:
        moves += [(way_m / speed, sign * speed, 0.0) for speed in SPEEDS_M_S for sign in (1, -1)]
    if conduct.turns:
        moves += [(TURN_S, 0.0, turn) for turn in TURNS_RAD_S]
    rest = (conduct.rest_s, 0.0, 0.0)
    return [rest, *(command for move in moves for command in (move, rest))]


def _drive(body: Body, conduct: Conduct, way_m: float, writer: AslWriter) -> Motion:
    """Let the body follow the plan and write its commands, repeated as over the network."""
    states = [body.state()]
    for seconds, linear, angular in _plan(conduct, way_m):
        body.command(linear, angular)
        for tick in range(round(seconds * TICK_RATE_HZ)):
            if states[-1].t_s >= conduct.seconds:
                break
            if tick % COMMAND_EVERY_TICKS == 0:
                writer.add_drive(START_NS + round(states[-1].t_s * 1e9), linear, angular, head=(0.0, 0.0))
            states.append(body.step())
    return Motion(
        t_s=np.array([s.t_s for s in states]),
        p_world=np.array([s.p_world for s in states]),
        R_world_body=np.array([s.R_world_body for s in states]),
        v_world=np.array([s.v_world for s in states]),
        a_world=np.array([s.a_world for s in states]),
        omega_body=np.array([s.omega_body for s in states]),
    )


def _between(motion: Motion, t_s: FloatArray) -> FloatArray:
    """T_world_body (N, 4, 4) at times (N,), evenly between two ticks."""
    place = np.clip(t_s * TICK_RATE_HZ, 0, len(motion.t_s) - 1.001)
    before = place.astype(int)
    share = place - before
    T = np.tile(np.eye(4), (len(t_s), 1, 1))
    T[:, :3, :3] = slerp(motion.R_world_body[before], motion.R_world_body[before + 1], share)
    T[:, :3, 3] = motion.p_world[before] + share[:, None] * (motion.p_world[before + 1] - motion.p_world[before])
    return T
