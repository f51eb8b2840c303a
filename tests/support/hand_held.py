"""Recordings of a camera with an IMU that a hand waves in a room without any target, and calibrations that are wrong.

The dataset's own calibration is the truth; what an estimator is told instead is `knocked`.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import msgspec
import numpy as np

from robot.simulation.asl import START_NS, AslWriter
from robot.simulation.calibration.sensors import IMU_RATE_HZ, draw_calibration, write_inertial
from robot.simulation.calibration.waving import R_WORLD_CAM_AHEAD, Wave, WavedRig
from robot.simulation.config import SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.worlds import make_world
from shared.calibration import Calibration, CameraCalibration
from shared.geometry import FloatArray, se3, so3_exp, yaw_rotation

WORLDS = ("vicon", "room")
HEIGHT_M = 1.2
PIVOT_M = (0.8, 1.6)  # before the camera: the nearer, the less it moves
MARGIN_S = 0.2  # the IMU starts that long before the camera and ends that long after it
STREAM = 51


def record_hand_held(out: Path, seed: int, seconds: float = 15.0, wave: Wave | None = None) -> Calibration:
    """Another robot, room and motion for each seed, as an ASL folder; returns the true calibration."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, STREAM])
    true = draw_calibration(rng)
    assert true.camera is not None and true.imu is not None
    camera = true.camera
    true = msgspec.structs.replace(
        true, camera=camera, imu=msgspec.structs.replace(true.imu, rate_hz=IMU_RATE_HZ), rig="hand-held",
        robot_kind="generic", head=None,
    )  # fmt: skip
    world = make_world(WORLDS[seed % len(WORLDS)], seed)
    x, y, _ = world.start
    middle = se3(yaw_rotation(rng.uniform(-np.pi, np.pi)) @ R_WORLD_CAM_AHEAD, np.array([x, y, HEIGHT_M]))
    rig = WavedRig(wave or Wave(), float(rng.uniform(*PIVOT_M)), camera.T_body_cam_matrix, rng, middle)
    config = SimulationConfig()
    shots = SimulatedCamera(Renderer(world, camera), camera, config.camera, seed)

    def pose(t_s: float) -> FloatArray:
        return np.asarray(rig.at(np.array([t_s])).T_world_body[0])

    with AslWriter(out, true) as writer:
        write_inertial(writer, rig.at(np.arange(0.0, seconds, 1.0 / IMU_RATE_HZ)), true, True, rng)
        for t_s in np.arange(MARGIN_S, seconds - MARGIN_S, 1.0 / camera.rate_hz).tolist():
            exposure = shots.expose(pose, t_s, config.faults)
            writer.add_frame(START_NS + round((t_s - camera.time_shift_s) * 1e9), exposure.jpeg, exposure.exposure_s)
    return true


def knocked(
    true: CameraCalibration, seed: int, turned_deg: float = 5.0, moved_m: float = 0.03, shift_s: float = 0.015
) -> CameraCalibration:
    """As told after a knock in a direction of the seed's: turned, moved, and its clock off by so much."""
    rng = np.random.default_rng([seed, STREAM + 1])
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    T = true.T_body_cam_matrix @ se3(so3_exp(np.radians(turned_deg) * axis), np.zeros(3))
    T[:3, 3] += moved_m * way
    return msgspec.structs.replace(
        true,
        T_body_cam=tuple(T.ravel().tolist()),
        time_shift_s=true.time_shift_s + shift_s * float(rng.choice([-1.0, 1.0])),
    )
