"""How far a guided estimate is, for a bar that fills once."""

from __future__ import annotations

from collections.abc import Callable

LOOKING, ESTIMATING, DRAWING = 0.02, 0.5, 0.95  # how much is done when that begins
USUAL_STEPS = 12  # of the estimate


class GuidedSteps:
    """Half of the bar is for the pictures, the other for the steps of the estimate."""

    def __init__(self, progress: Callable[[float, str], None]) -> None:
        self._progress = progress
        self._description, self._total, self._done, self._steps = "reading the recording", 1, 0, 0

    def step(self, description: str, total: int | None = None) -> None:
        """Something begins: pictures, so many in all, or a step of the estimate."""
        if total is None:
            self.estimate(description)
            return
        self._description, self._total, self._done = description, max(1, total), 0
        self._progress(LOOKING, description)

    def advance(self) -> None:
        self._done += 1
        self._progress(LOOKING + (ESTIMATING - LOOKING) * self._done / self._total, self._description)

    def estimate(self, description: str) -> None:
        self._steps = min(self._steps + 1, USUAL_STEPS)
        self._progress(ESTIMATING + (DRAWING - ESTIMATING) * self._steps / USUAL_STEPS, description)
