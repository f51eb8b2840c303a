"""The stop bench's wall clock really jumps in the program it is given to, and no other clock does."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.stop_clock import SettableClock

PROGRAM = """
import datetime, sys, time
for _ in sys.stdin:
    print(time.time(), time.monotonic(), time.time_ns() // 10**9, datetime.datetime.now().timestamp(), flush=True)
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

        def ask() -> tuple[float, float, float, float]:
            assert program.stdin is not None and program.stdout is not None
            program.stdin.write("\n")
            program.stdin.flush()
            wall_s, mono_s, whole_s, date_s = map(float, program.stdout.readline().split())
            return wall_s - mono_s, mono_s, whole_s - mono_s, date_s - mono_s

        true_s = time.time() - time.monotonic()
        assert ask()[0] == pytest.approx(true_s, abs=0.2)
        clock.jump(shift_s)
        before_s = time.monotonic()
        wall_s, mono_s, whole_s, date_s = ask()
        assert wall_s == pytest.approx(true_s + shift_s, abs=0.2)
        assert date_s == pytest.approx(true_s + shift_s, abs=0.2)
        assert whole_s == pytest.approx(true_s + shift_s, abs=1.2)
        assert before_s <= mono_s <= time.monotonic()
        program.stdin.close()
    clock.close()
