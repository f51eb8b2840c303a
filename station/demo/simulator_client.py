"""The demo's view behind the scenes: the simulator's control port. Only the demo's judge and its hijack use it."""

from __future__ import annotations

import json
import socket
from typing import Any

import numpy as np

from shared.errors import RobotSystemError
from station.model.navigation import Trajectory


class SimulatorClient:
    """One JSON object per line, each way."""

    def __init__(self, port: int, timeout_s: float = 20.0) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=timeout_s)
        self._reader = self._socket.makefile("rb")

    def close(self) -> None:
        self._reader.close()
        self._socket.close()

    def ask(self, **question: Any) -> dict[str, Any]:
        """Send one question; raises RobotSystemError with the simulator's words when it cannot be done."""
        self._socket.sendall(json.dumps(question).encode() + b"\n")
        line = self._reader.readline()
        if not line:
            raise RobotSystemError("the simulator closed its control port")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise RobotSystemError(f"simulator: {answer['error']}")
        return answer

    def truth_log(self) -> Trajectory:
        """Where the robot really was, the whole drive so far, in the simulator's world."""
        answer = self.ask(cmd="truth_log")
        return Trajectory(np.array(answer["t_robot_ns"], np.int64), np.array(answer["T_world_body"]).reshape(-1, 4, 4))
