"""The same recording replayed again and again, on one thread and on two: are trajectory, map and answers the same bits?

    python -m benchmarks.bench_replay                                  # a simulated drive, made first
    python -m benchmarks.bench_replay RECORDING.mcap --backends ukf    # or a recording, or any other dataset

Each replay is a process of its own (`station replay --json`). Exit code 1 when two of one backend differ.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

RESULTS = Path(__file__).parent / "results"
HASHES = ("trajectory", "map", "answers")


def simulated_drive(world: str, seed: int) -> Path:
    """The mapping drive of a demo's flat as a dataset; made once."""
    from robot.simulation.atlas import default_cache_dir
    from robot.simulation.config import SimulationConfig
    from robot.simulation.recording import record_drive
    from robot.simulation.routes import plan_route
    from robot.simulation.worlds import make_world

    folder = RESULTS / f"replay-{world}-{seed}"
    if not folder.is_dir():
        settings = SimulationConfig()
        flat = make_world(world, seed, settings)
        plan = plan_route(flat, "mapping", seed, settings.body.radius_m)
        done = record_drive(flat, plan, settings, seed, folder, default_cache_dir())
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
) -> None:
    """Print a line per replay."""
    path = dataset or simulated_drive(world, seed)
    differing = []
    for backend in backends.split(","):
        seen = []
        for count in map(int, threads.split(",")):
            begin_s = time.monotonic()
            said = replay(path, backend, count, last)
            seen.append(tuple(said[key] for key in HASHES))
            shown = ", ".join(f"{key} {str(said[key])[:12]}" for key in HASHES)
            print(
                f"{path.name} {backend} on {count}: {shown}; {said.get('places')} places, {said.get('answers_given')}"
                f" answers ({time.monotonic() - begin_s:.0f} s)",
                flush=True,
            )
        if len(set(seen)) != 1:
            differing.append(backend)
    if differing:
        sys.exit(f"replays differ: {', '.join(differing)}")


if __name__ == "__main__":
    typer.run(main)
