"""What workers are forked from: it holds the libraries, and no thread that a fork would leave a lock of behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from station.workers.worker import Outbox
from tests.support.paths import ROOT

LOOK = """
import os, sys
import station.workers.preload
threads = len(os.listdir("/proc/self/task"))
missing = [name for name in station.workers.preload.SERVANTS if name not in sys.modules]
before = set(sys.modules)
import station.main
print(threads, missing, sorted(sys.modules.keys() - before))
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc")
def test_workers_find_all_they_need_imported_and_no_thread_but_those_of_linear_algebra() -> None:
    # OpenBLAS ends its threads before a fork and starts them again after it (pthread_atfork); with one there are none.
    one = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    seen = subprocess.run(
        [sys.executable, "-c", LOOK], cwd=ROOT, env=one, capture_output=True, text=True, timeout=120, check=True
    )
    assert seen.stdout == "1 [] ['station.main']\n"


async def test_what_waits_too_long_goes_when_the_next_of_its_kind_comes_and_nothing_else_does() -> None:
    now_s = [0.0]
    outbox = Outbox({"frame": 10, "imu": 10}, {"frame": 5.0}, lambda: now_s[0])
    assert outbox.put("frame", ("f0",)) and outbox.put("imu", ("i0",)) and outbox.put("frame", ("f1",))
    now_s[0] = 5.5
    assert outbox.put("imu", ("i1",))
    assert not outbox.put("frame", ("f2",))
    assert outbox.dropped["frame"] == 2 and outbox.dropped["imu"] == 0
    assert [await outbox.take() for _ in range(3)] == [("i0",), ("i1",), ("f2",)]
