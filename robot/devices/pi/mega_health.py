"""What the Mega's status tells of things that go wrong, in sentences. Pure: time is an argument."""

from __future__ import annotations

from collections import deque

from shared.serial_protocol import Ack, Flag, Status, Type

WINDOW_MS = 5000  # a counter that rose within so long tells of something that goes on
DEEPEST_STACK_FREE = 256  # bytes
SET_UP_MS = 2000  # the firmware has found and set up its IMU by then, once at its start and once as we say how
SET_UP = Flag.IMU_MISSING | Flag.MAG_MISSING | Flag.BUS_ERROR  # say nothing before

FLAGS = {
    Flag.IMU_MISSING: "the Mega finds no ICM-20948; check its four wires (SDA 20, SCL 21, 3.3 V, GND)",
    Flag.MAG_MISSING: "the IMU's magnetometer does not answer; headings do without it",
    Flag.BUS_ERROR: "the wires between Mega and IMU are disturbed; shorten SDA and SCL or check their contacts",
    Flag.LOW_BATTERY: "the motors' battery is low, the Mega holds the motors off; charge it",
    Flag.DRIVER_FAULT: "the motor driver reports overcurrent or heat (FLT); let the wheels run free and let it cool",
}
COUNTERS = {
    "samples_lost": "the Mega loses IMU samples; check the wires to INT, SDA and SCL",
    "rx_bad": "frames to the Mega arrive damaged; check or change the USB cable",
    "rx_overruns": "the Mega receives faster than it takes in; restart robot-server",
    "tx_dropped": "the Mega could not send all it had; check or change the USB cable",
}


class MegaHealth:
    """Flags as they are, counters by their rise."""

    def __init__(self) -> None:
        self._past: deque[Status] = deque()
        self._refused_ms: int | None = None  # uptime as reported last before a drive command was refused

    def take(self, status: Status) -> None:
        """The next report. One with a lower uptime is a new start: nothing before it counts."""
        if self._past and status.uptime_ms < self._past[-1].uptime_ms:
            self._past.clear()
            self._refused_ms = None
        self._past.append(status)
        while self._past[-1].uptime_ms - self._past[0].uptime_ms > WINDOW_MS:
            self._past.popleft()

    def take_ack(self, ack: Ack) -> None:
        """Drive commands are answered only where they are refused."""
        if ack.asked == Type.DRIVE and self._past:
            self._refused_ms = self._past[-1].uptime_ms

    def sentences(self) -> dict[str, str]:
        """Which flag or counter → what is wrong and what to do."""
        past = list(self._past)  # another thread may take the next one
        if not past:
            return {}
        first, last = past[0], past[-1]
        told = last.flags & ~SET_UP if last.uptime_ms < SET_UP_MS else last.flags
        found = {str(flag.name): text for flag, text in FLAGS.items() if told & flag}
        found |= {name: text for name, text in COUNTERS.items() if getattr(last, name) != getattr(first, name)}
        refused_ms = self._refused_ms  # read once, as past above
        if refused_ms is not None and last.uptime_ms - refused_ms <= WINDOW_MS:
            found["late_commands"] = "drive commands reach the Mega after their end; its computer is too busy"
        if last.stack_free < DEEPEST_STACK_FREE:
            found["stack_free"] = f"the Mega has {last.stack_free} bytes of stack left; report this as a bug"
        return found
