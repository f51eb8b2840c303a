"""`make bench` and `make results`: what is run, what is kept, what a published figure must be, and the page of them.

The programs run in a small repository of its own, with benchmarks made up for this, so that its commits are ours.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.paths import ROOT

PROGRAMS = ("__init__", "result", "results_page", "run_suite", "suite")
BENCHMARK = """
import argparse, sys
from pathlib import Path
from PACKAGE.result import Figure, Run, add_results_option, share
parser = argparse.ArgumentParser()
add_results_option(parser, "made_up")
options, others = parser.parse_known_args()
run = Run.begin()
with Path("runs.log").open("a") as log:
    log.write(Path(sys.argv[0]).stem + "\\n")
print("printed by", Path(sys.argv[0]).stem, *others)
run.write(options.results, [
    Figure("longest error", 3.25, "ms", at_most=5, of=40),
    Figure("shortest rest", 1.0, "s", at_least=2),
    Figure("weight", 1234.5, "kg"),
    Figure("nothing to measure it on", None, "s", at_most=1),
    share("right answers", 3999, 4000, at_least=99),
])
sys.exit(EXIT_CODE)
""".replace("PACKAGE", "benchmarks")


class MadeUpRepository:
    """A repository with these programs and benchmarks that only say that they ran."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "benchmarks").mkdir()
        for name in PROGRAMS:
            shutil.copy(ROOT / "benchmarks" / f"{name}.py", folder / "benchmarks")
        self.names: set[str] = set(re.findall(r'Benchmark\(\s*"(\w+)"', self.read("benchmarks/suite.py")))
        for module in re.findall(r'"((?:bench|check)_\w+|places|slam_studies)",', self.read("benchmarks/suite.py")):
            self.write(f"benchmarks/{module}.py", BENCHMARK.replace("EXIT_CODE", "0"))
        self.write(".gitignore", "benchmarks/results/\nruns.log\n__pycache__/\n")
        self.git("init", "--quiet")
        self.commit()

    def read(self, path: str) -> str:
        return (self.folder / path).read_text()

    def write(self, path: str, text: str) -> None:
        (self.folder / path).write_text(text)

    def git(self, *arguments: str) -> str:
        who = {f"GIT_{who}_{what}": "test@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        done = subprocess.run(
            ["git", *arguments], cwd=self.folder, env=os.environ | who, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    def commit(self) -> str:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", "made up")
        return self.git("rev-parse", "--short=9", "HEAD")

    def run(self, module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.run(
            [sys.executable, "-m", f"benchmarks.{module}", *arguments],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=60,
        )

    def result(self, name: str) -> dict[str, Any]:
        document: dict[str, Any] = json.loads(self.read(f"docs/results/{name}.json"))
        return document

    @property
    def num_runs(self) -> int:
        return len(self.read("runs.log").splitlines()) if (self.folder / "runs.log").exists() else 0


@pytest.fixture
def repository(tmp_path: Path) -> MadeUpRepository:
    return MadeUpRepository(tmp_path)


def test_what_every_benchmark_prints_is_kept(repository: MadeUpRepository) -> None:
    done = repository.run("run_suite", "--quick")
    assert done.returncode == 0, done.stderr
    printed = {path.stem: path.read_text() for path in (repository.folder / "benchmarks/results/quick").glob("*.txt")}
    assert printed["clock"] == "printed by bench_clock --runs 20\n"
    left_out = set(re.findall(r"^== left out: (\w+):", done.stdout, re.MULTILINE))
    assert printed.keys() | left_out == repository.names and not printed.keys() & left_out
    assert {"stop", "page", "slam_speed", "demo"} <= left_out
    assert not (repository.folder / "docs").exists()
    assert "longest error" in repository.read("benchmarks/results/quick/results.md")


def test_one_that_fails_is_named_and_the_others_still_run(repository: MadeUpRepository) -> None:
    repository.write("benchmarks/bench_fuzz.py", BENCHMARK.replace("EXIT_CODE", "3"))
    done = repository.run("run_suite", "--only", "fuzz", "hijack")
    assert done.returncode == 1 and "run_suite: failed: fuzz\n" in done.stderr
    assert (repository.folder / "benchmarks/results/hijack.json").exists()


def test_a_published_result_says_where_it_comes_from(repository: MadeUpRepository) -> None:
    (repository.folder / "docs").mkdir()
    commit = repository.git("rev-parse", "--short=9", "HEAD")
    done = repository.run("run_suite", "--publish", "--only", "clock", "stop")
    assert done.returncode == 0, done.stderr
    result = repository.result("clock")
    assert result["command"] == "python -m benchmarks.bench_clock --runs 1000"
    assert (result["commit"], result["clean"]) == (commit, True)
    assert {"date", "cpu", "cores", "load", "seconds"} <= result.keys()
    assert [figure["met"] for figure in result["figures"]] == [True, False, None, False, True]
    rows = [line for line in repository.read("docs/results.md").splitlines() if "bench_clock" in line]
    cells = [[cell.strip() for cell in row.strip("|").split("|")][:3] for row in rows]
    assert cells == [
        ["shortest rest", "1 s", "≥ 2: **not met**"],
        ["weight", "1234 kg", "–"],
        ["nothing to measure it on", "–", "≤ 1: **not met**"],
        ["bench_clock", "longest error 3.25 ms (n = 40) [≤ 5]; right answers 99.9 % (3999 of 4000) [≥ 99]", "all met"],
    ]
    assert all(commit in row for row in rows)
    assert "Not measured yet at a commit of this history: `link`" in repository.read("docs/results.md")


def test_what_was_measured_with_the_present_code_is_not_measured_again(repository: MadeUpRepository) -> None:
    (repository.folder / "docs").mkdir()
    repository.run("run_suite", "--publish", "--only", "clock", "fuzz")
    assert repository.num_runs == 2
    repository.commit()  # of the results and the page: the code is the same
    again = repository.run("run_suite", "--publish", "--only", "clock", "fuzz")
    assert again.returncode == 0 and repository.num_runs == 2
    assert "== left out: clock: measured with this code already" in again.stdout
    repository.write("benchmarks/bench_fuzz.py", BENCHMARK.replace("EXIT_CODE", "0 "))
    commit = repository.commit()
    repository.run("run_suite", "--publish", "--only", "clock", "fuzz")
    assert repository.num_runs == 4 and repository.result("clock")["commit"] == commit


def test_a_result_of_other_arguments_does_not_count_as_done(repository: MadeUpRepository) -> None:
    (repository.folder / "docs/results").mkdir(parents=True)
    results = str(repository.folder / "docs/results/clock.json")
    repository.run("bench_clock", "--runs", "5", "--results", results)
    assert repository.result("clock")["command"] == "python -m benchmarks.bench_clock --runs 5"
    repository.run("run_suite", "--publish", "--only", "clock")
    assert repository.result("clock")["command"] == "python -m benchmarks.bench_clock --runs 1000"


def test_changed_code_publishes_nothing(repository: MadeUpRepository) -> None:
    (repository.folder / "docs/results").mkdir(parents=True)
    repository.write("benchmarks/bench_clock.py", BENCHMARK.replace("EXIT_CODE", "0  "))
    refused = repository.run("run_suite", "--publish", "--only", "clock")
    assert refused.returncode == 1 and "commit the code first" in refused.stderr and repository.num_runs == 0
    repository.run("bench_clock", "--results", str(repository.folder / "docs/results/clock.json"))
    assert repository.result("clock")["clean"] is False
    page = repository.run("results_page")
    assert page.returncode == 1 and "clock.json: the code that ran was not that of commit" in page.stderr


def test_a_file_that_is_no_result_is_refused_by_name(repository: MadeUpRepository) -> None:
    (repository.folder / "docs/results").mkdir(parents=True)
    repository.write("docs/results/clock.json", '{"command": "python -m benchmarks.bench_clock"}')
    refused = repository.run("results_page")
    assert refused.returncode == 1 and "clock.json: " in refused.stderr
    repository.run("bench_clock", "--results", str(repository.folder / "docs/results/clock.json"))
    (repository.folder / "docs/results/clock.json").rename(repository.folder / "docs/results/nobody.json")
    refused = repository.run("results_page")
    assert refused.returncode == 1 and "nobody.json: benchmarks/suite.py has no benchmark" in refused.stderr


def test_options_that_only_place_files_are_not_part_of_the_command(repository: MadeUpRepository) -> None:
    (repository.folder / "docs/results").mkdir(parents=True)
    results = str(repository.folder / "docs/results/clock.json")
    inside = str(repository.folder / "data")
    repository.run("bench_clock", inside, "--rows", "/elsewhere/rows", "--out=/elsewhere/out", "--results", results)
    assert repository.result("clock")["command"] == "python -m benchmarks.bench_clock data"


def test_no_benchmark_is_forgotten() -> None:
    suite = (ROOT / "benchmarks" / "suite.py").read_text()
    scripts = [path.stem for path in (ROOT / "benchmarks").glob("bench_*.py")]
    assert len(scripts) > 10
    for script in [*scripts, "places", "check_robot_wheels", "slam_studies"]:
        assert f'"{script}"' in suite, f"neither `make bench` nor `make results` runs {script}"


def test_every_benchmark_writes_its_figures(tmp_path: Path) -> None:
    results = tmp_path / "clock.json"
    command = [sys.executable, "-m", "benchmarks.bench_clock", "--runs", "1", "--results", str(results)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    assert [figure["met"] for figure in json.loads(results.read_text())["figures"]] == [True, True]
    for path in (ROOT / "benchmarks").glob("bench_*.py"):
        assert re.search(r"\b(run|this_run)\.write\(", path.read_text()), f"{path.name} writes no results"
