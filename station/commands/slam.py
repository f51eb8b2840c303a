"""`station slam`: one navigation from recorded data."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
import typer

from shared.errors import DataError
from station.commands.options import check_out_folder
from station.commands.progress import working
from station.commands.results_folder import naming_replaced
from station.datasets import Dataset, open_dataset
from station.files.navigation_folder import check_navigation_folder, save_navigation
from station.model.navigation import Navigation
from station.slam.backend import SlamBackend
from station.slam.backends import make_backend
from station.slam.run import run_backend
from station.slam.ukf.start.starter import GivenState
from station.workers.repeatable import repeatable


def register(app: typer.Typer) -> None:
    app.command()(slam)


def slam(
    dataset: Annotated[Path, typer.Argument(help="ASL/EuRoC folder, folder of images, video or MCAP recording.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write the navigation into.")],
    backend: Annotated[
        str, typer.Option("--backend", help="sfm, ukf, smoothing, mono, or auto: what suits the robot.")
    ] = "sfm",
    first: Annotated[int | None, typer.Option(help="Number of the first frame to use.")] = None,
    last: Annotated[int | None, typer.Option(help="Number of the last frame to use.")] = None,
    step: Annotated[int, typer.Option(help="Use every step-th frame.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    threads: Annotated[int, typer.Option(help="Threads for mapping; 1 for repeatable runs, -1 for all cores.")] = -1,
    landmarks: Annotated[
        Literal["default", "thesis"],
        typer.Option(help="thesis: keep each landmark as it first entered the filter (ukf)."),
    ] = "default",
    initial_state: Annotated[
        Literal["own", "given"],
        typer.Option(help="given: start from the dataset's true state instead of by itself (ukf)."),
    ] = "own",
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as one JSON object on stdout.")] = False,
) -> None:
    """Reconstruct trajectory and landmarks of one recorded navigation."""
    check_out_folder(out)
    check_navigation_folder(out)
    data = open_dataset(dataset, first, last, step)
    if not data.has_images:
        raise DataError(f"{dataset} holds no camera images; choose a dataset with images")
    given = given_state(data) if initial_state == "given" else None
    running = make_backend(backend, data.calibration, seed, threads, data.intrinsics_known, landmarks, given)
    nav = run_with_progress(running, data, threads)
    with naming_replaced(out, "the navigation"):
        save_navigation(nav, out)
    if as_json:
        print(json.dumps({"out": str(out), **msgspec.to_builtins(nav.report)}, default=str))
    else:
        print(summary(nav, out))


def given_state(data: Dataset) -> GivenState:
    """The dataset's true state at its first frame. Raises DataError where the truth has no velocity and biases."""
    truth = data.truth
    if truth is None or truth.v_world is None or truth.gyro_bias is None or truth.accel_bias is None:
        raise DataError(f"{data.path} has no true velocity and biases; leave --initial-state at own")
    camera = data.calibration.camera
    # The filter's state is of the frame's middle row, by the IMU's clock.
    late_s = 0.0 if camera is None else camera.middle_row_shift_s
    i = int(np.argmin(np.abs(truth.t_robot_ns - (data.frame_times_ns[0] + round(1e9 * late_s)))))
    T = truth.T_world_body[i]
    return GivenState(
        int(truth.t_robot_ns[i]), T[:3, :3], truth.v_world[i], T[:3, 3], truth.gyro_bias[i], truth.accel_bias[i]
    )


def run_with_progress(backend: SlamBackend, data: Dataset, threads: int) -> Navigation:
    """Run over a dataset with a progress bar on stderr; without one where stderr is no terminal.

    As a station does: with more threads for small matrices, `mono` and the filter take many times the processor time.
    """
    with working(f"opening {data.path.name}") as bar, repeatable(threads):
        bar.step("reading frames", len(data.frame_times_ns))
        return run_backend(
            backend, data.events(), lambda update: bar.advance(update.message), lambda: bar.step("making the map")
        )


def summary(nav: Navigation, out: Path) -> str:
    """What a person wants to know of a navigation, in a few lines."""
    report = nav.report
    scale = "metres" if nav.is_metric else "arbitrary scale"
    lines = [
        f"{report.landmarks} landmarks, {len(nav.trajectory)} poses, {len(nav.keyframes)} keyframes ({scale}, "
        f"{'gravity-aligned' if nav.is_gravity_aligned else 'gravity unknown'})",
        f"{report.duration_s:.1f} s of driving in {report.wall_s:.1f} s",
        *report.messages,
        f"written to {out}",
    ]
    return "\n".join(lines)
