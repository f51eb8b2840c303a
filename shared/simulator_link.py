"""The simulator's control port (robot/devices/simulated/control.py), asked: one JSON object per line, each way."""

from __future__ import annotations

import json
import socket
from typing import Any

from shared.errors import ConfigError, DeviceLost

TIMEOUT_S = 20.0


class SimulatorLink:
    """Only judges and scripted drivers use it: what the station answers comes from the sensors alone."""

    def __init__(self, port: int) -> None:
        """Raises ConfigError: nobody answers."""
        try:
            self._socket = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
        except (OSError, OverflowError) as exc:
            raise ConfigError(
                f"no simulator answers on 127.0.0.1:{port} ({exc}); start robot-server with --sim-port {port}"
            ) from exc
        self._lines = self._socket.makefile("rwb")

    def ask(self, **question: Any) -> dict[str, Any]:
        """One question, one answer. Raises ConfigError with the simulator's sentence, DeviceLost when it is gone."""
        try:
            self._lines.write(json.dumps(question).encode() + b"\n")
            self._lines.flush()
            line = self._lines.readline()
        except OSError as exc:
            raise DeviceLost(f"the simulator stopped answering ({exc})") from exc
        if not line:
            raise DeviceLost("the simulator closed its control port")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise ConfigError(f"simulator: {answer['error']}")
        return answer

    def close(self) -> None:
        self._lines.close()
        self._socket.close()
