"""The camera's process: renders and encodes, so that drawing never delays inertial samples or the event loop."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import cast

import cv2

from robot.simulation.body import MotionState
from robot.simulation.calibration.overlay import HungBoard
from robot.simulation.config import Faults, SimulationConfig
from robot.simulation.construction import built_camera
from robot.simulation.depth import SimulatedDepth
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.trajectory import MotionHistory
from robot.simulation.worlds import make_world
from shared.errors import DeviceLost

READY_TIMEOUT_S = 120.0  # painting a large flat for the first time takes some seconds on a slow machine
RENDER_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class FrameRequest:
    t_s: float
    states: list[MotionState]  # the motion around the exposure
    faults: Faults
    covered: float
    hung: HungBoard | None  # a board that hangs in the world
    with_depth: bool = False  # measure depth too


class CameraProcess:
    """Handle of the rendering process; one request at a time."""

    def __init__(self, world: str, seed: int, config: SimulationConfig, cache_dir: Path | None) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, child = context.Pipe()
        job = (child, world, seed, config, cache_dir)
        self._process = context.Process(target=serve, args=job, name="simulated-camera", daemon=True)
        self._process.start()
        child.close()

    @property
    def pid(self) -> int | None:
        return self._process.pid

    def wait_until_ready(self) -> None:
        """Raises DeviceLost when the world cannot be drawn."""
        self._receive(READY_TIMEOUT_S)

    def take(self, request: FrameRequest) -> tuple[bytes, float, bytes]:
        """Render one picture: JPEG, exposure in s, depth as PNG (empty: not asked for).

        Raises DeviceLost when the process has died.
        """
        try:
            self._connection.send(request)
        except OSError as exc:
            raise DeviceLost("the simulated camera's process has ended; it is started again") from exc
        return cast(tuple[bytes, float, bytes], self._receive(RENDER_TIMEOUT_S))

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._connection.close()
        self._process.join(timeout=2.0)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(timeout=2.0)

    def _receive(self, timeout_s: float) -> object:
        try:
            if not self._connection.poll(timeout_s):
                raise DeviceLost(f"the simulated camera did not answer within {timeout_s:.0f} s")
            answer = self._connection.recv()
        except (OSError, EOFError) as exc:
            raise DeviceLost("the simulated camera's process has ended; it is started again") from exc
        if isinstance(answer, str):
            raise DeviceLost(f"the simulated camera failed: {answer}")
        return answer


READY = b"ready"


def serve(connection: Connection, world: str, seed: int, config: SimulationConfig, cache_dir: Path | None) -> None:
    """Body of the process: answer requests until the pipe closes."""
    for number in (signal.SIGINT, signal.SIGHUP):  # Ctrl-C and a closed terminal reach all; the parent ends us
        signal.signal(number, signal.SIG_IGN)
    cv2.setNumThreads(1)
    calibration = simulated_calibration(config)
    told, head = calibration.camera, calibration.head
    assert told is not None
    built = built_camera(told, config.build)
    try:
        renderer = Renderer(make_world(world, seed, config), built, cache_dir)
        camera = SimulatedCamera(renderer, built, config.camera, seed)
        sensor = calibration.depth_sensor
        depth = None if sensor is None else SimulatedDepth(sensor, built, config.depth, seed)
    except Exception as exc:  # whatever it is, the parent must hear of it instead of waiting
        connection.send(f"{type(exc).__name__}: {exc}")
        return
    with contextlib.suppress(OSError, EOFError):
        connection.send(READY)
        while True:
            request = cast(FrameRequest, connection.recv())
            path = MotionHistory(request.states)
            pose = partial(path.head_pose, head=head)
            exposure = camera.expose(pose, request.t_s, request.faults, request.covered, request.hung)
            measured = depth.measure(exposure.inverse_depth) if depth is not None and request.with_depth else b""
            connection.send((exposure.jpeg, exposure.exposure_s, measured))
