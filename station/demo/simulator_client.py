"""The demo's view behind the scenes: the simulator's control port. Only the demo's judge and its hijack use it."""

from __future__ import annotations

import numpy as np

from shared.simulator_link import SimulatorLink
from station.model.navigation import Trajectory


class SimulatorClient(SimulatorLink):
    """What a judge asks."""

    def truth_log(self) -> Trajectory:
        """Where the robot really was, the whole drive so far, in the simulator's world."""
        answer = self.ask(cmd="truth_log")
        return Trajectory(np.array(answer["t_robot_ns"], np.int64), np.array(answer["T_world_body"]).reshape(-1, 4, 4))
