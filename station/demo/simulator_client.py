"""The demo's view behind the scenes: the simulator's control port. Only the demo's judge and its hijack use it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from shared.simulator_link import SimulatorLink


@dataclass(frozen=True, slots=True, eq=False)
class TruthLog:
    """Where the robot really was."""

    t_robot_ns: IntArray  # (N,)
    T_world_body: FloatArray  # (N, 4, 4) simulator's world


class SimulatorClient(SimulatorLink):
    """What a judge asks."""

    def truth_log(self) -> TruthLog:
        """The whole drive so far."""
        answer = self.ask(cmd="truth_log")
        return TruthLog(np.array(answer["t_robot_ns"], np.int64), np.array(answer["T_world_body"]).reshape(-1, 4, 4))
