"""Drives a route without waiting for the clock and writes what the robot sensed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import msgspec

from robot.head import CameraHead
from robot.simulation.asl import START_NS, AslWriter
from robot.simulation.body import TICK_RATE_HZ, Body
from robot.simulation.config import SimulationConfig
from robot.simulation.construction import built_camera
from robot.simulation.depth import depth_calibration
from robot.simulation.driver import LookAround, RouteDriver
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.routes import Route
from robot.simulation.sensors import ImuModel
from robot.simulation.servos import Servos
from robot.simulation.trajectory import MotionHistory
from robot.simulation.world import World
from shared.calibration import REFERENCE_ROBOT, Calibration

COMMAND_EVERY_TICKS = 15  # 15 Hz, as over the network
REST_S = 1.5  # stands still before and after the drive
MAX_DRIVE_S = 600.0


@dataclass(frozen=True, slots=True)
class Recorded:
    frames: int
    duration_s: float
    path_m: float
    route_done: bool
    blocked_s: float
    rooms: tuple[str, ...]


def simulated_calibration(config: SimulationConfig, calibration: Calibration = REFERENCE_ROBOT) -> Calibration:
    """The calibration the robot tells: line delay 0 when the rolling shutter is switched off."""
    camera = calibration.camera
    assert camera is not None
    line_delay = camera.line_delay_s if config.camera.rolling_shutter else 0.0
    camera = msgspec.structs.replace(camera, rate_hz=config.camera_rate_hz, line_delay_s=line_delay)
    depth = depth_calibration(camera, config.depth) if config.depth.rate_hz > 0 else msgspec.UNSET
    return msgspec.structs.replace(calibration, camera=camera, depth=depth)


def record_drive(
    world: World,
    route: Route,
    config: SimulationConfig,
    drive_seed: int,
    out: Path,
    cache_dir: Path | None = None,
    on_progress: Callable[[float], None] | None = None,
    max_duration_s: float = MAX_DRIVE_S,
    start_yaw_rad: float | None = None,
    look_around: LookAround | None = None,
) -> Recorded:
    """Drive a route from its start and write an ASL folder. Times are the robot's clock from START_NS on.

    With start_yaw_rad the robot first stands in that direction, as somebody put it down. With look_around it turns its
    head from side to side as soon as it drives.
    """
    cv2.setNumThreads(1)
    calibration = simulated_calibration(config)
    told_camera, imu_noise = calibration.camera, calibration.imu
    assert told_camera is not None and imu_noise is not None
    built = built_camera(told_camera, config.build)
    yaw = route.start_yaw_rad if start_yaw_rad is None else start_yaw_rad
    body = Body(world, config.body, (*route.points[0], yaw), drive_seed)
    imu = ImuModel(imu_noise, config.imu, calibration.gravity, drive_seed)
    camera = SimulatedCamera(Renderer(world, built, cache_dir), built, config.camera, drive_seed)
    driver, history = RouteDriver(route), MotionHistory(keep_s=2.0)
    servos = Servos(config.servos, drive_seed)
    head = CameraHead(servos.point, calibration.head)
    view = partial(history.head_pose, head=calibration.head)
    readout_s = built.line_delay_s * built.height
    frame_period = 1.0 / config.camera_rate_hz
    next_frame_s, ticks, path_m, blocked, done_at = 0.1, 0, 0.0, 0, float("inf")
    rooms: list[str] = []
    state = body.state()
    with AslWriter(out, calibration) as writer:
        while state.t_s < min(done_at + REST_S, max_duration_s):
            history.append(state)
            t_ns = START_NS + round(state.t_s * 1e9)
            measurement = imu.measure(state)
            writer.add_imu(t_ns, measurement)
            writer.add_truth(t_ns, state, (measurement.gyro_bias, measurement.accel_bias))
            if state.t_s - next_frame_s > readout_s + 0.02:  # all poses the exposure needs are known
                exposure = camera.expose(view, next_frame_s, config.faults, history.carried(next_frame_s))
                stamp_ns = START_NS + round((next_frame_s - built.time_shift_s) * 1e9)
                writer.add_frame(stamp_ns, exposure.jpeg, exposure.exposure_s)
                next_frame_s += frame_period
                if on_progress:
                    on_progress(driver.progress)
            if ticks % COMMAND_EVERY_TICKS == 0 and state.t_s >= REST_S:
                command = driver.command(*body.pose, float(state.omega_body[2]))
                body.command(command.linear_m_s, command.angular_rad_s)
                if look_around is not None:
                    look_around.turn(head, t_ns)
                writer.add_drive(t_ns, command.linear_m_s, command.angular_rad_s, head.told(t_ns))
                if driver.is_done and done_at == float("inf"):
                    done_at = state.t_s
            before = body.pose
            head.lead(t_ns)
            state = replace(body.step(), head=servos.step())
            ticks += 1
            path_m += ((body.pose[0] - before[0]) ** 2 + (body.pose[1] - before[1]) ** 2) ** 0.5
            blocked += body.is_blocked
            room = world.room_at(*body.pose[:2])
            if room and room not in rooms:
                rooms.append(room)
        what = {"world": world.name, "seed": world.seed, "route": route.kind, "drive_seed": drive_seed}
        made = msgspec.json.encode({**what, "config": config})
        writer.add_file("config.json", msgspec.json.format(made).decode())
        return Recorded(writer.num_frames, state.t_s, path_m, driver.is_done, blocked / TICK_RATE_HZ, tuple(rooms))
