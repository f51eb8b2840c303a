"""Kill -9 at random moments while recording, saving, building, renaming, merging and migrating: is anything lost?

    python -m benchmarks.bench_crash --kills 600
    python -m benchmarks.bench_crash --fault full --kills 200    # or read-only: the disk, not the program (as root)
    python -m benchmarks.bench_crash --postgresql --kills 100    # the index in a PostgreSQL of its own

Every one has a seed, printed and kept in a line of a file; started again with the same code it goes on where it ended.
"""

from __future__ import annotations

import collections
import contextlib
import json
import re
import statistics
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.result import FOLDER, RESULTS_HELP, Figure, Run, share, work_folder
from tests.support.crashing.runs import RUNS_ON_BAD_DISK, SCENARIOS, run_once, run_two_stations
from tests.support.postgres import running_postgres

TWO_STATIONS = "two stations"


class Fault(StrEnum):
    """What goes wrong."""

    KILL = "kill"
    FULL = "full"
    READ_ONLY = "read-only"


def main(
    kills: Annotated[int, typer.Option(help="In all, over the scenarios in turn.")] = 600,
    seed: Annotated[int, typer.Option(help="Of the first kill; the next ones count up.")] = 1,
    only: Annotated[str, typer.Option(help="One scenario.")] = "",
    fault: Annotated[Fault, typer.Option(help="What happens at the random moment.")] = Fault.KILL,
    postgresql: Annotated[bool, typer.Option(help="Store scenarios on a PostgreSQL that is made for this.")] = False,
    rows: Annotated[
        Path | None,
        typer.Option(help="A line per kill; what is in there is not done again. Usually in benchmarks/results/work."),
    ] = None,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "crash.json",
) -> None:
    """Exit code 1 when anything was lost."""
    this_run = Run.begin()
    out = rows or work_folder() / "crash.jsonl"
    out.parent.mkdir(parents=True, exist_ok=True)
    kept = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    what = f"{fault} on postgresql" if postgresql else str(fault)
    done = [line for line in kept if line["fault"] == what and line["seed"] in range(seed, seed + kills)]
    seen = {(line["scenario"], line["seed"]) for line in done}
    names = [only] if only else [name for name in SCENARIOS if not (postgresql and name == "record")]
    names += [TWO_STATIONS] if fault is Fault.KILL and not only else []
    with runs(fault, postgresql=postgresql) as run, out.open("a") as file:
        for number in range(kills):
            name, kill_seed = names[number % len(names)], seed + number
            if (name, kill_seed) in seen:
                continue
            begin_s = time.monotonic()
            try:
                said, is_good = run(name, kill_seed), True
            except Exception as exc:
                said, is_good = f"{exc!r}", False
                traceback.print_exc()
            took_s = time.monotonic() - begin_s
            line = {"fault": what, "scenario": name, "seed": kill_seed, "good": is_good, "said": said}
            file.write(json.dumps(line) + "\n")
            file.flush()
            done.append(line)
            print(f"{name:12s} seed {kill_seed}: {'ok' if is_good else 'LOST'}, {said} ({took_s:.1f} s)", flush=True)
    summarise(what, done)
    this_run.write(results, figures(fault, done))
    if any(not line["good"] for line in done):
        raise SystemExit(1)


@contextlib.contextmanager
def runs(fault: Fault, *, postgresql: bool) -> Iterator[Callable[[str, int], str]]:
    """What does one run, of a scenario and a seed."""
    with contextlib.ExitStack() as stack:
        if fault is not Fault.KILL:
            yield RUNS_ON_BAD_DISK[fault]
            return
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="crash-")))
        server = stack.enter_context(running_postgres()) if postgresql else None

        def run(name: str, seed: int) -> str:
            database = server.fresh_database() if server else ""
            if name == TWO_STATIONS:
                return run_two_stations(scratch / "work", seed, database)
            return run_once(name, scratch / "work", seed, database)

        yield run


def figures(fault: Fault, done: list[dict[str, object]]) -> list[Figure]:
    """How many lost nothing, and what the longest missing end of a recording was."""
    name = {Fault.KILL: "kill -9 at a random moment", Fault.FULL: "disk full", Fault.READ_ONLY: "disk made read-only"}
    good = sum(bool(line["good"]) for line in done)
    found = [
        share(
            f"{name[fault]} while recording, saving, building, renaming, merging: nothing lost",
            good,
            len(done),
            at_least=100,
        )
    ]
    lost_s = [
        float(match[1])
        for line in done
        if line["scenario"] == "record" and (match := re.match(r"([\d.]+) ", str(line["said"])))
    ]
    if lost_s:
        found.append(
            Figure(
                f"{name[fault]}: most of a recording's end that was not written yet", max(lost_s), "s", of=len(lost_s)
            )
        )
    return found


def summarise(what: str, done: list[dict[str, object]]) -> None:
    """A line per scenario: how many, how many of them in the middle of work, what was lost."""
    counts = collections.Counter((line["scenario"], line["good"]) for line in done)
    for name in (*SCENARIOS, TWO_STATIONS):
        said = [str(line["said"]) for line in done if line["scenario"] == name]
        first = [float(match[1]) for text in said if (match := re.match(r"([\d.]+) ", text))]
        if not first:
            continue
        word = said[0].split(";")[0].partition(" ")[2]
        refused = sum("refused" in text for text in said)
        print(
            f"{what}: {name:12s} {counts[name, True]} without loss, {counts[name, False]} with;"
            f" median {statistics.median(first):g}, most {max(first):g} ({word})"
            + (f"; {refused} refused" if refused else "")
        )


if __name__ == "__main__":
    typer.run(main)
