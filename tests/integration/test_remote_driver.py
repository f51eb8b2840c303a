"""The scripted driver steers the simulated robot through a station's HTTP calls."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import robot.simulation.remote_driver as robot_remote_driver
from robot.devices.simulated import SimulatedRobot
from robot.devices.simulated.control import ControlServer
from robot.simulation.cli import app
from robot.simulation.config import SimulationConfig
from robot.simulation.remote_driver import drive_route
from shared.errors import ConfigError, DeviceLost


class Station:
    """The two calls of a station that the driver needs."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self.calls: list[tuple[str, str]] = []  # path, driver
        self.refusal = ""
        station = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                station.calls.append((self.path, self.headers["X-Driver"]))
                if not station.refusal:
                    until_ns = time.monotonic_ns() + body.get("ttl_ms", 0) * 1_000_000
                    robot.command(body.get("linear", 0.0), body.get("angular", 0.0), until_ns)
                answer = json.dumps({"detail": station.refusal}).encode()
                self.send_response(409 if station.refusal else 200)
                self.send_header("Content-Length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

            def log_message(self, format: str, *args: object) -> None:
                """Silent."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def running(textures: Path) -> Iterator[tuple[SimulatedRobot, ControlServer, Station]]:
    robot = SimulatedRobot("room", 1, SimulationConfig(), textures)
    control = ControlServer(robot, 0)
    robot.start(control)
    station = Station(robot)
    yield robot, control, station
    station.server.shutdown()
    station.server.server_close()
    robot.close()


def test_it_drives_along_the_route_and_stops_the_motors_when_time_is_up(
    running: tuple[SimulatedRobot, ControlServer, Station], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, control, station = running
    start = robot.truth()[1].p_world

    def has_driven() -> bool:
        return len(station.calls) > 10 and bool(np.linalg.norm(robot.truth()[1].p_world - start) > 0.04)

    # Time is up as soon as it has driven, however quick this machine is.
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + 1000.0 * has_driven(), sleep=time.sleep)
    monkeypatch.setattr(robot_remote_driver, "time", clock)
    with pytest.raises(DeviceLost, match="took longer than 900 s"):
        drive_route(station.address, control.port, "local", 0, "tester", max_duration_s=900.0)
    assert has_driven()
    assert station.calls[-1] == ("/stop", "tester")


def test_a_station_that_refuses_is_quoted(running: tuple[SimulatedRobot, ControlServer, Station]) -> None:
    _, control, station = running
    station.refusal = "another client drives"
    with pytest.raises(DeviceLost, match="another client drives"):
        drive_route(station.address, control.port, "local", 0)


def test_missing_programs_are_named(running: tuple[SimulatedRobot, ControlServer, Station]) -> None:
    _, control, station = running
    with pytest.raises(ConfigError, match="no simulator answers"):
        drive_route(station.address, 1, "local", 0)
    station.server.shutdown()
    station.server.server_close()
    with pytest.raises(DeviceLost, match="does not answer"):
        drive_route(station.address, control.port, "local", 0)
    with pytest.raises(ConfigError, match="spiral"):
        drive_route(station.address, control.port, "spiral", 0)


def test_an_unknown_pace_is_named() -> None:
    words = ["drive", "--station", "http://127.0.0.1:1", "--sim-port", "1", "--pace", "hurried"]
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, ConfigError) and "choose one of calm, brisk" in str(result.exception)
