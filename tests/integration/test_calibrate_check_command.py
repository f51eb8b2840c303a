"""`station calibrate check` given what it cannot use: one sentence, no file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import RECORDINGS

STATIC = RECORDINGS / "euroc_v1_01_static"


def check(*options: str | Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "station.main", "calibrate", "check", *map(str, options)]
    return subprocess.run(words, capture_output=True, text=True, timeout=120)


def test_a_recording_that_is_not_there_is_named(tmp_path: Path) -> None:
    done = check(tmp_path / "nothing", "--out", tmp_path / "found.yaml")
    assert done.returncode not in (0, 2)
    assert "nothing" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "found.yaml").exists()


@pytest.mark.skipif(not STATIC.exists(), reason="../shared/data/euroc_v1_01_static is not there")
def test_a_recording_at_rest_is_refused_with_the_remedy_and_nothing_is_written(tmp_path: Path) -> None:
    done = check(STATIC, "--out", tmp_path / "found.yaml")
    assert done.returncode == 2
    assert "carry it by hand" in done.stdout
    assert not (tmp_path / "found.yaml").exists()
