"""Tells systemd that robot-server is ready, alive and ending, by datagrams (sd_notify(3)). Without systemd: nothing.

The unit's WatchdogSec restarts a robot-server that does not say WATCHDOG=1; who says it decides what "alive" means.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping

logger = logging.getLogger(__name__)

FEEDS_PER_PERIOD = 4  # sd_watchdog_enabled(3) asks for two; a busy Pi is late now and then


class Systemd:
    """The service manager's socket."""

    def __init__(self, address: str = "", watchdog_us: int = 0) -> None:
        """`address`: a path or, with a leading @, a name; empty: nobody listens. `watchdog_us` 0: nobody waits."""
        self._period_ns = watchdog_us * 1000 // FEEDS_PER_PERIOD
        self._fed_ns: int | None = None
        self._address = "\0" + address[1:] if address.startswith("@") else address

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Systemd:
        """As the service manager has set the environment; another process' watchdog is not ours."""
        is_ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watchdog = environment.get("WATCHDOG_USEC", "0") if is_ours else "0"
        return cls(environment.get("NOTIFY_SOCKET", ""), int(watchdog) if watchdog.isdigit() else 0)

    def ready(self) -> None:
        """Stations can connect."""
        self._send("READY=1")

    def alive(self, now_ns: int) -> None:
        """Feed the watchdog. Call it as often as you like."""
        if self._period_ns and (self._fed_ns is None or now_ns - self._fed_ns >= self._period_ns):
            self._fed_ns = now_ns
            self._send("WATCHDOG=1")

    def ending(self) -> None:
        """The end is meant."""
        self._send("STOPPING=1")

    def _send(self, state: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as line:
                line.sendto(state.encode(), self._address)
        except OSError as exc:  # a manager that does not listen must not stop the robot; it says itself what it misses
            logger.debug("systemd does not take %s: %s", state, exc)
