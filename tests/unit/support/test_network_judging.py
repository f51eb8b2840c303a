"""Commands and what became of them, judged on times that were made up."""

from __future__ import annotations

import math

import pytest

from tests.support.network.judging import (
    Hold,
    Told,
    delays_ms,
    moved_ns,
    numbered,
    silent_ms,
    stopped_ms,
    wrong_until_s,
)

MS = 1_000_000


def told(*words: tuple[float, int | None]) -> list[Told]:
    """(ms, number of the command; None: a stop)."""
    return [Told(round(t * MS), *((0.0, 0.0) if n is None else numbered(n, 0.2))) for t, n in words]


def hold(sent_ms: list[int], released_ms: int, cut_ms: int | None = None) -> Hold:
    cut_ns = None if cut_ms is None else cut_ms * MS
    return Hold(sent_ms[0] * MS, released_ms * MS, [t * MS for t in sent_ms], cut_ns)


@pytest.mark.parametrize("number", [0, 1, 17, 999])
@pytest.mark.parametrize("linear", [0.2, -0.2, 0.05])
def test_a_command_is_known_again_also_when_it_was_slowed_down(number: int, linear: float) -> None:
    linear, angular = numbered(number, linear)
    assert Told(0, linear / 3, angular / 3).number == number


def test_words_survive_the_log_and_half_a_word_is_none() -> None:
    words = told((1, 0), (2, None))
    log = b"".join(word.packed for word in words)
    assert Told.all_in(log) == words and Told.all_in(log[:-1]) == words[:1]


def test_a_command_counts_as_arrived_when_a_newer_one_is() -> None:
    words = told((20, 0), (130, 2), (170, None))
    assert delays_ms(hold([0, 50, 100], 150), words) == pytest.approx([20, 80, 30])


def test_letting_go_is_newer_than_all_commands_but_a_stop_before_it_is_not() -> None:
    words = told((10, 0), (100, None), (180, None))
    assert delays_ms(hold([0, 50], 150), words) == pytest.approx([10, 130])


def test_commands_that_nothing_follows_never_arrived() -> None:
    assert delays_ms(hold([0, 50], 150), told((10, 0))) == [pytest.approx(10), math.inf]


def test_commands_of_a_cut_network_are_no_delays() -> None:
    assert delays_ms(hold([0, 50], 150, cut_ms=60), told((10, 0))) == []


@pytest.mark.parametrize(
    ("begin", "end", "expected"), [(0, 100, 70), (20, 40, 20), (45, 55, 5), (90, 95, 5), (0, 10, 0), (0, 15, 5)]
)
def test_time_in_motion_is_that_between_drive_and_stop(begin: int, end: int, expected: int) -> None:
    words = told((10, 0), (30, 1), (50, None), (60, None), (70, 2))
    assert moved_ns(begin * MS, end * MS, words) == expected * MS


def test_stop_is_measured_from_letting_go_and_from_the_last_word() -> None:
    words = told((0, 0), (50, 1), (120, 2), (300, None), (310, None))
    assert stopped_ms(100 * MS, 400 * MS, words) == pytest.approx(200)
    assert silent_ms(100 * MS, 400 * MS, words) == pytest.approx(180)


def test_motors_that_stand_already_have_no_stop_and_such_as_turn_on_an_infinite_one() -> None:
    words = told((0, 0), (300, None), (310, None))
    assert stopped_ms(305 * MS, 400 * MS, words) is None and silent_ms(305 * MS, 400 * MS, words) is None
    assert stopped_ms(100 * MS, 200 * MS, words) == math.inf


def test_a_late_word_that_starts_the_motors_once_more_makes_the_stop_later() -> None:
    words = told((0, 0), (110, None), (200, 1), (260, None), (500, 0))
    assert stopped_ms(100 * MS, 400 * MS, words) == pytest.approx(160)
    assert stopped_ms(120 * MS, 400 * MS, words) == pytest.approx(140)
    assert stopped_ms(100 * MS, 600 * MS, words) == math.inf


@pytest.mark.parametrize(
    ("offsets", "wrong_s"),
    [([], None), ([(0.5, 1.9), (1.0, -2.0)], 0.0), ([(0.5, 3.0), (1.0, -2.5), (1.5, 0.1)], 1.0)],
    ids=["none is known", "never", "at first"],
)
def test_when_a_clock_was_wrong_the_last_time(offsets: list[tuple[float, float]], wrong_s: float | None) -> None:
    assert wrong_until_s(offsets, 2.0) == wrong_s
