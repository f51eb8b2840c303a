"""When the Mega may be asked for its hello, and what it has confirmed since. Pure: time is an argument.

Opening the port resets a Mega into its bootloader, which listens for about a second. A single byte in that time is
the start of a programming session for it, which each further byte makes seven seconds longer. So: listen first.
"""

from __future__ import annotations

import math

from shared.serial_protocol import Ack, Command, ConfigImu, ConfigMotors, ConfigRange, Type

BOOT_S = 2.5  # the bootloader has left by then, if nobody spoke to it
RUNS_S = 0.5  # a frame so fresh shows that the firmware runs and not the bootloader
ASK_PERIOD_S = 1.0
QUIET_S = 10.0  # a bootloader that was spoken to gives up before that
CONFIRM_S = 1.0  # a configuration that is not confirmed for so long is said again
DONE, UNKNOWN_TYPE = 0, 3


class AskPlan:
    """The firmware says hello by itself; it is asked only where that cannot hit the bootloader."""

    def __init__(self, opened_s: float) -> None:
        self._opened_s = opened_s
        self._asked_s = self._heard_s = -math.inf

    def hear(self, now_s: float) -> None:
        """A whole frame came that is no hello."""
        self._heard_s = now_s

    def is_due(self, now_s: float) -> bool:
        """Whether to ask now; asking is then taken as done."""
        if now_s - self._opened_s < BOOT_S:
            return False
        if now_s - self._heard_s < RUNS_S:
            is_due = now_s - self._asked_s >= ASK_PERIOD_S
        else:
            is_due = now_s - max(self._opened_s, self._asked_s, self._heard_s) >= QUIET_S
        if is_due:
            self._asked_s = now_s
        return is_due


class Settings:
    """The configuration commands, each repeated until the firmware says that it is done."""

    def __init__(self, imu: ConfigImu, motors: ConfigMotors, range_sensor: ConfigRange | None = None) -> None:
        self._commands: dict[int, Command] = {Type.CONFIG_IMU: imu, Type.CONFIG_MOTORS: motors}
        if range_sensor is not None:
            self._commands[Type.CONFIG_RANGE] = range_sensor
        self._open: set[int] = set(self._commands)
        self._said_s = 0.0
        self.refused = ""  # which the firmware does not take, in a sentence
        self.is_older = False  # it knows no range sensor, and does without

    @property
    def motors_are_set(self) -> bool:
        """Before that, nothing may drive: ramp and battery cut-off may be others."""
        return Type.CONFIG_MOTORS not in self._open

    @property
    def are_confirmed(self) -> bool:
        return not self._open

    def begin(self) -> None:
        """A firmware that has just started knows none of them."""
        self._open = set(self._commands)
        self._said_s = -CONFIRM_S
        self.refused = ""
        self.is_older = False

    def due(self, now_s: float) -> list[Command]:
        """What to say now; it is then taken as said."""
        if not self._open or now_s - self._said_s < CONFIRM_S:
            return []
        self._said_s = now_s
        return [command for kind, command in self._commands.items() if kind in self._open]

    def take(self, ack: Ack) -> None:
        if ack.asked not in self._commands:
            return
        if ack.result == DONE:
            self._open.discard(ack.asked)
            self.refused = ""
        elif ack.asked == Type.CONFIG_RANGE and ack.result == UNKNOWN_TYPE:
            self._open.discard(ack.asked)
            self.is_older = True
        else:
            name = type(self._commands[ack.asked]).__name__
            self.refused = f"the Mega refuses {name} (result {ack.result}); flash it: make -C firmware upload"
