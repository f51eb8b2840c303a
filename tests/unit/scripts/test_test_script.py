"""`scripts/test.sh`: which tests it runs, and that none fails unseen; with stand-ins for the tools that it calls."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import COMPUTING
from tests.support.paths import ROOT

STAND_IN = """#!/bin/bash
echo "$(basename "$0") $*"
if [ "$(basename "$0")" = pytest ]; then case "$*" in *"$FAILING"*) exit 1 ;; esac; fi
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The script in a folder where every tool only says how it was called; pytest fails when it is given FAILING."""
    tools = [f".venv/bin/{name}" for name in ("ruff", "bandit", "mypy", "lint-imports", "python", "pytest")]
    for name in (*tools, "scripts/apt-need.sh", "scripts/open3d-need.sh", "firmware/install-deps.sh"):
        tool = tmp_path / name
        tool.parent.mkdir(parents=True, exist_ok=True)
        tool.write_text(STAND_IN)
        tool.chmod(0o755)
    shutil.copy(ROOT / "scripts" / "test.sh", tmp_path / "scripts")
    return tmp_path


def run(folder: Path, *arguments: str, failing: str = "nothing") -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"FAILING": failing, "TMPDIR": str(folder)}
    return subprocess.run(
        [folder / "scripts" / "test.sh", *arguments],
        env=environment, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def test_every_test_is_in_one_half(folder: Path) -> None:
    result = run(folder)
    assert result.returncode == 0, result.stderr
    assert [line for line in result.stdout.splitlines() if line.startswith("pytest")] == [
        "pytest -m not hardware and not computing --durations=15 tests/integration tests/e2e",
        "pytest -m not hardware and computing -p no:cacheprovider --durations=15 tests",
    ]
    folders = {path.relative_to(ROOT / "tests").parts[0] for path in (ROOT / "tests").glob("*/**/test_*.py")}
    assert folders == {"integration", "e2e", *COMPUTING}
    assert not list(folder.glob("tmp.*"))


@pytest.mark.parametrize("failing", ["and computing", "tests/e2e"])
def test_a_failure_in_either_half_fails_the_whole_and_both_are_shown(folder: Path, failing: str) -> None:
    result = run(folder, failing=failing)
    assert result.returncode == 1
    assert [line.split()[0] for line in result.stdout.splitlines()].count("pytest") == 2


def test_with_arguments_only_those_tests_are_run(folder: Path) -> None:
    result = run(folder, "tests/unit/shared")
    assert [line for line in result.stdout.splitlines() if line.startswith("pytest")] == [
        "pytest -m not hardware tests/unit/shared"
    ]
