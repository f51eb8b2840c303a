"""How long a joystick's command holds, counted from when it was said."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from shared.messages import MAX_DRIVE_TTL_MS
from station.api.messages import DriveCommand
from station.api.robot import UNDATED_MS, life_left_ms


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
