"""One driver at a time, whether stations of a robot or pages of a station, and a stop by somebody else holds."""

from __future__ import annotations

import pytest

from shared.lease import LET_GO_NS, LISTENING_NS, DriverLease

MS = 1_000_000
LEASE_NS = 1000 * MS
ANNA, BEN = 1, 2


@pytest.fixture
def lease() -> DriverLease[int]:
    return DriverLease(LEASE_NS)


def test_it_goes_to_the_first_who_speaks_and_ends_with_silence(lease: DriverLease[int]) -> None:
    assert lease.claim(ANNA, 0) and not lease.claim(BEN, 500 * MS)
    assert lease.claim(ANNA, 900 * MS)  # speaking keeps it
    assert lease.driver(1900 * MS - 1) == ANNA and lease.driver(1900 * MS) is None
    assert lease.command(BEN, False, 1900 * MS) == "granted" and lease.driver(1900 * MS) == BEN


def test_a_command_that_holds_keeps_it_for_as_long(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0, hold_ns=700 * MS)
    assert lease.left_ns(0) == 1700 * MS
    assert lease.command(BEN, False, 1700 * MS - 1) == "taken"
    assert lease.command(BEN, False, 1700 * MS) == "granted"


def test_it_can_be_taken_over_and_released(lease: DriverLease[int]) -> None:
    lease.claim(ANNA, 0)
    lease.take_over(BEN, 1)
    assert lease.driver(2) == BEN and not lease.claim(ANNA, 2)
    assert not lease.release(ANNA)  # not hers any more
    assert lease.driver(3) == BEN
    assert lease.release(BEN)
    assert lease.driver(4) is None and lease.command(ANNA, False, 5) == "granted"


def test_who_had_it_last_is_known_however_long_ago(lease: DriverLease[int]) -> None:
    lease.claim(ANNA, 0)
    assert lease.driver(60_000 * MS) is None and lease.last_driver == ANNA
    assert lease.release(ANNA) and lease.last_driver is None


def test_a_stop_by_somebody_else_holds_until_the_driver_lets_go(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0)
    lease.stop(BEN, 0)
    now_ns = 0
    for _ in range(100):  # the joystick is still held
        now_ns += 50 * MS
        assert lease.command(ANNA, False, now_ns) == "stopped"
    assert lease.command(ANNA, True, now_ns + 50 * MS) == "granted"  # zero is letting go
    assert lease.command(ANNA, False, now_ns + 100 * MS) == "granted"


def test_half_a_second_of_silence_since_the_stop_is_letting_go(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0)
    lease.stop(BEN, 100 * MS)
    assert lease.command(ANNA, False, 100 * MS + LET_GO_NS) == "granted"
    lease.stop(BEN, 700 * MS)
    assert lease.command(ANNA, False, 700 * MS + LET_GO_NS - 1) == "stopped"


def test_silence_while_a_command_still_holds_is_none(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0, hold_ns=1000 * MS)
    lease.stop(BEN, 0)
    assert lease.command(ANNA, False, 1000 * MS, hold_ns=1000 * MS) == "stopped"
    assert lease.command(ANNA, False, 2000 * MS + LET_GO_NS, hold_ns=1000 * MS) == "granted"


def test_the_drivers_own_stop_holds_nobody(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0)
    lease.stop(ANNA, 0)
    assert lease.command(ANNA, False, 50 * MS) == "granted"


def test_a_stop_by_nobody_who_drives_holds_and_the_own_stop_after_it_lets_go(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0)
    lease.stop(None, 0)
    assert lease.command(ANNA, False, 10 * MS) == "stopped"
    lease.stop(ANNA, 20 * MS)
    assert lease.command(ANNA, False, 30 * MS) == "granted"


def test_who_leaves_gives_the_wheel_away_and_takes_the_stop_along(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0)
    lease.stop(BEN, 0)
    assert not lease.release(BEN) and lease.release(ANNA)
    assert lease.command(BEN, False, 1) == "granted"


@pytest.mark.parametrize("deaf_ms", [700, 60_000])
def test_while_nobody_listens_there_is_no_silence(lease: DriverLease[int], deaf_ms: int) -> None:
    lease.listen(0)
    lease.command(ANNA, False, 0)
    lease.stop(BEN, 0)
    for now_ns in range(0, 300 * MS, 50 * MS):
        lease.listen(now_ns)
        assert lease.command(ANNA, False, now_ns) == "stopped"
    back_ns = 250 * MS + deaf_ms * MS  # the process stood still; the joystick was held all the time
    assert lease.command(ANNA, False, back_ns) == "stopped"
    for now_ns in range(back_ns, back_ns + LET_GO_NS + LISTENING_NS, 50 * MS):
        lease.listen(now_ns)
    assert lease.command(ANNA, False, back_ns + LET_GO_NS + LISTENING_NS) == "granted"


def test_who_is_known_to_have_held_on_has_not_let_go(lease: DriverLease[int]) -> None:
    lease.command(ANNA, False, 0)
    lease.stop(BEN, 0)
    lease.hear_holding(ANNA, 400 * MS)
    assert lease.command(ANNA, False, 600 * MS) == "stopped"
    lease.hear_holding(BEN, 1000 * MS)  # another one's word says nothing of her
    assert lease.command(ANNA, False, 600 * MS + LET_GO_NS) == "granted"


def test_a_word_heard_after_a_standstill_is_not_taken_for_one_of_later(lease: DriverLease[int]) -> None:
    lease.listen(0)
    lease.command(ANNA, False, 0)
    lease.stop(BEN, 0)
    back_ns = 60_000 * MS
    lease.hear_holding(ANNA, back_ns)  # before anybody has noticed that the process stood still
    for now_ns in range(back_ns, back_ns + LET_GO_NS, 50 * MS):
        lease.listen(now_ns)
    assert lease.command(ANNA, False, back_ns + LET_GO_NS) == "granted"
