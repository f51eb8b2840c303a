"""Who has the wheel: of the stations of a robot, and of the pages and programs of a station. Time is an argument."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, Literal, TypeVar

LET_GO_NS = 500_000_000  # of silence after the last command's end: whoever was stopped by somebody else let go
LISTENING_NS = 200_000_000  # who has looked no more often than this was not listening: a process stood still

Driver = TypeVar("Driver", bound=Hashable)
# May a command pass? "taken": another one drives. "stopped": somebody else stopped this driver, who has held on since.
Verdict = Literal["granted", "taken", "stopped"]


class DriverLease(Generic[Driver]):
    """One driver at a time. A driver keeps the wheel by commands; silence gives it back."""

    def __init__(self, lease_ns: int) -> None:
        """`lease_ns`: of silence after the last command's end."""
        self._lease_ns = lease_ns
        self._driver: Driver | None = None
        self._heard_ns = 0
        self._hold_ns = 0  # so long the last command held
        self._free_ns = 0  # when silence has given the wheel back
        self._stopped: Driver | None = None  # who was stopped by somebody else and has not let go since
        self._is_anybody_stopped = False  # that one is gone, and may be back under another name
        self._listened_ns: int | None = None  # when `listen` was called last

    def driver(self, now_ns: int) -> Driver | None:
        return self._driver if self._driver is not None and now_ns < self._free_ns else None

    @property
    def last_driver(self) -> Driver | None:
        """Who had the wheel last and has not released it, however silent since."""
        return self._driver

    def left_ns(self, now_ns: int) -> int:
        """For how long the driver keeps the wheel without another command."""
        return max(0, self._free_ns - now_ns)

    def listen(self, now_ns: int) -> None:
        """To be called often by whoever hears drivers: while that stands still there is no silence, but deafness."""
        if self._listened_ns is not None:
            deaf_ns = max(0, now_ns - self._listened_ns - LISTENING_NS)
            self._heard_ns = max(self._heard_ns, min(self._heard_ns + deaf_ns, now_ns))  # a word may have come since
        self._listened_ns = now_ns

    def hear_holding(self, driver: Driver, now_ns: int) -> None:
        """This driver has held on until now, by words that came too late to count, or never came."""
        if self._is_anybody_stopped or driver == self._stopped:
            self._heard_ns = max(self._heard_ns, now_ns)

    def command(self, driver: Driver, is_zero: bool, now_ns: int, hold_ns: int = 0) -> Verdict:
        """Claim the wheel by a velocity that holds for `hold_ns`."""
        if self._listened_ns is not None:
            self.listen(now_ns)
        is_stopped = self._is_stopped(driver, is_zero, now_ns)
        if not self.claim(driver, now_ns, hold_ns):
            return "taken"
        return "stopped" if is_stopped else "granted"

    def claim(self, driver: Driver, now_ns: int, hold_ns: int = 0) -> bool:
        """Take or keep the wheel, by a command that holds for `hold_ns`; False when another one has it."""
        if self.driver(now_ns) not in (None, driver):
            return False
        self.take_over(driver, now_ns, hold_ns)
        self._hold_ns = hold_ns
        return True

    def take_over(self, driver: Driver, now_ns: int, hold_ns: int = 0) -> None:
        """Take the wheel whoever has it."""
        free_ns = now_ns + hold_ns + self._lease_ns
        self._free_ns = max(free_ns, self._free_ns) if driver == self._driver else free_ns
        self._driver, self._heard_ns, self._hold_ns = driver, now_ns, 0

    def stop(self, by: Driver | None, now_ns: int) -> None:
        """A stop by somebody else holds until the driver lets go; the driver's own is letting go.

        Args:
            by: None is nobody who drives.
        """
        if by is not None and by == self._stopped:
            self._stopped = None
        if (driver := self.driver(now_ns)) is not None and driver != by:
            self._stopped = driver
            self._heard_ns = now_ns  # the silence that counts begins now

    def release(self, driver: Driver) -> bool:
        """Let go. True when the wheel was this one's, or was so last."""
        if self._stopped == driver:
            self._stopped = None
        return self._give_back(driver)

    def leave(self, driver: Driver) -> bool:
        """Gone without letting go: a stop by somebody else holds for whoever comes next. True as for `release`."""
        if self._stopped == driver:
            self._stopped, self._is_anybody_stopped = None, True
        return self._give_back(driver)

    def _give_back(self, driver: Driver) -> bool:
        if self._driver != driver:
            return False
        self._driver = None
        return True

    def _is_stopped(self, driver: Driver, is_zero: bool, now_ns: int) -> bool:
        """Somebody else stopped this driver, who has held on since. To be asked before the claim, which is a word.

        Silence while the last command would still hold is none: a program that repeats once a second holds on too.
        """
        is_stopped = self._is_anybody_stopped or driver == self._stopped
        if is_stopped and (is_zero or now_ns - self._heard_ns >= self._hold_ns + LET_GO_NS):
            self._stopped, self._is_anybody_stopped = None, False
            return False
        return is_stopped
