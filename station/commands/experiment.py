"""`station experiment`: two navigations, matched and judged, with a report to look at."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from shared.errors import ConfigError
from station.commands.match_report import finish
from station.commands.options import AlignBy, check_out_folder, overridden
from station.commands.progress import working
from station.commands.results_folder import naming_replaced
from station.commands.slam import given_state, run_with_progress
from station.datasets import Dataset
from station.experiments.experiment import Experiment, Story, run_experiment
from station.experiments.inputs import FrameRange, Input, open_input
from station.experiments.presets import Preset, SlamChoice, find_preset, make_dataset
from station.experiments.report import write_experiment
from station.files.navigation_folder import check_navigation_folder, save_navigation
from station.model.navigation import Navigation
from station.places.making.config import PlacesConfig, ThesisConfig
from station.slam.backend import SlamBackend
from station.slam.backends import make_backend

AS_THESIS = "as-thesis"  # folder in `out`: a preset that is run as the thesis did it, too


def register(app: typer.Typer) -> None:
    app.command()(experiment)


def experiment(
    out: Annotated[Path, typer.Option("--out", help="Folder for results.json, report.html and figures.")],
    navigation1: Annotated[
        Path | None, typer.Option(help="First navigation: a dataset, or a folder written by `station slam`.")
    ] = None,
    navigation2: Annotated[Path | None, typer.Option(help="Second navigation, likewise.")] = None,
    frames1: Annotated[str | None, typer.Option(help="Frames of the first dataset, such as 0-398.")] = None,
    frames2: Annotated[str | None, typer.Option(help="Frames of the second dataset.")] = None,
    truth1: Annotated[Path | None, typer.Option(help="Dataset with the true poses of a finished navigation 1.")] = None,
    truth2: Annotated[Path | None, typer.Option(help="Dataset with the true poses of a finished navigation 2.")] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            help="I, II, III: the thesis' experiments; I-thesis: I with its settings. --seed chooses the world."
        ),
    ] = None,
    euroc: Annotated[Path | None, typer.Option(help="EuRoC V1_02 folder: path and IMU of preset I.")] = None,
    backend: Annotated[
        str | None,
        typer.Option(
            "--backend",
            help="SLAM backend for datasets: auto, ukf, smoothing, sfm, mono; without it the preset's, else sfm.",
        ),
    ] = None,
    mode: Annotated[
        Literal["thesis", "default"] | None,
        typer.Option(help="Of clustering and matching; without it default, thesis for the preset I-thesis."),
    ] = None,
    landmarks: Annotated[
        Literal["default", "thesis"] | None,
        typer.Option(help="thesis: keep each landmark as it first entered the filter (ukf)."),
    ] = None,
    initial_state: Annotated[
        Literal["own", "given"] | None,
        typer.Option(help="given: start from the dataset's true state instead of by itself (ukf)."),
    ] = None,
    eps: Annotated[float | None, typer.Option(help="Thesis mode: DBSCAN's eps, m or normalised [0.3].")] = None,
    min_pts: Annotated[int | None, typer.Option(help="Thesis mode: DBSCAN's MinPts [11].")] = None,
    inlier_ratio: Annotated[float | None, typer.Option(help="Thesis mode: share of pairs kept [0.75].")] = None,
    step: Annotated[int, typer.Option(help="Use every step-th frame of the datasets.")] = 1,
    align_by: AlignBy = "both",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    threads: Annotated[int, typer.Option(help="Threads for mapping; 1 for repeatable runs, -1 for all cores.")] = -1,
    title: Annotated[str, typer.Option(help="Heading of the report.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print results.json on stdout.")] = False,
) -> None:
    """Map one navigation, find its places again in another, and judge the matches where true poses were recorded."""
    check_out_folder(out)
    ranges = FrameRange.parse(frames1, "--frames1"), FrameRange.parse(frames2, "--frames2")
    chosen = None if preset is None else find_preset(preset, seed, euroc)
    if chosen is not None and (navigation1 is not None or navigation2 is not None):
        raise ConfigError("--preset makes its own navigations; leave --navigation1 and --navigation2 out")
    story, thesis, choice = Story(title=title), ThesisConfig(), SlamChoice("sfm")
    if chosen is not None:
        story, thesis, choice, ranges = chosen.story, chosen.thesis, chosen.slam, chosen.frames
        mode = mode or chosen.mode
    thesis = overridden(thesis, eps=eps, min_pts=min_pts, inlier_ratio=inlier_ratio)
    choice = overridden(choice, backend=backend, landmarks=landmarks, initial_state=initial_state)
    config = PlacesConfig(mode or "default", thesis, align_by)

    if chosen is not None:
        navigation1, navigation2 = make_datasets(chosen, out / "data")
    elif navigation1 is None or navigation2 is None:
        raise ConfigError("--navigation1 and --navigation2 are needed: two datasets or navigation folders; or --preset")
    assert navigation1 is not None and navigation2 is not None
    inputs = [
        open_input(path, frames, truth, step=step)
        for path, frames, truth in zip((navigation1, navigation2), ranges, (truth1, truth2), strict=True)
    ]
    if (truth1 or truth2) and not all(opened.truth for opened in inputs):
        raise ConfigError("judging needs the true poses of both navigations; give --truth1 and --truth2, or neither")
    story = story if story.title else replace(story, title=f"{navigation1.name} against {navigation2.name}")
    done = perform(inputs, choice, config, story, seed, threads, out)
    if chosen is not None and chosen.as_thesis:
        theirs = find_preset(chosen.as_thesis, seed, euroc)
        folder = out / AS_THESIS
        beside = perform(
            inputs, theirs.slam, PlacesConfig(theirs.mode, theirs.thesis), theirs.story, seed, threads, folder
        )
        write_experiment(beside, folder)
        done = replace(done, as_thesis=beside)
    finish(done, out, as_json)


def perform(
    inputs: list[Input], choice: SlamChoice, config: PlacesConfig, story: Story, seed: int, threads: int, out: Path
) -> Experiment:
    """Reconstruct what is no navigation yet, match, and judge; navigations made now are kept in `out`."""
    seconds: dict[str, float] = {}
    first, second = reconstruct(inputs, choice, seed, threads, out, seconds)
    truths = (inputs[0].truth, inputs[1].truth)
    with working("clustering Navigation1 into places") as bar:
        done = run_experiment(first, second, config, truths=truths, seed=seed, story=story, say=bar.step)
    done.seconds.update(seconds)
    return done


def reconstruct(
    inputs: list[Input], choice: SlamChoice, seed: int, threads: int, out: Path, seconds: dict[str, float]
) -> list[Navigation]:
    """The navigations of all inputs; those made now are kept in `out`, so that other settings need no new ones.

    Backends are made for all before the first one runs: what they refuse is said at once.
    """
    backends = {}
    for number, opened in enumerate(inputs, start=1):
        if isinstance(opened.source, Dataset):
            check_navigation_folder(out / f"navigation{number}")
            backends[number] = backend_for(opened.source, choice, seed, threads)
    navigations = []
    for number, opened in enumerate(inputs, start=1):
        start = time.perf_counter()
        if isinstance(opened.source, Dataset):
            made = run_with_progress(backends[number], opened.source, threads)
            made = replace(made, id=f"{opened.path.resolve().name}-{made.id}")
            folder = out / f"navigation{number}"
            with naming_replaced(folder, "the navigation"):
                save_navigation(made, folder)
            navigations.append(made)
        else:
            navigations.append(opened.source)
        seconds[f"navigation{number}"] = time.perf_counter() - start
    return navigations


def backend_for(data: Dataset, choice: SlamChoice, seed: int, threads: int) -> SlamBackend:
    """A fresh backend for a dataset. Raises DataError where it shall start from a true state that is not there."""
    given = given_state(data) if choice.initial_state == "given" else None
    return make_backend(choice.backend, data.calibration, seed, threads, data.intrinsics_known, choice.landmarks, given)


def make_datasets(preset: Preset, folder: Path) -> tuple[Path, Path]:
    """The two datasets of a preset; one where both navigations are parts of one dataset."""
    first, second = preset.navigations
    with working("simulating the first navigation") as bar:
        made = make_dataset(first, folder / "dataset1")
        if first == second:
            return made, made
        bar.step("simulating the second navigation")
        return made, make_dataset(second, folder / "dataset2")
