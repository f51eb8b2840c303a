"""`station locate`: the live current place over recorded data, judged where true poses were recorded."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import DataError, DegenerateGeometry
from station.commands.answer_files import ANSWERS, SUMMARY, write_answers
from station.commands.map_store import MapArgument, open_map
from station.commands.options import Config, Data, check_out_folder
from station.commands.progress import Bar, working
from station.commands.results_folder import check_results_folder, write_results
from station.config import check_backend, load_config
from station.datasets import Dataset, open_dataset
from station.experiments.answer_figures import CALIBRATION, OVER_TIME, draw_answers
from station.experiments.answers import JudgedAnswers, frame_of_map, judge_recorded
from station.model.place_answer import HijackEvent, PlaceAnswer
from station.model.place_map import PlaceMap
from station.places.making.changes import without_hidden
from station.workers.replay import ReplayOptions, has_live_poses, locate_live


def register(app: typer.Typer) -> None:
    app.command("locate")(locate_command)


def locate_command(
    which: MapArgument,
    dataset: Annotated[Path, typer.Argument(help="MCAP recording, ASL/EuRoC folder, folder of images or video.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for answers.jsonl, summary.json and the figures.")],
    rate: Annotated[
        float | None,
        typer.Option("--rate", help="Pictures a second that are looked for; by default as the station's config says."),
    ] = None,
    map_truth: Annotated[
        Path | None,
        typer.Option(
            "--map-truth", help="Dataset that the map was made from: its true poses say where the map's frame lies."
        ),
    ] = None,
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            help="SLAM beside it: ukf, smoothing, sfm, mono (no poses in metres); auto: ukf where that can run.",
        ),
    ] = "auto",
    first: Annotated[int | None, typer.Option(help="Number of the first frame to use.")] = None,
    last: Annotated[int | None, typer.Option(help="Number of the last frame to use.")] = None,
    step: Annotated[int, typer.Option(help="Use every step-th frame.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 1,
    data: Data = None,
    config: Config = None,
    as_json: Annotated[bool, typer.Option("--json", help="End with the summary as one JSON object on stdout.")] = False,
) -> None:
    """Ask over recorded data, as the live station does, which place of a map the robot is at.

    Pictures, IMU and drive commands go through the live code, with the live SLAM beside it where the recording has an
    IMU and at least 5 pictures a second; no map is made. Where the recording has true poses, a "known" is right when
    the place is nearest to the true position, ties within 10 % included. Precision is the share of right ones, recall
    that of all answers with a true position. For that the map's frame must be known: from --map-truth, whose true poses
    are in the same world as the recording's; without it, it is fitted to the answers' own positions, a fifth of the
    time left out in turn, and an error that all answers share stays hidden. The summary's "truth" says which: map,
    answers, or none.
    """
    check_out_folder(out)
    check_results_folder(out, {ANSWERS, SUMMARY, OVER_TIME, CALIBRATION})
    check_backend(backend)
    options = ReplayOptions(backend, seed, rate_hz=load_config(config).localization.rate_hz if rate is None else rate)
    recorded = open_dataset(dataset, first, last, step)
    if not recorded.has_images:
        raise DataError(f"{dataset} holds no camera images; choose a dataset with images")
    mapping = _open_mapping(map_truth, recorded)
    with working("reading the map") as bar:
        place_map = without_hidden(open_map(which, data, config))
        if not place_map.places:
            raise DataError(f"{which} holds no place; make a map with places, or show one that is hidden")
        if mapping is not None:
            _check_mapping(place_map, mapping)  # what cannot work is said before minutes of it
        answers, hijacks = _locate(recorded, place_map, options, bar)
        bar.step("judging")
        judged = judge_recorded(answers, place_map, recorded, mapping)
        bar.step("drawing")
        _write(judged, hijacks, place_map, recorded, out)
    if as_json:
        print(json.dumps(judged.summary()))
    else:
        print(told(judged, hijacks, has_live_poses(recorded, backend), out))
    if recorded.truth is not None and judged.frame.source == "none":
        print(f"station: the answers are not judged: {judged.frame.why}; give --map-truth", file=sys.stderr)


def _open_mapping(path: Path | None, recorded: Dataset) -> Dataset | None:
    if path is None:
        return None
    if recorded.truth is None:
        raise DataError(f"{recorded.path} holds no true poses, so there is nothing to judge; leave --map-truth out")
    mapping = open_dataset(path)
    if mapping.truth is None:
        raise DataError(f"--map-truth {path} holds no true poses; name a dataset that has them, or leave it out")
    return mapping


def _check_mapping(place_map: PlaceMap, mapping: Dataset) -> None:
    try:
        frame_of_map(place_map.navigation, mapping, 1)
    except DegenerateGeometry as exc:
        raise DataError(f"--map-truth {mapping.path} does not fit the map ({exc}); give what it was made from") from exc


def _locate(
    recorded: Dataset, place_map: PlaceMap, options: ReplayOptions, bar: Bar
) -> tuple[tuple[PlaceAnswer, ...], tuple[HijackEvent, ...]]:
    begin_ns, end_ns = recorded.frame_times_ns[0], recorded.frame_times_ns[-1]

    def pace(t_robot_ns: int) -> None:
        bar.reach(1e-9 * (min(max(t_robot_ns, begin_ns), end_ns) - begin_ns), 1e-9 * (end_ns - begin_ns))

    return locate_live(recorded, place_map, options, pace, bar.step)


def _write(
    judged: JudgedAnswers, hijacks: Sequence[HijackEvent], place_map: PlaceMap, recorded: Dataset, out: Path
) -> None:
    with write_results(out) as fresh:
        write_answers(judged.answers, judged if recorded.truth is not None else None, fresh)
        draw_answers(judged, hijacks, f"{recorded.path.name} in {place_map.name}", fresh)


def told(judged: JudgedAnswers, hijacks: Sequence[HijackEvent], had_slam: bool, out: Path) -> str:
    """What a person wants to know."""
    summary = judged.summary()
    lines = [
        f"{summary['answers']} answers: {summary['known']} known, {summary['unknown']} unknown, {summary['lost']} lost"
        f" ({'SLAM ran beside' if had_slam else 'without SLAM beside'}, {len(hijacks)} hijacks noticed)"
    ]
    if judged.frame.source != "none":
        lines.append(
            f"{summary['right']} right and {summary['wrong']} wrong of the known:"
            f" precision {_share(summary['precision'])},"
            f" recall {_share(summary['recall'])} of {summary['answers_with_truth']} answers with a true position"
        )
        lines.append(
            f"rooms: {summary['room_right']} of {summary['room_known']} that were named are right,"
            f" recall {_share(summary['room_recall'])}"
            if summary["room_known"] is not None
            else "rooms: the map has none"
        )
        lines.append(
            f"position error {_number(summary['position_error_median_m'])} m (median),"
            f" calibration error {_number(summary['calibration_error'])}"
        )
    if between := sum(bool(a.one_of_two) for a in judged.answers):
        lines.append(f"{between} answers name no room, but two of which it is one")
    if judged.frame.source == "answers":
        lines.append("the map's frame was fitted to the answers themselves; --map-truth judges more strictly")
    return "\n".join([*lines, f"written to {out}"])


def _share(value: float | int | str | None) -> str:
    return "–" if value is None else f"{float(value):.1%}"


def _number(value: float | int | str | None) -> str:
    return "–" if value is None else f"{float(value):.3f}"
