"""How many may be in at once, and who yields when one more comes. No socket, no clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from shared.access import Role


class Rank(IntEnum):
    """The lower yields to the higher."""

    LOW = 0  # who only watches; an address that nobody known has called from
    HIGH = 1


RANKS = tuple(Rank)  # to go through an enumeration costs more than all the rest


def rank_of(role: Role) -> Rank:
    """Who may drive never waits behind who only watches."""
    return Rank.HIGH if role.includes(Role.DRIVE) else Rank.LOW


@dataclass(eq=False, frozen=True, slots=True)
class Seat:
    holder: str  # whose it is: a token's id, or an address; empty: nobody's in particular
    rank: Rank
    end: Callable[[], None]  # called when it has to yield
    number: int  # in the order in which they were taken


class Seats:
    """A number of seats. Each holder has its share of them; beyond it, its newest replaces its oldest."""

    def __init__(self, limit: int, per_holder: int, *, oldest_yields: bool = False) -> None:
        """`oldest_yields`: where equals have taken all seats, one is made free; else the newest is refused."""
        self._limit = limit
        self._per_holder = per_holder
        self._oldest_yields = oldest_yields
        self._next = 0
        self._count = 0
        self._taken: dict[tuple[Rank, str], dict[Seat, None]] = {}  # by rank and holder, the oldest first

    @property
    def is_full(self) -> bool:
        return self._count >= self._limit

    def take(self, holder: str, rank: Rank, end: Callable[[], None]) -> Seat | None:
        """A seat, for which another one may have to yield; None: nobody has to."""
        own = [seats for of in RANKS if (seats := self._taken.get((of, holder)))]
        if holder and sum(map(len, own)) >= self._per_holder:
            self._end(min(map(_oldest, own), key=lambda seat: seat.number))
        elif self.is_full:
            yielding = self._who_yields(holder, rank)
            if yielding is None:
                return None
            self._end(yielding)
        seat = Seat(holder, rank, end, self._next)
        self._next += 1
        self._count += 1
        self._taken.setdefault((rank, holder), {})[seat] = None
        return seat

    def leave(self, seat: Seat) -> None:
        """Give a seat back; one that had to yield is given back already."""
        group = (seat.rank, seat.holder)
        seats = self._taken.get(group, {})
        if seat in seats:
            del seats[seat]
            self._count -= 1
            if not seats:
                del self._taken[group]

    def _who_yields(self, holder: str, rank: Rank) -> Seat | None:
        """Of the lowest rank the oldest of the holder with most seats, unless they are the newcomer's equals."""
        lowest = min((of for of, _ in self._taken), default=None)
        if lowest is None or lowest > rank:
            return None
        groups = [seats for (of, _), seats in self._taken.items() if of == lowest]
        busiest = max(groups, key=lambda seats: (len(seats), -_oldest(seats).number))
        own = len(self._taken.get((lowest, holder), ()))
        return _oldest(busiest) if lowest < rank or self._oldest_yields or len(busiest) > own + 1 else None

    def _end(self, seat: Seat) -> None:
        self.leave(seat)
        seat.end()


def _oldest(seats: dict[Seat, None]) -> Seat:
    return next(iter(seats))
