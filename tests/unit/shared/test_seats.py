"""Who gets a seat, and who yields."""

from __future__ import annotations

from shared.seats import Rank, Seat, Seats


class Room:
    """Seats, and who had to leave them."""

    def __init__(self, limit: int, per_holder: int, *, oldest_yields: bool = False) -> None:
        self.seats = Seats(limit, per_holder, oldest_yields=oldest_yields)
        self.left: list[str] = []

    def enter(self, name: str, holder: str, rank: Rank = Rank.LOW) -> Seat | None:
        return self.seats.take(holder, rank, lambda: self.left.append(name))


def test_beyond_its_share_a_holders_newest_replaces_its_oldest() -> None:
    room = Room(8, 2)
    assert all(room.enter(f"a{n}", "a") for n in range(4))
    assert room.left == ["a0", "a1"] and not room.seats.is_full


def test_nobody_in_particular_has_no_share() -> None:
    room = Room(3, 1)
    assert all(room.enter(str(n), "") for n in range(3))
    assert room.enter("3", "") is None and room.left == []


def test_the_lower_rank_yields_to_the_higher_and_never_the_other_way_round() -> None:
    room = Room(2, 2)
    room.enter("watches", "a")
    room.enter("drives", "b", Rank.HIGH)
    assert room.enter("drives too", "c", Rank.HIGH)
    assert room.left == ["watches"]
    assert room.enter("watches too", "d") is None


def test_of_equals_whoever_has_more_seats_yields_one_to_whoever_has_none() -> None:
    room = Room(3, 2)
    room.enter("a1", "a")
    room.enter("b1", "b")
    room.enter("b2", "b")
    assert room.enter("c1", "c")
    assert room.left == ["b1"]
    assert room.enter("d1", "d") is None  # all have one


def test_where_somebody_must_always_get_in_the_oldest_of_the_busiest_yields() -> None:
    room = Room(3, 2, oldest_yields=True)
    for name in ("a1", "b1", "b2", "c1", "d1"):
        assert room.enter(name, name[0])
    assert room.left == ["b1", "a1"]


def test_a_seat_that_was_left_is_free_and_leaving_it_again_is_nothing() -> None:
    room = Room(1, 1)
    first = room.enter("a", "a")
    assert first is not None
    room.seats.leave(first)
    assert room.enter("b", "b")
    room.seats.leave(first)
    assert room.seats.is_full and room.left == []
