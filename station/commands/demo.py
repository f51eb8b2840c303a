"""`station demo`: the whole system in one command, with a simulated robot."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from station.commands.options import Places
from station.config import check_backend


def register(app: typer.Typer) -> None:
    app.command()(demo)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def demo(
    once: Annotated[bool, typer.Option("--once", help="End by itself; exit code 0 when the place was right.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Which flat.")] = 1,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page and the API.")] = 8080,
    world: Annotated[str, typer.Option(help="Simulated world.")] = "small",
    backend: Annotated[
        str | None, typer.Option(help="SLAM: auto, ukf, smoothing, sfm or mono; without it the station's own.")
    ] = None,
    places: Places = "rooms",
    out: Annotated[Path, typer.Option(help="Folder for results.json, logs and data.")] = Path("demo"),
) -> None:
    """Simulated robot, robot-server and station: map, hijack, drive again, and name the place."""
    from station.demo.demo import DemoOptions, run_demo

    if backend is not None:
        check_backend(backend)
    begin = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begin:5.1f} s] {text}", flush=True)

    signal.signal(signal.SIGTERM, _interrupt)  # like Ctrl-C: the robot's motors stop before anything else ends
    try:
        passed = run_demo(DemoOptions(seed, once, port, world, backend, out, places), say)
    except KeyboardInterrupt:
        say("interrupted; everything is stopped")
        sys.exit(130)
    if once and not passed:
        sys.exit(1)
