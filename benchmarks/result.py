"""What a benchmark found, as a file: its figures, what was asked of them, and the code and machine they come from.

    run = Run.begin()  # before anything is measured
    ...
    run.write(options.results, [Figure("drift error, largest", 3.0, "ppm", at_most=20)])

docs/results.md is made of the files in docs/results/, which `make results` writes. What a benchmark started by hand
writes goes to benchmarks/results/, which git ignores.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "benchmarks" / "results"  # of what is started by hand
RESULTS_HELP = "Where the figures go, with the commit and the machine they come from."
# What can change a figure. Documents and tests cannot, so a result stays valid when only they change.
CODE = ("benchmarks", "firmware", "robot", "shared", "station", "tests/support", "pyproject.toml", "constraints.txt")
# Options that say where files are put; they change no figure and are left out of the command that is written down.
HOUSEKEEPING = ("--figure", "--json", "--out", "--results", "--rows", "--scratch", "--work")


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured quantity and the bound that it was held against."""

    what: str
    value: float | None  # None: there was nothing to measure it on
    unit: str = ""
    at_most: float | None = None
    at_least: float | None = None
    count: int | None = None  # of a share: this many of `of`
    of: int | None = None  # how many were tried
    note: str = ""  # in a few words: which ones failed, and why

    @property
    def is_met(self) -> bool | None:
        """None where nothing was asked. What could not be measured meets no bound."""
        if self.at_most is None and self.at_least is None:
            return None
        if self.value is None:
            return False
        is_low_enough = self.at_most is None or self.value <= self.at_most
        return is_low_enough and (self.at_least is None or self.value >= self.at_least)


def share(
    what: str, count: float, of: int, *, at_least: float | None = None, at_most: float | None = None, note: str = ""
) -> Figure:
    """`count` of `of` as a percentage; bounds are percentages too."""
    value = 100 * count / of if of else None
    return Figure(what, value, "%", at_most=at_most, at_least=at_least, count=round(count), of=of, note=note)


def failed_seeds(rows: Iterable[dict[str, Any]], reason: Callable[[dict[str, Any]], str]) -> str:
    """A figure's note: which of the rows by seed did not pass, and why."""
    return "; ".join(f"seed {row['seed']}: {' '.join(reason(row).split())}" for row in rows if not row["passed"])


@dataclass(frozen=True, slots=True)
class ResultFile:
    """What a result file holds."""

    command: str
    commit: str  # short hash
    code: str  # of the contents of CODE at that commit
    clean: bool  # the code that ran was the commit's
    date: str  # ISO, the day it ended
    cpu: str
    cores: int
    load: tuple[float, float]  # 1-minute load average when it began and when it ended
    seconds: float
    figures: tuple[Figure, ...]


@dataclass(frozen=True, slots=True)
class CodeState:
    """Which code is in the working tree."""

    commit: str  # "" outside a git repository
    code: str
    clean: bool

    @classmethod
    def of_now(cls) -> CodeState:
        commit = git("rev-parse", "--short=9", "HEAD")
        code = hashlib.sha256(git("ls-tree", "HEAD", "--", *CODE).encode()).hexdigest()[:12]
        return cls(commit, code, bool(commit) and not git("status", "--porcelain", "--", *CODE))


@dataclass(frozen=True, slots=True)
class Run:
    """A benchmark at work: what was so when it began."""

    command: str
    state: CodeState
    load: float
    begun_s: float

    @classmethod
    def begin(cls) -> Run:
        command = command_line(f"benchmarks.{Path(sys.argv[0]).stem}", sys.argv[1:])
        return cls(command, CodeState.of_now(), os.getloadavg()[0], time.monotonic())

    def write(self, path: Path, figures: Iterable[Figure]) -> None:
        """Write the result file; a run during which the code changed counts as one of changed code."""
        content = ResultFile(
            command=self.command,
            commit=self.state.commit,
            code=self.state.code,
            clean=self.state.clean and CodeState.of_now().code == self.state.code,
            date=datetime.date.today().isoformat(),
            cpu=cpu_model(),
            cores=os.cpu_count() or 0,
            load=(round(self.load, 1), round(os.getloadavg()[0], 1)),
            seconds=round(time.monotonic() - self.begun_s, 1),
            figures=tuple(figures),
        )
        document = asdict(content)
        document["figures"] = [_figure_document(figure) for figure in content.figures]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _figure_document(figure: Figure) -> dict[str, object]:
    document: dict[str, object] = {name: value for name, value in asdict(figure).items() if value not in (None, "")}
    value = figure.value
    document["value"] = None if value is None or not math.isfinite(value) else float(f"{value:.6g}")
    return document | {"met": figure.is_met}


def load(path: Path) -> ResultFile:
    """Read a result file. Raises ValueError, naming the file, where it is none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=ResultFile)
    except msgspec.DecodeError as exc:  # and its child for a wrong or missing field
        raise ValueError(f"{path.name}: {exc}") from exc


def add_results_option(parser: argparse.ArgumentParser, name: str) -> None:
    """`--results FILE`, as every benchmark has it."""
    parser.add_argument("--results", type=Path, default=FOLDER / f"{name}.json", help=RESULTS_HELP)


def work_folder() -> Path:
    """Where benchmarks keep what they go on from: a folder for each state of the code, so that none are mixed."""
    state = CodeState.of_now()
    return FOLDER / "work" / (state.code if state.clean else f"{state.code}-changed")


def rows_by_seed(kept: Path, seeds: Sequence[int], measure: Callable[[int], dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each seed: from the lines of this file, or measured and put there, so that a long run can be resumed.

    Each is printed.
    """
    kept.parent.mkdir(parents=True, exist_ok=True)
    done = {row["seed"]: row for row in map(json.loads, kept.read_text().splitlines())} if kept.exists() else {}
    for seed in seeds:
        if seed not in done:
            done[seed] = measure(seed)
            with kept.open("a") as file:
                file.write(json.dumps(done[seed]) + "\n")
        print(json.dumps(done[seed]), flush=True)
    return [done[seed] for seed in seeds]


def command_line(module: str, arguments: Sequence[str]) -> str:
    """The command as another one would type it at the root of the repository."""
    kept: list[str] = []
    is_value = False
    for argument in arguments:
        if is_value or argument in HOUSEKEEPING:
            is_value = not is_value
        elif argument.partition("=")[0] not in HOUSEKEEPING:
            kept.append(os.path.relpath(argument, ROOT) if argument.startswith("/") else argument)
    return shlex.join(["python", "-m", module, *kept])


def end_as_by_ctrl_c() -> None:
    """From now on SIGTERM, too, unwinds the stack, which ends what was started."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)


def cpu_model() -> str:
    """The processor's name as Linux tells it."""
    with Path("/proc/cpuinfo").open() as lines:
        return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")


def git(*arguments: str) -> str:
    """What git answers about this repository; "" where it cannot."""
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
    except FileNotFoundError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
