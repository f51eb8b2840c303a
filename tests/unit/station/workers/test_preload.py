"""What workers are forked from: it holds the libraries, and no thread that a fork would leave a lock of behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

LOOK = """
import os, sys
import station.workers.preload
threads = len(os.listdir("/proc/self/task"))
missing = [name for name in station.workers.preload.PROGRAMS if name not in sys.modules]
before = set(sys.modules)
drawing = "matplotlib" in before
import station.main
print(threads, missing, drawing, sorted(sys.modules.keys() - before))
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc")
def test_workers_find_all_they_need_imported_and_no_thread_but_those_of_linear_algebra() -> None:
    # OpenBLAS ends its threads before a fork and starts them again after it (pthread_atfork); with one there are none.
    one = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    seen = subprocess.run(
        [sys.executable, "-c", LOOK], cwd=ROOT, env=one, capture_output=True, text=True, timeout=120, check=True
    )
    # Matplotlib is none of it: a fifth of the imports' time, for a picture at the end of a calibration.
    assert seen.stdout == "1 [] False ['station.main']\n"
    assert seen.stderr == ""  # nor does a library complain at the end of what is kept for good
