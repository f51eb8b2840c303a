"""When a station believes that a robot does not hear it: not from what a stall of the network held back."""

from __future__ import annotations

from station.robots.link_state import UNHEARD_AFTER_NS, UNHEARD_FOR_NS, Hearing

SECOND = 1_000_000_000


def test_a_burst_after_a_stall_is_no_sign_but_a_robot_that_speaks_on_without_answering_is() -> None:
    hearing, now = Hearing(), 100 * SECOND
    hearing.note_answer(now)
    now += 5 * SECOND  # a stall; then everything at once, the answers to heartbeats last
    for _ in range(40):
        hearing.note_message(now)
    assert not hearing.is_lost(now + UNHEARD_FOR_NS // 2)
    hearing.note_answer(now)
    step = UNHEARD_AFTER_NS // 10
    for k in range(30):
        hearing.note_message(now + k * step)
        assert not hearing.is_lost(now + k * step) or k * step >= UNHEARD_AFTER_NS + UNHEARD_FOR_NS
    assert hearing.is_lost(now + 30 * step)


def test_what_waited_through_a_stall_may_take_a_slow_computer_its_time() -> None:
    hearing, now = Hearing(), 100 * SECOND
    hearing.note_message(now)
    hearing.note_answer(now)
    now += 5 * SECOND
    for k in range(40):  # slower than the bound for robots that speak on; then the answers
        hearing.note_message(now + k * UNHEARD_FOR_NS // 20)
        assert not hearing.is_lost(now + k * UNHEARD_FOR_NS // 20)
    for k in range(40, 100):
        hearing.note_message(now + k * UNHEARD_FOR_NS // 20)
    assert hearing.is_lost(now + 5 * UNHEARD_FOR_NS)
