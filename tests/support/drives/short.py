"""A few seconds of a simulated robot's drive, as SLAM is given them; unless told otherwise among checkerboards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from robot.head import CameraHead
from robot.simulation.atlas import default_cache_dir
from robot.simulation.body import Body
from robot.simulation.config import SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.sensors import ImuModel
from robot.simulation.servos import Servos
from robot.simulation.trajectory import MotionHistory
from robot.simulation.worlds import make_world
from station.model.frames import DriveSample, ImageFrame, ImuBatch

FRAME_S = 1 / 12
CONFIG = SimulationConfig(camera_rate_hz=1 / FRAME_S)
CALIBRATION = simulated_calibration(CONFIG)
GO_S = 1.2  # it stands until then
COMMAND_TICKS = 15


@dataclass(frozen=True, slots=True)
class ShortDrive:
    end_s: float
    stop_s: float = np.inf  # stands from then on
    head_s: float = np.inf  # turns its head from then on
    no_images_s: tuple[float, float] = (np.inf, np.inf)
    spoilt_image: int = -1  # the index of one that cannot be decoded
    turn_rad_s: float = 0.6  # as told; on its four wheels it turns by some 40 % of that
    world: str = "checker"
    start: tuple[float, float, float] = (1.0, 1.2, 0.3)  # x, y, yaw


def drive(wanted: ShortDrive, seed: int = 1) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
    """An arc. Times begin at 1 s."""
    camera, noise = CALIBRATION.camera, CALIBRATION.imu
    assert camera is not None and noise is not None
    world = make_world(wanted.world, 0)
    body = Body(world, CONFIG.body, wanted.start, seed)
    imu = ImuModel(noise, CONFIG.imu, CALIBRATION.gravity, seed)
    eye = SimulatedCamera(Renderer(world, camera, default_cache_dir()), camera, CONFIG.camera, seed)
    servos = Servos(CONFIG.servos, seed)
    head = CameraHead(servos.point, CALIBRATION.head)
    history, state, next_frame_s, index, ticks = MotionHistory(keep_s=2.0), body.state(), 0.1, 0, 0
    view = partial(history.head_pose, head=CALIBRATION.head)
    while state.t_s < wanted.end_s:
        history.append(state)
        t_ns = 10**9 + round(state.t_s * 1e9)
        m = imu.measure(state)
        yield ImuBatch(np.array([t_ns]), m.gyro_imu[None], m.accel_imu[None])
        if state.t_s - next_frame_s > 0.05:
            if not wanted.no_images_s[0] < next_frame_s < wanted.no_images_s[1]:
                seen = eye.expose(view, next_frame_s, CONFIG.faults, history.carried(next_frame_s))
                stamp = 10**9 + round((next_frame_s - camera.time_shift_s) * 1e9)
                yield ImageFrame(index, stamp, 0, b"no image" if index == wanted.spoilt_image else seen.jpeg)
                index += 1
            next_frame_s += FRAME_S
        if ticks % COMMAND_TICKS == 0 and state.t_s > GO_S:
            speed, turn = (0.15, wanted.turn_rad_s) if state.t_s < wanted.stop_s else (0.0, 0.0)
            body.command(speed, turn)
            if state.t_s > wanted.head_s and not any(head.told(t_ns)):
                head.look(0.5, 0.0, t_ns)
            yield DriveSample(t_ns, speed, turn, *head.told(t_ns))
        head.lead(t_ns)
        state, ticks = replace(body.step(), head=servos.step()), ticks + 1
