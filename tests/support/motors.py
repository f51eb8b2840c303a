"""Motors that remember what they were told."""

from __future__ import annotations

import threading


class FakeMotors:
    """Keeps what they were told; can hang or fail."""

    def __init__(self) -> None:
        self.history: list[tuple[float, float]] = []
        self.until_ns = 0  # of the newest command
        self.told = threading.Condition()
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        self.failure: Exception | None = None
        self.stop_fault = ""  # why a stop does not reach them

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        self.until_ns = until_ns
        self._note(linear_m_s, angular_rad_s)
        self.may_go_on.wait(10)
        if self.failure is not None:
            raise self.failure

    def stop(self) -> str:
        self._note(0.0, 0.0)
        return self.stop_fault

    def close(self) -> None:
        pass

    def _note(self, linear: float, angular: float) -> None:
        with self.told:
            self.history.append((linear, angular))
            self.told.notify_all()

    def wait_for_last(self, linear: float, angular: float) -> bool:
        with self.told:
            return self.told.wait_for(lambda: bool(self.history) and self.history[-1] == (linear, angular), 10)
