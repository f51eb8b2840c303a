"""What a table of injected faults proves, and what it does not."""

from __future__ import annotations

from robot.devices.emulated.board import BoardEvent
from tests.support.stopping.chain import LineEntry
from tests.support.stopping.report import Judged, refusals, started_at_us, was_stopped, written_ns

GOOD = Judged("page closed", server_ms=200.0, pins_ms=250.0, commit="a")


def test_a_whole_table_of_one_commit_is_taken() -> None:
    assert refusals([GOOD, GOOD], {"page closed": 2}) == []


def test_mixed_commits_missing_kinds_too_few_and_not_judged_are_refused() -> None:
    other = Judged("page closed", server_ms=1.0, pins_ms=1.0, commit="b")
    broken = Judged("page closed", not_judged="RuntimeError: x", commit="a")
    assert "several commits" in refusals([GOOD, other], {"page closed": 2})[0]
    assert refusals([GOOD], {"page closed": 2, "page frozen": 1}) == [
        "page closed: 1 of 2 faults were judged",
        "page frozen: 0 of 1 faults were judged",
    ]
    assert refusals([GOOD, broken], {"page closed": 1}) == ["1 trials could not be judged"]
    assert GOOD.is_good and not broken.is_good


def test_motion_at_any_time_after_the_stop_is_seen() -> None:
    events = [BoardEvent(t, t * 1000, text) for t, text in ((10, "pins 500 500"), (20, "pins 0 0"), (700, "pins 1 0"))]
    assert started_at_us(events, 20) == 700
    assert started_at_us(events, 700) is None


def test_motors_that_a_busy_computer_stopped_before_a_fault_are_told_from_those_that_the_fault_stops() -> None:
    events = [BoardEvent(t, t * 1000, text) for t, text in ((10, "in 10"), (20, "pins 500 500"), (30, "in 11"))]
    assert was_stopped(events, 10, 30)
    assert not was_stopped(events, 10, 29)
    assert not was_stopped(events, 30, 40)
    assert was_stopped([BoardEvent(15, 15000, "pins 0 0")], 10, 20)


def test_a_stop_that_the_mega_has_taken_in_was_written_before() -> None:
    stop = LineEntry(before_ns=100, after_ns=160, what="stop")
    earlier, drive, taken = BoardEvent(1, 90, "in 11"), BoardEvent(2, 105, "in 10"), BoardEvent(3, 120, "in 11")
    assert written_ns(stop, [earlier, drive]) == 160
    assert written_ns(stop, [earlier, drive, taken]) == 120
