"""The stop bench's wall clock really jumps in the program it is given to, and no other clock does."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.stopping.clock import SettableClock

SLACK_S = 0.01  # floats, and a wall clock that is being adjusted

PROGRAM = """
import datetime, sys, time
for _ in sys.stdin:
    begun_s, walls = time.monotonic(), (time.time(), time.time_ns() / 1e9, datetime.datetime.now().timestamp())
    print(begun_s, time.monotonic(), *walls, flush=True)
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc: run firmware/install-deps.sh")
@pytest.mark.parametrize("shift_s", [86400.0, -86400.0, -0.75])
def test_a_running_programs_wall_clock_jumps_and_its_monotonic_clock_does_not(tmp_path: Path, shift_s: float) -> None:
    clock = SettableClock(tmp_path, "robot")
    environment = {**os.environ, **clock.environment}
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdin is not None and program.stdout is not None

        def ask() -> tuple[float, float, list[float]]:
            """Between which moments of the monotonic clock its wall clocks were read, and what they said."""
            assert program.stdin is not None and program.stdout is not None
            program.stdin.write("\n")
            program.stdin.flush()
            begun_s, ended_s, *walls_s = map(float, program.stdout.readline().split())
            return begun_s, ended_s, walls_s

        def check(shift_s: float) -> None:
            # In these orders a pause between two looks, however long on a busy machine, only widens what is allowed.
            least_s = time.time() - time.monotonic()
            before_s = time.monotonic()
            begun_s, ended_s, walls_s = ask()
            assert before_s <= begun_s <= ended_s <= time.monotonic()
            most_s = -time.monotonic() + time.time()
            for wall_s in walls_s:
                assert begun_s + least_s + shift_s - SLACK_S <= wall_s <= ended_s + most_s + shift_s + SLACK_S

        check(0.0)
        clock.jump(shift_s)
        check(shift_s)
        program.stdin.close()
    clock.close()
