"""The simulator's second door: truth, faults and hands, for tests, the demo's judge and the scripted driver.

One JSON object per line each way, loopback only. The station never connects to it: what it answers must come from
the sensors alone.
"""

from __future__ import annotations

import contextlib
import json
import logging
import socketserver
import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, structs

from robot.config import Section, convert
from robot.devices.simulated.robot import SimulatedRobot
from robot.simulation.calibration.board import TAGS, Board, board_ahead
from robot.simulation.config import Faults
from shared.errors import ConfigError, DeviceUnavailable
from shared.geometry import se3

logger = logging.getLogger(__name__)

MAX_LINE_BYTES = 64 * 1024


class ControlServer:
    """Listens on 127.0.0.1 from the start; answers in threads of its own."""

    def __init__(self, robot: SimulatedRobot, port: int) -> None:
        desk = ControlDesk(robot)

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(ConnectionError):  # who asked may be killed before it has read the answer
                    while line := self.rfile.readline(MAX_LINE_BYTES):
                        self.wfile.write(json.dumps(desk.answer(line)).encode() + b"\n")

        try:
            self._server = _Server(("127.0.0.1", port), Handler)
        except (OSError, OverflowError) as exc:
            raise DeviceUnavailable(
                f"the simulator's control port {port} cannot be used ({exc}); choose another with --sim-port"
            ) from exc
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="simulator-control", daemon=True)
        self._thread.start()
        logger.info("simulator control on 127.0.0.1:%d", self.port)

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=2.0)


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True


class ControlDesk:
    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._commands: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "truth": self._truth,
            "truth_log": self._truth_log,
            "flat": self._flat,
            "hijack": self._hijack,
            "route": self._route,
            "faults": self._faults,
            "board": self._board,
            "wave": self._wave,
        }

    def answer(self, line: bytes) -> dict[str, Any]:
        """The answer to one line; {"error": sentence} when it cannot be done."""
        try:
            question = json.loads(line)
            if not isinstance(question, dict) or question.get("cmd") not in self._commands:
                return {"error": f'send {{"cmd": ...}} with one of {", ".join(self._commands)}'}
            return self._commands[question["cmd"]](question)
        except (ValueError, TypeError, KeyError, ConfigError) as exc:
            return {"error": f"{type(exc).__name__}: {exc}"}

    def _truth(self, _question: dict[str, Any]) -> dict[str, Any]:
        t_ns, state = self._robot.truth()
        x, y = float(state.p_world[0]), float(state.p_world[1])
        return {
            "t_robot_ns": t_ns,
            "T_world_body": se3(state.R_world_body, state.p_world).tolist(),
            "v_world": state.v_world.tolist(),
            "omega_body": state.omega_body.tolist(),
            "room": self._robot.world.room_at(x, y),
            "carried": self._robot.is_carried,
        }

    def _truth_log(self, question: dict[str, Any]) -> dict[str, Any]:
        since = int(question.get("since_ns", 0))
        entries = [(t, T) for t, T in self._robot.truth_log() if t >= since]
        return {"t_robot_ns": [t for t, _ in entries], "T_world_body": [T.round(6).tolist() for _, T in entries]}

    def _flat(self, _question: dict[str, Any]) -> dict[str, Any]:
        world = self._robot.world
        furniture = [asdict(o) for o in world.obstacles if o.name != "wall"]
        return {
            "world": world.name,
            "seed": world.seed,
            "bounds": world.bounds(),
            "rooms": [asdict(r) for r in world.rooms],
            "doors": [asdict(d) for d in world.doors],
            "furniture": furniture,
        }

    def _hijack(self, question: dict[str, Any]) -> dict[str, Any]:
        if "x" in question:
            x, y, yaw = (float(question[k]) for k in ("x", "y", "yaw"))
        else:
            x, y, yaw = self._robot.space.random_spot(int(question.get("seed", 0)), question.get("room"))
        duration_s = self._robot.hijack(x, y, yaw)
        t_ns, _ = self._robot.truth()
        return {
            "x": x,
            "y": y,
            "yaw": yaw,
            "room": self._robot.world.room_at(x, y),
            "t_begin_ns": t_ns,
            "t_end_ns": t_ns + round(duration_s * 1e9),
            "duration_s": duration_s,
        }

    def _route(self, question: dict[str, Any]) -> dict[str, Any]:
        route = self._robot.plan(str(question.get("kind", "mapping")), int(question.get("seed", 0)))
        return {
            "kind": route.kind,
            "points": route.points.round(4).tolist(),
            "start_yaw": route.start_yaw_rad,
            "length_m": route.length_m,
        }

    def _faults(self, question: dict[str, Any]) -> dict[str, Any]:
        changes = {k: v for k, v in question.items() if k != "cmd"}
        if changes:
            self._robot.faults = convert(structs.asdict(self._robot.faults) | changes, Faults, "faults")
        return structs.asdict(self._robot.faults)

    def _board(self, question: dict[str, Any]) -> dict[str, Any]:
        if question.get("gone"):
            self._robot.take_board_away()
            return {}
        place = convert({k: v for k, v in question.items() if k != "cmd"}, BoardPlace, "board")
        board = place.board
        aside, turned = (place.right_m, place.down_m), np.radians([place.pitch_deg, place.yaw_deg, place.roll_deg])
        self._robot.hang_board(board, board_ahead(board, place.distance_m, aside, turned))
        return {"target": board.yaml()}

    def _wave(self, question: dict[str, Any]) -> dict[str, Any]:
        wave = convert({k: v for k, v in question.items() if k != "cmd"}, WaveOrder, "wave")
        self._robot.wave(wave.board, wave.distance_m, wave.seconds, wave.seed)
        return {"target": wave.board.yaml(), "duration_s": wave.seconds}


class BoardSize(Section, frozen=True, kw_only=True):
    """A board of 36 tags."""

    tag_m: Annotated[float, Meta(gt=0, le=1)] = 0.034  # fills an A3 sheet across
    distance_m: Annotated[float, Meta(gt=0, le=20)] = 0.9  # from the camera to the board's centre

    @property
    def board(self) -> Board:
        return Board(TAGS, TAGS, self.tag_m)


class BoardPlace(BoardSize, frozen=True, kw_only=True):
    """Where somebody holds a board, seen from the camera."""

    right_m: float = 0.0
    down_m: float = 0.0
    pitch_deg: float = 0.0  # turned about the camera's x, y and z axis
    yaw_deg: float = 0.0
    roll_deg: float = 0.0


class WaveOrder(BoardSize, frozen=True, kw_only=True):
    """For how long somebody waves the robot before a board."""

    seconds: Annotated[float, Meta(ge=5, le=600)] = 30.0
    seed: Annotated[int, Meta(ge=0)] = 0
