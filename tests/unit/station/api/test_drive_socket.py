"""How long a joystick's command holds, counted from when it was said."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from shared.messages import MAX_DRIVE_TTL_MS
from station.api.messages import DriveCommand
from station.api.robot import UNDATED_MS, life_left_ms
from station.robots.driving import LATE_FOR_NS, LateCommands


def order(ttl_ms: int, heard_ms: int | None) -> DriveCommand:
    return DriveCommand(seq=1, linear=0.1, angular=0.0, ttl_ms=ttl_ms, heard_ms=heard_ms)


@given(ttl_ms=st.integers(1, 1000), heard_ms=st.integers(0, 10**9), age_ms=st.integers(-1000, 10_000))
def test_nothing_holds_longer_than_the_bound_after_it_was_said(ttl_ms: int, heard_ms: int, age_ms: int) -> None:
    now_ms = heard_ms + age_ms
    left_ms = life_left_ms(order(ttl_ms, heard_ms), now_ms)
    assert left_ms <= min(ttl_ms, MAX_DRIVE_TTL_MS)
    if age_ms >= 0 and left_ms > 0:
        assert now_ms + left_ms <= heard_ms + min(ttl_ms, MAX_DRIVE_TTL_MS)


def test_a_command_that_was_held_up_for_its_whole_life_is_over() -> None:
    assert life_left_ms(order(250, 1000), 1249) == 1
    assert life_left_ms(order(250, 1000), 1250) == 0
    assert life_left_ms(order(1000, 1000), 1450) < 0


def test_a_command_that_does_not_say_when_holds_briefly() -> None:
    assert life_left_ms(order(1000, None), 5000) == UNDATED_MS
    assert life_left_ms(order(30, None), 5000) == 30
    assert life_left_ms(order(1000, 5001), 5000) == UNDATED_MS  # by the clock of a station before this one


MS = 1_000_000


def test_a_link_that_is_always_too_slow_is_told_again_and_again_while_it_is_used() -> None:
    late = LateCommands()
    told = [ms for ms in range(0, 2000, 50) if late.note_late(ms * MS)]
    assert told == [500, 1050, 1600]


def test_a_burst_after_a_standstill_is_not_a_slow_link() -> None:
    late = LateCommands()
    assert not any(late.note_late(1000 * MS + k) for k in range(60))
    late.note_fresh()
    assert not any(late.note_late(1000 * MS + LATE_FOR_NS + k) for k in range(60))


def test_one_late_command_now_and_then_is_not_a_slow_link() -> None:
    late = LateCommands()
    for second in range(10):
        assert not late.note_late(second * 1000 * MS)
        late.note_fresh()
    assert not any(late.note_late(second * 1000 * MS) for second in range(20, 30))  # each after a long silence
