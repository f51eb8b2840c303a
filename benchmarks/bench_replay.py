"""The same recording replayed again and again, on one thread and on two: are trajectory, map and answers the same bits?

    python -m benchmarks.bench_replay                                  # a simulated drive, made first
    python -m benchmarks.bench_replay RECORDING.mcap --backends ukf    # or a recording, or any other dataset

Each replay is a process of its own (`station replay --json`). Exit code 1 when two of one backend differ. Every one is
a line of a file; started again with the same code it goes on where it ended.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.result import FOLDER, RESULTS_HELP, Run, share, work_folder

HASHES = ("trajectory", "map", "answers")


def simulated_drive(world: str, seed: int) -> Path:
    """The mapping drive of a demo's flat as a dataset; made once."""
    from robot.simulation.atlas import default_cache_dir
    from robot.simulation.config import SimulationConfig
    from robot.simulation.recording import record_drive
    from robot.simulation.routes import plan_route
    from robot.simulation.worlds import make_world

    folder = work_folder() / "drives" / f"replay-{world}-{seed}"
    if not folder.is_dir():
        settings = SimulationConfig()
        flat = make_world(world, seed, settings)
        plan = plan_route(flat, "mapping", seed, settings.body.radius_m)
        scratch = folder.with_suffix(".part")
        shutil.rmtree(scratch, ignore_errors=True)
        done = record_drive(flat, plan, settings, seed, scratch, default_cache_dir())
        scratch.rename(folder)
        print(f"{folder.name}: {done.frames} pictures, {done.duration_s:.0f} s, {done.path_m:.1f} m", flush=True)
    return folder


def replay(dataset: Path, backend: str, threads: int, last: int) -> dict[str, object]:
    """What one replay says."""
    command = [sys.executable, "-m", "station.main", "replay", str(dataset), "--backend", backend]
    command += ["--threads", str(threads), "--json"]
    if last:
        command += ["--last", str(last)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)} failed: {done.stderr.strip()[-2000:]}")
    said: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return said


def main(
    dataset: Annotated[
        Path | None, typer.Argument(help="Recording or dataset; without it a drive is simulated.")
    ] = None,
    world: Annotated[str, typer.Option(help="Of the simulated drive.")] = "small",
    seed: Annotated[int, typer.Option(help="Of the simulated flat and drive.")] = 1,
    backends: Annotated[str, typer.Option(help="Separated by commas.")] = "ukf,sfm",
    threads: Annotated[str, typer.Option(help="Of each replay, separated by commas.")] = "1,1,2",
    last: Annotated[int, typer.Option(help="Number of the last frame to use; 0: all.")] = 0,
    rows: Annotated[
        Path | None,
        typer.Option(help="A line per replay; what is in there is not done again. Usually in benchmarks/results/work."),
    ] = None,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "replay.json",
) -> None:
    """Print a line per replay."""
    run = Run.begin()
    out = rows or work_folder() / "replay.jsonl"
    path = dataset or simulated_drive(world, seed)
    out.parent.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    differing, figures = [], []
    for backend in backends.split(","):
        seen = []
        for number, count in enumerate(map(int, threads.split(","))):
            key = [str(path.resolve()), backend, count, number, last]
            earlier = next((line["said"] for line in done if line["key"] == key), None)
            begin_s = time.monotonic()
            said = earlier or replay(path, backend, count, last)
            seconds = time.monotonic() - begin_s
            if earlier is None:
                with out.open("a") as file:
                    file.write(json.dumps({"key": key, "seconds": round(seconds, 1), "said": said}) + "\n")
            seen.append(tuple(said[key] for key in HASHES))
            shown = ", ".join(f"{key} {str(said[key])[:12]}" for key in HASHES)
            print(
                f"{path.name} {backend} on {count}: {shown}; {said.get('places')} places, {said.get('answers_given')}"
                f" answers ({'done before' if earlier else f'{seconds:.0f} s'})",
                flush=True,
            )
        what = f"replays of {path.name} by {backend} on {threads} threads with the same trajectory, map and answers"
        figures.append(share(what, max(map(seen.count, seen)), len(seen), at_least=100))
        if len(set(seen)) != 1:
            differing.append(backend)
    run.write(results, figures)
    if differing:
        sys.exit(f"replays differ: {', '.join(differing)}")


if __name__ == "__main__":
    typer.run(main)
