"""Repeated lines are told once a minute; time is the test's."""

from __future__ import annotations

import subprocess
import sys

from shared.repetition import MAX_LINES, REPEAT_S, Repetition


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_a_repeated_line_is_told_once_a_minute_with_how_often_it_came() -> None:
    clock = Clock()
    repetition = Repetition(now_s=clock)
    assert [repetition.news("camera gone") for _ in range(3)] == ["camera gone", None, None]
    assert repetition.news("battery low") == "battery low"
    clock.now_s = REPEAT_S
    assert repetition.news("camera gone") == "camera gone (and 2 more times since it was told last)"
    clock.now_s = 2 * REPEAT_S
    assert repetition.news("camera gone") == "camera gone"


def test_lines_that_differ_only_in_a_number_can_have_one_key() -> None:
    repetition = Repetition(now_s=Clock())
    assert repetition.news("3 samples were lost", "lost") and not repetition.news("4 samples were lost", "lost")


def test_ever_other_lines_are_bounded_in_number_and_memory() -> None:
    clock = Clock()
    repetition = Repetition(limit=20, now_s=clock)
    assert sum(repetition.news(f"line {n}") is not None for n in range(10_000)) == 20
    clock.now_s = REPEAT_S
    assert repetition.news("line 10000") is not None
    unbounded = Repetition(limit=10**9, now_s=clock)
    for n in range(3 * MAX_LINES):
        unbounded.news(f"line {n}")
    assert len(unbounded._lines) == MAX_LINES


def test_the_log_holds_back_repeated_warnings_and_lets_no_line_forge_another() -> None:
    program = """
import logging
from shared.repetition import start_logging
start_logging(logging.INFO, "%(levelname)s: %(message)s")
log = logging.getLogger("x")
for _ in range(5):
    log.warning("robot: %s", "gone\\nINFO: connected\\x1b[2J")
    log.info("a step")
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    lines = run.stderr.splitlines()
    told = [line for line in lines if line.startswith("WARNING")]
    assert told == ["WARNING: robot: gone\ufffdINFO: connected\ufffd[2J"]
    assert lines.count("INFO: a step") == 5 and len(lines) == 6


def test_a_traceback_is_never_held_back() -> None:
    program = """
import logging
from shared.repetition import start_logging
start_logging(logging.INFO, "%(levelname)s: %(message)s")
for _ in range(3):
    try:
        raise ValueError("x")
    except ValueError:
        logging.getLogger("x").exception("connection failed")
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stderr.count("ValueError: x") == 3
