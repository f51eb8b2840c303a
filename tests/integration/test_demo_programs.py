"""The demo's child programs end with it, also when a person presses Ctrl-C twice."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from shared.errors import RobotSystemError
from station.demo.processes import Programs

SCRIPT = """
import signal, sys
from pathlib import Path
from station.demo.processes import Programs
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job starts with it ignored
try:
    with Programs(Path(sys.argv[1])) as programs:
        programs.start("server", "http.server", "--bind", "127.0.0.1", "0")
        print(programs.pid("server"), flush=True)
        signal.pause()
except KeyboardInterrupt:
    pass
"""


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_programs_end_also_at_a_second_interrupt(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as demo:
        try:
            assert demo.stdout is not None
            server = int(demo.stdout.readline())
            assert is_alive(server)
            demo.send_signal(signal.SIGINT)
            demo.send_signal(signal.SIGINT)
            demo.wait(30)
        finally:
            demo.kill()
    assert not is_alive(server)


def test_a_program_that_ends_early_is_named_with_its_last_words(tmp_path: Path) -> None:
    with Programs(tmp_path) as programs:
        programs.start("server", "http.server", "--bind", "127.0.0.1", "no-port")
        with pytest.raises(RobotSystemError, match=r"server ended with code 2: .*invalid"):
            programs.wait("server", 30)
