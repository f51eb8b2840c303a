"""What a network did to driving: joystick commands beside what the motors were told, on one clock."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

NUMBERS = 1000  # commands of one hold that can be told apart
_TOLD = struct.Struct("<qdd")


@dataclass(frozen=True, slots=True)
class Told:
    """One word to the motors."""

    t_ns: int
    linear_m_s: float
    angular_rad_s: float

    @property
    def packed(self) -> bytes:
        return _TOLD.pack(self.t_ns, self.linear_m_s, self.angular_rad_s)

    @classmethod
    def all_in(cls, log: bytes) -> list[Told]:
        """Without half a word at the end."""
        return [cls(*values) for values in _TOLD.iter_unpack(log[: len(log) // _TOLD.size * _TOLD.size])]

    @property
    def is_stop(self) -> bool:
        return self.linear_m_s == self.angular_rad_s == 0.0

    @property
    def number(self) -> int:
        """Of the command; -1 of a stop."""
        return -1 if self.is_stop else round(self.angular_rad_s / self.linear_m_s * NUMBERS) - 1


def numbered(number: int, linear_m_s: float) -> tuple[float, float]:
    """(linear, angular) of a command that is known again at the motors, also when it was slowed down on the way."""
    return linear_m_s, linear_m_s * (number % NUMBERS + 1) / NUMBERS


@dataclass(slots=True)
class Hold:
    """A joystick held for a while, and what was said meanwhile."""

    pressed_ns: int
    released_ns: int = 0
    sent_ns: list[int] = field(default_factory=list)  # of each command; its place is its number
    cut_ns: int | None = None  # the network carried nothing from then on
    mended_ns: int = 0


def delays_ms(hold: Hold, told: Sequence[Told]) -> list[float]:
    """For each command: until it reached the motors, or a newer one did; letting go is newer than all.

    Infinite where none did. Of a hold in which the network was cut: none.
    """
    if hold.cut_ns is not None:
        return []
    return [_arrived_ms(number, t_ns, hold, told) for number, t_ns in enumerate(hold.sent_ns)]


def _arrived_ms(number: int, sent_ns: int, hold: Hold, told: Sequence[Told]) -> float:
    later = (word for word in told if word.t_ns >= sent_ns)
    newer = (w.t_ns for w in later if w.number >= number or (w.is_stop and w.t_ns >= hold.released_ns))
    return (next(newer, math.inf) - sent_ns) * 1e-6


def moved_ns(begin_ns: int, end_ns: int, told: Sequence[Told]) -> int:
    """For how long the motors turned between two times."""
    total, turns_since_ns = 0, None
    for word in told:
        if word.t_ns >= end_ns:
            break
        if word.is_stop and turns_since_ns is not None:
            total += max(0, word.t_ns - max(begin_ns, turns_since_ns))
            turns_since_ns = None
        elif not word.is_stop and turns_since_ns is None:
            turns_since_ns = word.t_ns
    return total if turns_since_ns is None else total + end_ns - max(begin_ns, turns_since_ns)


def stopped_ms(since_ns: int, until_ns: int, told: Sequence[Told]) -> float | None:
    """How long after the first time the motors stopped for good, as seen at the second; infinite when they turn then.

    None when they turned at no time between. Not the first stop: what is late on the way may start them once more.
    """
    motion = _last_motion(until_ns, told)
    return None if motion is None or motion[1] < since_ns else (motion[1] - since_ns) * 1e-6


def silent_ms(since_ns: int, until_ns: int, told: Sequence[Told]) -> float | None:
    """As `stopped_ms`, counted from the last word to turn before that stop."""
    motion = _last_motion(until_ns, told)
    return None if motion is None or motion[1] < since_ns else (motion[1] - motion[0]) * 1e-6


def _last_motion(until_ns: int, told: Sequence[Told]) -> tuple[int, float] | None:
    """The last word to turn before a time, and the stop that ended it (infinite: none before that time)."""
    last = max((word.t_ns for word in told if word.t_ns < until_ns and not word.is_stop), default=None)
    if last is None:
        return None
    return last, min((word.t_ns for word in told if last <= word.t_ns < until_ns and word.is_stop), default=math.inf)


def wrong_until_s(offsets: Sequence[tuple[float, float]], limit_ms: float) -> float | None:
    """When a clock's offset was farther off than that the last time; 0: never; None: no offset is known.

    Args:
        offsets: (s, ms off), of a true offset of 0.
    """
    if not offsets:
        return None
    return max((t_s for t_s, ms in offsets if abs(ms) > limit_ms), default=0.0)
