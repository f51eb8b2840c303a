"""`scripts/test.sh`: which tests it runs, and that none fails unseen; with stand-ins for the tools that it calls.

And `--share`, by which two of its processes share tests.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import COMPUTING
from tests.support.paths import ROOT

STAND_IN = """#!/bin/bash
echo "$(basename "$0") $*"
case "$(basename "$0") $*" in *"$FAILING"*) exit "$STATUS" ;; esac
"""

SCRIPTS = ("scripts/setup.sh", "scripts/apt-need.sh", "scripts/open3d-need.sh")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The script in a folder where every tool only says how it was called, and what is called with FAILING fails."""
    tools = [f".venv/bin/{name}" for name in ("ruff", "bandit", "mypy", "lint-imports", "python")]
    for name in (*tools, *SCRIPTS, "firmware/install-deps.sh"):
        tool = tmp_path / name
        tool.parent.mkdir(parents=True, exist_ok=True)
        tool.write_text(STAND_IN)
        tool.chmod(0o755)
    (tmp_path / "Makefile").write_text(".venv/.dev: ; @touch $@\n")
    for name in ("test.sh", "lint.sh"):
        shutil.copy(ROOT / "scripts" / name, tmp_path / "scripts")
    return tmp_path


def run(
    folder: Path, *arguments: str, failing: str = "nothing", status: int = 1, no_node: str = ""
) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {
        "FAILING": failing, "STATUS": str(status), "NO_NODE": no_node, "TMPDIR": str(folder),
    }  # fmt: skip
    return subprocess.run(
        [folder / "scripts" / "test.sh", *arguments],
        env=environment, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def of_pytest(result: subprocess.CompletedProcess[str]) -> list[str]:
    """What each run of pytest was told. It is a module: every worker that starts imports a program that is a file."""
    begin = "python -m pytest "
    return [line.removeprefix(begin) for line in result.stdout.splitlines() if line.startswith(begin)]


def test_every_test_is_in_one_of_five_processes(folder: Path) -> None:
    result = run(folder)
    assert result.returncode == 0, result.stderr
    said, begun = of_pytest(result), re.compile(r"--share \S+/begun")
    computing = "--durations=15 -m not hardware and computing BEGUN tests/golden tests/integration tests/e2e"
    computing += " tests/property tests/unit -p no:cacheprovider"
    assert [begun.sub("BEGUN", line) for line in said] == [
        "--durations=15 -m not hardware and not computing and not slow tests/integration/test_[!a-k]*.py",
        computing,
        "--durations=15 -p no:cacheprovider -m not hardware and not computing and slow tests/integration tests/e2e",
        "--durations=15 -p no:cacheprovider -m not hardware and not computing and not slow tests/e2e",
        computing,
        "--durations=15 -m not hardware and not computing and not slow tests/integration/test_[a-k]*.py"
        " -p no:cacheprovider",
    ]
    assert len({found[0] for line in said if (found := begun.search(line))}) == 1
    folders = {path.relative_to(ROOT / "tests").parts[0] for path in (ROOT / "tests").glob("*/**/test_*.py")}
    assert folders == {"integration", "e2e", *COMPUTING} and {"golden", "property", "unit"} == COMPUTING
    assert not list(folder.glob("tmp.*"))


@pytest.mark.parametrize(
    "failing", ["test_[!a-k]*.py", "test_[a-k]*.py", "computing and slow", "not slow tests/e2e", "tests/golden"]
)
def test_a_failure_in_any_of_them_fails_the_whole_and_all_are_shown(folder: Path, failing: str) -> None:
    result = run(folder, failing=failing)
    assert result.returncode == 1
    assert len(of_pytest(result)) == 6


def test_lint_begins_before_what_is_missing_is_installed_and_tests_come_after_it(folder: Path) -> None:
    at_once = "while [ ! -e linted ]; do sleep 0.01; done"  # or the test's time runs out
    for name, deed in ((".venv/bin/ruff", "touch linted"), ("scripts/open3d-need.sh", f"{at_once}; touch installed")):
        (folder / name).write_text(f"#!/bin/bash\n{deed}\n")
    (folder / ".venv/bin/python").write_text('#!/bin/bash\n[ "$1" != -m ] || [ -e installed ]\n')
    assert run(folder).returncode == 0


LINT = ("ruff format", "ruff check", "bandit", "mypy", "lint-imports", "python station/web/build_hook.py --check")


@pytest.mark.parametrize("failing", LINT)
def test_whatever_lint_finds_fails_the_whole_and_is_shown(folder: Path, failing: str) -> None:
    result = run(folder, failing=failing)
    assert result.returncode == 1
    assert any(line.startswith(failing) for line in result.stdout.splitlines())


def test_the_page_may_go_unchecked_only_where_it_is_said_that_there_is_no_node(folder: Path) -> None:
    refused = run(folder, failing=LINT[-1], status=2)
    assert refused.returncode == 2 and "set NO_NODE=1" in refused.stdout
    assert run(folder, failing=LINT[-1], status=2, no_node="1").returncode == 0
    assert run(folder, failing=LINT[-1], status=1, no_node="1").returncode == 1


def test_with_arguments_only_those_tests_are_run(folder: Path) -> None:
    result = run(folder, "tests/unit/shared")
    assert of_pytest(result) == ["-m not hardware tests/unit/shared"]


# The first file ends only when the second has begun, in a process that passed the first one by.
SHARED = """
import time
from pathlib import Path

def test_one(): note("{name} one")
def test_two(): note("{name} two")

def note(what):
    with (Path(__file__).parents[2] / "log").open("a") as log:
        log.write(what + "\\n")
    while "b one" not in (Path(__file__).parents[2] / "log").read_text():
        time.sleep(0.01)
    assert what != "c two"
"""


def test_of_two_processes_each_runs_the_files_that_the_other_has_not_begun(tmp_path: Path) -> None:
    unit, begun = tmp_path / "tests" / "unit", tmp_path / "begun"
    unit.mkdir(parents=True)
    begun.mkdir()
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path / "tests")
    for name in "abc":
        (unit / f"test_{name}.py").write_text(SHARED.format(name=name))
    command = [sys.executable, "-m", "pytest", "-q", "--rootdir", tmp_path, "--share", begun, "tests/unit"]
    both = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=60)[0] for process in both]
    assert sorted((tmp_path / "log").read_text().splitlines()) == [f"{x} {n}" for x in "abc" for n in ("one", "two")]
    assert sorted(process.returncode for process in both) == [0, 1], said  # one of them ran what fails


def test_after_a_file_of_the_other_process_tests_of_another_folder_run(tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    begun.mkdir()
    (begun / "unit-one-test_b.py").touch()
    for path in ("unit/one/test_a.py", "unit/one/test_b.py", "unit/two/test_c.py"):
        (tmp_path / "tests" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / path).write_text(f"def test_it(): assert {path.endswith(('a.py', 'c.py'))}\n")
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path / "tests")
    command = [sys.executable, "-m", "pytest", "-q", "--rootdir", tmp_path, "--share", begun, "tests/unit"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert said.returncode == 0 and "2 passed" in said.stdout, said.stdout
