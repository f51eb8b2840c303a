"""Wires robot-server: chooses the devices and runs the server. The only place that knows all adapters."""

from __future__ import annotations

import asyncio
import atexit
import functools
import importlib
import logging
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import msgspec

from robot.access import open_gate, pairing_sentence
from robot.announce import Announcement, announced_addresses, may_be_announced
from robot.config import RobotConfig
from robot.devices.ports import DeviceSet
from robot.own_calibration import OwnCalibration, calibration_folder, read_own
from robot.server import RobotServer
from robot.simulation.config import load_config as load_simulation
from robot.systemd import Systemd
from shared.advice import install
from shared.ending import ending_signals
from shared.errors import ConfigError, DeviceUnavailable
from shared.listening import bind, show_address
from shared.long_lived import keep_for_good

logger = logging.getLogger(__name__)

DeviceKind = Literal["simulated", "recorded", "pi"]
# What a page calls a robot that nobody named; one of flesh and wire goes by its host's name.
UNNAMED = {"simulated": "Simulated robot", "recorded": "Recorded robot"}
# Where packages come from.
EXTRA = {"simulated": "simulation", "emulated": "robot", "recorded": "simulation", "pi": "robot"}


def run(kind: DeviceKind, config: RobotConfig) -> None:
    """Serve until SIGINT, SIGTERM or SIGHUP. The port is taken first: a second one must not touch the devices."""
    listener = bind(config.server.host, config.server.port)
    with listener:
        gate = open_gate(config, listener.getsockname()[0])
        devices, systemd = open_devices(kind, config), Systemd.of(os.environ)
        is_replay, settings = kind == "recorded", named(kind, config)
        server = RobotServer(
            devices,
            settings,
            starts_with_first_station=is_replay,
            systemd=systemd,
            gate=gate,
            calibration=OwnCalibration(calibration_folder(kind, config), devices.calibration),
        )
        atexit.register(server.stop_motors)
        host, port = listener.getsockname()[:2]
        announcement = None
        if may_be_announced(host):
            announcement = Announcement(server.hello().robot_id, port, functools.partial(announced_addresses, host))
        print(f"robot-server: {kind} devices on {show_address(host, port)}", flush=True)
        if gate is not None and gate.is_unpaired:
            code = gate.desk.first_code(gate.now_s())
            print(f"robot-server: no station is paired yet; {pairing_sentence(code, host, port)}", flush=True)
        keep_for_good()
        try:
            with asyncio.Runner(loop_factory=_loop_factory()) as runner:
                runner.run(serve_until_signal(server, listener))
        finally:
            server.stop_motors()
            if announcement is not None:
                announcement.close()


def named(kind: DeviceKind, config: RobotConfig) -> RobotConfig:
    """The configuration with a name for people, where the file gives none and the host's says nothing of the robot."""
    identity = config.identity
    if identity.name or identity.id or kind not in UNNAMED:
        return config
    return msgspec.structs.replace(config, identity=msgspec.structs.replace(identity, name=UNNAMED[kind]))


def check(kind: DeviceKind, config: RobotConfig) -> bool:
    """Test each part in turn and print a sentence on each. True when all work."""
    from robot.check import check_devices, check_pi

    if kind == "pi":
        return check_pi(config.pi)
    return asyncio.run(check_devices(open_devices(kind, config)))


def open_devices(kind: DeviceKind, config: RobotConfig) -> DeviceSet:
    """The devices asked for; never others in their place. Imported only then: each kind needs other packages."""
    if kind == "simulated":
        simulated = config.simulated
        settings = load_simulation(Path(simulated.settings)) if simulated.settings else None
        place = (simulated.world, simulated.seed, simulated.sim_port)
        devices = _adapter("simulated", "open_simulated")(*place, config=settings)
        return _adapter("emulated", "open_emulated")(devices) if simulated.imu == "emulated" else devices
    if kind == "recorded":
        recorded = config.recorded
        if not recorded.dataset:
            raise ConfigError("--devices recorded needs --dataset DIR, the folder of a recorded drive")
        open_recorded = _adapter("recorded", "open_recorded")
        return open_recorded(Path(recorded.dataset), speed=recorded.speed, at_end=recorded.at_end)
    return _adapter("pi", "open_pi")(config.pi, read_own(calibration_folder(kind, config)))


def _adapter(kind: str, opener: str) -> Callable[..., DeviceSet]:
    try:
        module = importlib.import_module(f"robot.devices.{kind}")
    except ImportError as exc:
        raise DeviceUnavailable(
            f"--devices {kind} needs {exc.name}, which is not installed; run: {install(EXTRA[kind])}"
        ) from exc
    found: Callable[..., DeviceSet] = getattr(module, opener)
    return found


async def serve_until_signal(server: RobotServer, listener: socket.socket) -> None:
    """Run the server until SIGINT, SIGTERM or SIGHUP; the motors stop in the signal handler itself."""
    loop = asyncio.get_running_loop()
    serving = loop.create_task(server.serve(listener))

    def shut_down(name: str) -> None:
        server.stop_motors()
        logger.info("%s: shutting down", name)
        serving.cancel()

    for number in ending_signals():
        loop.add_signal_handler(number, shut_down, number.name)
    try:
        await serving
    except asyncio.CancelledError:
        if not serving.cancelled():
            raise


def _loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """uvloop where it is installed: half the CPU time per message."""
    try:
        import uvloop
    except ImportError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
