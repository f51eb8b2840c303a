"""Calibration recordings as a user would make them, with the truth beside them to judge by.

Each is an ASL folder whose sensor.yaml tells what the user believes, with `target.yaml`, the board as the user
measured it, and `truth.json`, which no estimator may read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from robot.simulation.asl import AslWriter
from robot.simulation.body import MotionState
from robot.simulation.calibration.board import Board
from robot.simulation.calibration.board_camera import BoardCamera, PoseAt
from robot.simulation.calibration.conduct import Conduct, Kind, conduct_of
from robot.simulation.calibration.sensors import (
    IMU_RATE_HZ,
    SimulatedInertial,
    believed_camera,
    draw_calibration,
    vibration,
)
from robot.simulation.calibration.waving import Motion, WavedRig
from robot.simulation.config import ImuImperfections
from robot.simulation.recording import START_NS
from robot.simulation.renderer import undistort
from shared.calibration import REFERENCE_IMU, Calibration, CameraCalibration
from shared.geometry import FloatArray, IntArray, homogeneous, inverse, se3, so3_exp

TAGS = 6  # a side: 36 tags
TAG_SIZES_M = (0.024, 0.034)  # that fill A4 and A3 across
STILL_EVERY_S = 1.0
FILL_FACTORS = (0.6, 1.5)  # nearest and farthest still, as factors of Conduct.fill
ROLL_DEG = 35.0  # of the board in stills
HAND_M_S, HAND_RAD_S = 0.01, 0.03  # standard deviations of what is still moving in a still
HURRIED_SHARE, HURRIED = 0.15, 8.0  # so many stills are taken while the board moves so much faster
WALL_TILT_RAD = 0.07  # the board hangs not quite upright
MARGIN_S = 0.2  # the IMU starts that long before the camera and ends that long after it
BLOCK = 100_000  # inertial samples at once
KNOCK_EVERY_S, KNOCK_S = 20.0, 0.2
KNOCK_RAD_S, KNOCK_M_S2 = 0.3, 2.0
SWAY_HZ = 0.05
# The camera sees the board as it is printed: x to the right, y up, z towards the camera.
R_CAM_BOARD_FACING = np.diag([1.0, -1.0, -1.0])
R_WORLD_BOARD_UPRIGHT = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

ProgressCall = Callable[[float], None]


@dataclass(frozen=True)
class Session:
    """What was recorded."""

    frames: int
    imu_samples: int
    truth: dict[str, Any]  # as in truth.json; under "calibration" a shared.calibration.Calibration


def record_session(
    kind: Kind,
    out: Path,
    seed: int,
    poor: str | None = None,
    seconds: float | None = None,
    motors: bool = False,
    on_progress: ProgressCall = lambda _share: None,
) -> Session:
    """Write one recording. Raises ConfigError for a `poor` that the kind does not have, DataError for `out`.

    Args:
        seed: another robot, another board, other motion, other noise.
        poor: what the user does wrong; None where nothing.
        seconds: how long; None: as long as users are told to.
        motors: they run while the IMU is recorded at rest.
    """
    cv2.setNumThreads(1)
    conduct = conduct_of(kind, poor, seconds)
    rng = np.random.default_rng([seed, 30])
    true = draw_calibration(rng)
    told = _believed(true, kind, conduct)
    truth: dict[str, Any] = {"kind": kind, "seed": seed, "poor": poor, "calibration": msgspec.to_builtins(true)}
    with AslWriter(out, told) as writer:
        if kind is Kind.IMU:
            truth |= _record_rest(writer, true, conduct, motors, rng, on_progress)
        else:
            board = Board(TAGS, TAGS, float(rng.choice(TAG_SIZES_M)))
            writer.add_file("target.yaml", board.yaml())
            board = replace(board, tag_m=board.tag_m * conduct.size_error)
            board = replace(board, bend_m=board.width_m * conduct.bend_share)
            record = _record_stills if kind is Kind.CAMERA else _record_wave
            truth |= {"board": asdict(board), **record(writer, board, true, conduct, rng, on_progress)}
        writer.add_file("truth.json", msgspec.json.format(msgspec.json.encode(truth)).decode())
        return Session(writer.num_frames, writer.num_imu, truth)


def _believed(true: Calibration, kind: Kind, conduct: Conduct) -> Calibration:
    """What sensor.yaml tells. Who joins camera and IMU has calibrated the camera before."""
    assert true.camera is not None
    noise = msgspec.structs.replace(REFERENCE_IMU, rate_hz=IMU_RATE_HZ)
    return Calibration(
        camera=None if kind is Kind.IMU else believed_camera(true.camera, knows_lens=kind is Kind.CAMERA_IMU),
        imu=None if kind is Kind.CAMERA or not conduct.has_imu else noise,
        rig="hand-held",
    )


# --- stills of a board ------------------------------------------------------------------------------------------------


def _record_stills(
    writer: AslWriter,
    board: Board,
    true: Calibration,
    conduct: Conduct,
    rng: np.random.Generator,
    on_progress: ProgressCall,
) -> dict[str, Any]:
    """A camera at rest, a picture a second of a board that a hand holds at many places."""
    camera = true.camera
    assert camera is not None
    shots = BoardCamera(board, camera, conduct.optics, rng)
    count = max(1, round(conduct.seconds / STILL_EVERY_S))
    for number in range(count):
        t_s = number * STILL_EVERY_S
        pose = _held(_still_pose(board, camera, conduct, rng), conduct.hand_speed, t_s, rng)
        writer.add_frame(START_NS + round(t_s * 1e9), shots.expose(pose, t_s), conduct.optics.exposure_s)
        on_progress((number + 1) / count)
    return {}


def _still_pose(board: Board, camera: CameraCalibration, conduct: Conduct, rng: np.random.Generator) -> FloatArray:
    """T_cam_board (4, 4): the board's centre anywhere in the image, turned about any axis."""
    fill = conduct.fill * rng.uniform(*FILL_FACTORS)
    distance = camera.fy * board.height_m / (camera.height * fill)
    half = np.array([camera.width, camera.height]) / 2
    aside_px = conduct.spread * rng.uniform(-1, 1, 2) * half * (1 - 0.5 * min(fill, 1.0))
    centre = undistort(camera, (aside_px + half - [camera.cx, camera.cy]) / [camera.fx, camera.fy])
    axis = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(conduct.tilt_deg) * np.sqrt(rng.uniform()) * np.array([np.cos(axis), np.sin(axis), 0.0])
    roll = np.radians(ROLL_DEG) * rng.uniform(-1, 1)
    R = so3_exp(tilt) @ so3_exp(np.array([0.0, 0.0, roll])) @ R_CAM_BOARD_FACING
    return se3(R, distance * homogeneous(centre) - R @ board.centre)


def _held(T_cam_board: FloatArray, hand_speed: float, t_s: float, rng: np.random.Generator) -> PoseAt:
    """The board near t_s, not quite still."""
    hurry = hand_speed * (HURRIED if rng.random() < HURRIED_SHARE else 1.0)
    v, w = hurry * HAND_M_S * rng.standard_normal(3), hurry * HAND_RAD_S * rng.standard_normal(3)

    def pose(times: FloatArray) -> FloatArray:
        after = (times - t_s)[:, None]
        T = np.tile(T_cam_board, (len(times), 1, 1))
        T[:, :3, :3] = T[:, :3, :3] @ so3_exp(w * after)
        T[:, :3, 3] += v * after
        return inverse(T)

    return pose


# --- camera and IMU waved before a board on the wall ------------------------------------------------------------------


def _record_wave(
    writer: AslWriter,
    board: Board,
    true: Calibration,
    conduct: Conduct,
    rng: np.random.Generator,
    on_progress: ProgressCall,
) -> dict[str, Any]:
    camera, noise = true.camera, true.imu
    assert camera is not None and noise is not None
    T_body_cam = camera.T_body_cam_matrix
    rig = WavedRig(conduct.wave, camera.fy * board.height_m / (camera.height * conduct.fill), T_body_cam, rng)
    R_world_board = so3_exp(rng.uniform(-WALL_TILT_RAD, WALL_TILT_RAD, 3)) @ R_WORLD_BOARD_UPRIGHT
    T_world_board = se3(R_world_board, -R_world_board @ board.centre)
    slip = np.array([0.0, 0.0, -conduct.slips_m])

    def pose(times: FloatArray) -> FloatArray:
        T_board_cam = inverse(T_world_board) @ rig.at(times).T_world_body @ T_body_cam
        T_board_cam[:, :3, 3] -= np.outer(times > conduct.seconds / 2, R_world_board.T @ slip)
        return T_board_cam

    biases = _write_imu(writer, rig.at(np.arange(0.0, conduct.seconds, 1 / noise.rate_hz)), true, conduct, rng)
    shots = BoardCamera(board, camera, conduct.optics, rng)
    times = np.arange(MARGIN_S, conduct.seconds - MARGIN_S, 1 / camera.rate_hz)
    for number, t_s in enumerate(times.tolist()):
        stamp_ns = START_NS + round((t_s - camera.time_shift_s) * 1e9)
        writer.add_frame(stamp_ns, shots.expose(pose, t_s), conduct.optics.exposure_s)
        on_progress((number + 1) / len(times))
    return {"T_world_board": T_world_board.tolist(), "slips_m": conduct.slips_m, **biases}


def _write_imu(
    writer: AslWriter, motion: Motion, true: Calibration, conduct: Conduct, rng: np.random.Generator
) -> dict[str, Any]:
    """Readings and true states; returns the mean biases for the truth."""
    assert true.imu is not None
    readings, biases = SimulatedInertial(true.imu, true.gravity, rng).read(motion)
    stamps = _stamps(motion.t_s)
    if conduct.has_imu:
        writer.add_imu_block(stamps, readings)
    for i, t_ns in enumerate(stamps.tolist()):
        state = MotionState(
            float(motion.t_s[i]),
            motion.p_world[i],
            motion.R_world_body[i],
            motion.v_world[i],
            motion.a_world[i],
            motion.omega_body[i],
        )
        writer.add_truth(t_ns, state, (biases[i, :3], biases[i, 3:]))
    return _mean_biases(biases.mean(axis=0))


# --- an IMU at rest ---------------------------------------------------------------------------------------------------


def _record_rest(
    writer: AslWriter,
    true: Calibration,
    conduct: Conduct,
    motors: bool,
    rng: np.random.Generator,
    on_progress: ProgressCall,
) -> dict[str, Any]:
    assert true.imu is not None
    inertial = SimulatedInertial(true.imu, true.gravity, rng)
    count = int(conduct.seconds * true.imu.rate_hz)
    lying = so3_exp(0.05 * rng.standard_normal(3))  # the table is not quite level
    total = np.zeros(6)
    for first in range(0, count, BLOCK):
        t_s = np.arange(first, min(first + BLOCK, count)) / true.imu.rate_hz
        disturbed = _at_rest(t_s, lying, true.gravity, conduct)
        if conduct.is_knocked:
            disturbed += _knocks(t_s, rng)
        if motors:
            disturbed += _vibration(len(t_s), rng)
        readings, biases = inertial.disturb(disturbed)
        writer.add_imu_block(_stamps(t_s), readings)
        total += biases.sum(axis=0)
        on_progress(min(first + BLOCK, count) / count)
    return {"motors": motors, **_mean_biases(total / count)}


def _at_rest(t_s: FloatArray, R_world_body: FloatArray, gravity: float, conduct: Conduct) -> FloatArray:
    """True rates and forces (N, 6) of an IMU that lies, or sways about its x axis in a hand."""
    swing = 2 * np.pi * SWAY_HZ
    rate = conduct.sway_rad_s * np.cos(swing * t_s)
    angle = conduct.sway_rad_s / swing * np.sin(swing * t_s)
    along_x = np.array([1.0, 0.0, 0.0])
    up_body = R_world_body.T @ np.array([0.0, 0.0, gravity])
    forces = so3_exp(-np.outer(angle, along_x)) @ up_body
    return np.concatenate([np.outer(rate, along_x), forces], axis=1)


def _knocks(t_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Somebody knocks against the table every now and then: (N, 6)."""
    is_knock = t_s % KNOCK_EVERY_S < KNOCK_S
    jolt = rng.standard_normal((len(t_s), 6)) * ([KNOCK_RAD_S] * 3 + [KNOCK_M_S2] * 3)
    return np.asarray(jolt * is_knock[:, None])


def _vibration(count: int, rng: np.random.Generator) -> FloatArray:
    """What motors and gears add: (count, 6)."""
    imu = ImuImperfections()
    strength = np.array([imu.gyro_vibration_rad_s] * 3 + [imu.accel_vibration_m_s2] * 3) * [1, 1, 1, 0.7, 0.7, 1.3]
    return strength * vibration(rng, count)


def _stamps(t_s: FloatArray) -> IntArray:
    return START_NS + np.rint(t_s * 1e9).astype(np.int64)


def _mean_biases(bias: FloatArray) -> dict[str, Any]:
    return {"gyro_bias": bias[:3].tolist(), "accel_bias": bias[3:].tolist()}
