"""A robot that exists only in a simulated flat, in real time, behind the same ports as the real one."""

from __future__ import annotations

from pathlib import Path

from robot.devices.ports import DeviceSet
from robot.devices.simulated.control import ControlServer
from robot.devices.simulated.parts import (
    SimulatedBattery,
    SimulatedCameraPort,
    SimulatedDepthPort,
    SimulatedHijack,
    SimulatedImu,
    SimulatedMotors,
    SimulatedPanTilt,
)
from robot.devices.simulated.robot import SimulatedRobot
from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig


def open_simulated(
    world: str = "home",
    seed: int = 1,
    sim_port: int | None = None,
    config: SimulationConfig | None = None,
    cache_dir: Path | None = None,
) -> DeviceSet:
    """Start a simulated robot.

    Args:
        world: a name of robot.simulation.worlds.
        seed: which world of that kind; also seeds noise and slip.
        sim_port: loopback TCP port of the simulator's control (truth, faults, hijack); 0 takes a free one and logs it,
            None opens none. Tests, the demo's judge and the scripted driver use it, the station never.
    Raises:
        ConfigError: unknown world.
        DeviceUnavailable: the control port is taken.
    """
    robot = SimulatedRobot(world, seed, config or SimulationConfig(), cache_dir or default_cache_dir())
    control = ControlServer(robot, sim_port) if sim_port is not None else None
    robot.start(control)
    return DeviceSet(
        calibration=robot.calibration,
        camera=SimulatedCameraPort(robot),
        imu=SimulatedImu(robot),
        motors=SimulatedMotors(robot),
        depth=SimulatedDepthPort(robot) if robot.calibration.depth_sensor is not None else None,
        pan_tilt=SimulatedPanTilt(robot),
        battery=SimulatedBattery(robot),
        hijack=SimulatedHijack(robot),
    )


__all__ = ["SimulatedRobot", "open_simulated"]
