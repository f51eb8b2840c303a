"""How much time a station has lived through: not what the clock on the wall says, which may be set or start anew."""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_AWAY_S = 86_400.0  # of the time between two runs, which only the wall's clock tells, at most so much counts


@dataclass(slots=True)
class LivedTime:
    """Since the last look. Not thread-safe."""

    looked_wall_s: float = math.inf  # maybe of an earlier run
    _looked_run_s: float | None = None  # in this run

    def look(self, now_s: float, run_s: float) -> float:
        """How much time counts since the last look.

        Args:
            now_s: on the wall.
            run_s: of a clock that nobody sets, whenever it began.
        """
        if self._looked_run_s is not None:
            lived_s = max(0.0, run_s - self._looked_run_s)  # of two at once the later one may come first
        else:
            lived_s = min(max(0.0, now_s - self.looked_wall_s), MAX_AWAY_S)
        self.looked_wall_s, self._looked_run_s = now_s, run_s
        return lived_s
