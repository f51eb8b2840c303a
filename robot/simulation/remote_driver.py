"""Drives a robot through the station's HTTP like a person at the page, steering by the simulator's truth."""

from __future__ import annotations

import http.client
import json
import math
import sys
import time
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from robot.simulation.driver import CALM, Pace, RouteDriver
from robot.simulation.routes import Route
from shared.errors import ConfigError, DeviceLost
from shared.simulator_link import SimulatorLink

COMMAND_PERIOD_S = 1 / 15
COMMAND_TTL_MS = 300
TIMEOUT_S = 10.0
RETRIES = 20  # of refused commands in a row: the station may still be connecting to the robot
RETRY_WAIT_S = 0.25


class StationHttp:
    """Sends drive commands over one kept connection."""

    def __init__(self, address: str, driver_name: str) -> None:
        parts = urlsplit(address if "//" in address else f"http://{address}")
        if parts.scheme != "http" or not parts.hostname:
            raise ConfigError(f"--station {address!r} must look like http://HOST:PORT")
        self._connection = http.client.HTTPConnection(parts.hostname, parts.port or 80, timeout=TIMEOUT_S)
        self._headers = {"Content-Type": "application/json", "X-Driver": driver_name}
        self._address = address

    def drive(self, linear_m_s: float, angular_rad_s: float) -> str:
        """Send one command; "" when accepted, else the station's reason. Raises DeviceLost."""
        body = {"linear": linear_m_s, "angular": angular_rad_s, "ttl_ms": COMMAND_TTL_MS}
        return self._post("/drive", body)

    def stop(self) -> str:
        return self._post("/stop", {})

    def close(self) -> None:
        self._connection.close()

    def _post(self, path: str, body: dict[str, Any]) -> str:
        for attempt in (1, 2):  # a kept connection may have been closed by the other side
            try:
                self._connection.request("POST", path, json.dumps(body), self._headers)
                answer = self._connection.getresponse()
                text = answer.read()
                return "" if answer.status < 300 else _reason(answer.status, text)
            except (OSError, http.client.HTTPException) as exc:
                self._connection.close()
                if attempt == 2:
                    raise DeviceLost(f"the station at {self._address} does not answer ({exc})") from exc
        raise AssertionError("unreachable")


def _reason(status: int, text: bytes) -> str:
    try:
        document = json.loads(text)
        return str(document.get("detail") or document.get("title") or status)
    except (ValueError, AttributeError):
        return f"status {status}"


@dataclass(frozen=True, slots=True)
class DriveReport:
    duration_s: float
    length_m: float
    refused: int


def drive_route(
    station: str,
    sim_port: int,
    kind: str,
    seed: int,
    driver_name: str = "scripted",
    max_duration_s: float = 600.0,
    pace: Pace = CALM,
) -> DriveReport:
    """Drive a route from where the robot is, to its end.

    Raises:
        ConfigError: no simulator, unknown route.
        DeviceLost: the station is gone, refuses to drive for long, or the route takes too long.
    """
    control = SimulatorLink(sim_port)
    http_link = StationHttp(station, driver_name)
    try:
        plan = control.ask(cmd="route", kind=kind, seed=seed)
        route = Route(plan["kind"], np.array(plan["points"]), plan["start_yaw"])
        return _follow(control, http_link, RouteDriver(route, pace=pace), route.length_m, max_duration_s)
    finally:
        http_link.close()
        control.close()


def _follow(
    control: SimulatorLink, station: StationHttp, driver: RouteDriver, length_m: float, max_duration_s: float
) -> DriveReport:
    began = next_s = time.monotonic()
    refused = in_a_row = shown = 0
    while not driver.is_done:
        truth = control.ask(cmd="truth")
        T = truth["T_world_body"]
        command = driver.command(T[0][3], T[1][3], math.atan2(T[1][0], T[0][0]), truth["omega_body"][2])
        reason = station.drive(command.linear_m_s, command.angular_rad_s)
        in_a_row = in_a_row + 1 if reason else 0
        refused += bool(reason)
        if in_a_row > RETRIES:
            raise DeviceLost(f"the station refuses to drive: {reason}")
        if reason:
            time.sleep(RETRY_WAIT_S)
        if time.monotonic() - began > max_duration_s:
            station.stop()
            raise DeviceLost(f"the route took longer than {max_duration_s:.0f} s; {driver.progress:.0%} is driven")
        if int(10 * driver.progress) > shown:
            shown = int(10 * driver.progress)
            print(f"{10 * shown} % of the route, in {truth['room'] or 'a doorway'}", file=sys.stderr, flush=True)
        next_s = max(next_s + COMMAND_PERIOD_S, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))
    station.stop()
    return DriveReport(time.monotonic() - began, length_m, refused)
