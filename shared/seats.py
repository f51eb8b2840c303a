"""How many may be in at once, and who yields when one more comes. No socket, no clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from shared.access import Role


class Rank(IntEnum):
    """The lower yields to the higher."""

    LOW = 0  # who only watches; an address that nobody known has called from
    HIGH = 1


def rank_of(role: Role) -> Rank:
    """Who may drive never waits behind who only watches."""
    return Rank.HIGH if role.includes(Role.DRIVE) else Rank.LOW


@dataclass(eq=False, frozen=True, slots=True)
class Seat:
    holder: str  # whose it is: a token's id, or an address; empty: nobody's in particular
    rank: Rank
    end: Callable[[], None]  # called when it has to yield


class Seats:
    """A number of seats. Each holder has its share of them; beyond it, its newest replaces its oldest."""

    def __init__(self, limit: int, per_holder: int, *, oldest_yields: bool = False) -> None:
        """`oldest_yields`: where equals have taken all seats, one is made free; else the newest is refused."""
        self._limit = limit
        self._per_holder = per_holder
        self._oldest_yields = oldest_yields
        self._taken: dict[Seat, None] = {}  # the oldest first

    @property
    def is_full(self) -> bool:
        return len(self._taken) >= self._limit

    def take(self, holder: str, rank: Rank, end: Callable[[], None]) -> Seat | None:
        """A seat, for which another one may have to yield; None: nobody has to."""
        own = [seat for seat in self._taken if seat.holder == holder]
        if holder and len(own) >= self._per_holder:
            self._end(own[0])
        elif self.is_full:
            yielding = self._who_yields(holder, rank)
            if yielding is None:
                return None
            self._end(yielding)
        seat = Seat(holder, rank, end)
        self._taken[seat] = None
        return seat

    def leave(self, seat: Seat) -> None:
        """Give a seat back; one that had to yield is given back already."""
        self._taken.pop(seat, None)

    def _who_yields(self, holder: str, rank: Rank) -> Seat | None:
        """Of the lowest rank the oldest of the holder with most seats, unless they are the newcomer's equals."""
        lowest = min((seat.rank for seat in self._taken), default=None)
        if lowest is None or lowest > rank:
            return None
        counts = Counter(seat.holder for seat in self._taken if seat.rank == lowest)
        busiest, most = counts.most_common(1)[0]
        if lowest < rank or self._oldest_yields or most > counts[holder] + 1:
            return next(seat for seat in self._taken if (seat.rank, seat.holder) == (lowest, busiest))
        return None

    def _end(self, seat: Seat) -> None:
        del self._taken[seat]
        seat.end()
