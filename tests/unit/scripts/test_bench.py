"""`make bench` names every benchmark, keeps what each prints, and ends with 0 only when all did."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.paths import ROOT

STAND_IN = """#!/bin/sh
echo "$@"
case "$2" in *"{failing}"*) exit 3 ;; esac
"""


def bench(tmp_path: Path, quick: str, failing: str = "none fails") -> subprocess.CompletedProcess[str]:
    python = tmp_path / "python"
    python.write_text(STAND_IN.format(failing=failing))
    python.chmod(0o755)
    settings = {"BENCH_PYTHON": str(python), "BENCH_RESULTS": str(tmp_path / "results"), "QUICK": quick}
    return subprocess.run(
        [ROOT / "scripts" / "bench.sh"],
        env=os.environ | settings,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("quick", ["", "1"])
def test_what_every_benchmark_prints_is_kept(tmp_path: Path, quick: str) -> None:
    result = bench(tmp_path, quick)
    assert result.returncode == 0, result.stderr
    assert ((tmp_path / "results" / "clock.txt").read_text() == "-m benchmarks.bench_clock --runs 20\n") == bool(quick)
    kept = "".join(path.read_text() for path in (tmp_path / "results").glob("*.txt"))
    started = [line.removeprefix("== ").strip() for line in result.stdout.splitlines() if line.startswith("== ")]
    assert all(line in kept for line in started if not line.startswith("left out"))


def test_one_that_fails_is_named_and_the_others_still_run(tmp_path: Path) -> None:
    result = bench(tmp_path, "1", failing="bench_fuzz")
    assert result.returncode == 1 and "bench: failed: fuzz" in result.stderr
    assert (tmp_path / "results" / "current_place.txt").exists()


def test_no_benchmark_is_forgotten(tmp_path: Path) -> None:
    started = bench(tmp_path, "").stdout + (ROOT / "Makefile").read_text()
    scripts = [path.stem for path in (ROOT / "benchmarks").glob("bench_*.py")]
    assert len(scripts) > 10
    for script in [*scripts, "places", "check_robot_wheels"]:
        assert script in started, f"neither `make bench` nor a target of its own runs {script}"
    for own_target in ("bench_stop", "bench_page"):
        assert f"benchmarks.{own_target}" not in bench(tmp_path, "").stdout
