"""`station replay`: a recorded navigation through the live code, in recorded time."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import ConfigError, DataError
from station.commands.answer_files import write_answers
from station.commands.map_store import open_map
from station.commands.options import Config, Data
from station.commands.progress import working
from station.commands.results_folder import write_results
from station.datasets import Dataset, open_dataset
from station.experiments.answers import JudgedAnswers, judge_recorded
from station.files.navigation_folder import save_navigation
from station.maps.folder import save_map_folder
from station.model.place_map import PlaceMap
from station.workers.replay import Replay, ReplayOptions, replay


def register(app: typer.Typer) -> None:
    app.command("replay")(replay_command)


def replay_command(
    dataset: Annotated[Path, typer.Argument(help="MCAP recording, ASL/EuRoC folder, folder of images or video.")],
    backend: Annotated[
        str, typer.Option("--backend", help="sfm, ukf, smoothing, mono, or auto: what suits the robot.")
    ] = "sfm",
    known_map: Annotated[
        str, typer.Option("--map", metavar="MAP", help="Look for places in this map: a folder, or an id in the store.")
    ] = "",
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 1,
    threads: Annotated[int, typer.Option(help="Threads for images; any number gives the same result.")] = 1,
    speed: Annotated[float | None, typer.Option(help="Times recorded time; as fast as it can without.")] = None,
    first: Annotated[int | None, typer.Option(help="Number of the first frame to use.")] = None,
    last: Annotated[int | None, typer.Option(help="Number of the last frame to use.")] = None,
    step: Annotated[int, typer.Option(help="Use every step-th frame.")] = 1,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for navigation, map and answers.")] = None,
    data: Data = None,
    config: Config = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the hashes as one JSON object on stdout.")] = False,
) -> None:
    """Reconstruct, map and ask for the current place, as the running station would; prints a hash of each result.

    With --map, --out and true poses in the recording, summary.json judges the answers as `station locate` does.
    """
    if speed is not None and not speed > 0:
        raise ConfigError(f"--speed {speed} must be above 0")
    recorded = open_dataset(dataset, first, last, step)
    if not recorded.has_images:
        raise DataError(f"{dataset} holds no camera images; choose a dataset with images")
    if out is not None and out.exists():
        raise DataError(f"{out} exists already; give a new folder with --out")
    place_map = open_map(known_map, data, config) if known_map else None
    options = ReplayOptions(backend, seed, threads)
    begin_ns, end_ns = recorded.frame_times_ns[0], recorded.frame_times_ns[-1]
    metronome = Metronome(speed)
    with working(f"opening {dataset.name}") as bar:

        def pace(t_robot_ns: int) -> None:
            metronome.wait(t_robot_ns)
            bar.reach(1e-9 * (min(max(t_robot_ns, begin_ns), end_ns) - begin_ns), 1e-9 * (end_ns - begin_ns))

        result = replay(recorded, options, place_map, pace, bar.step)
        bar.step("judging")
        judged = _judge(result, place_map, recorded)
    if out is not None:
        _write(result, judged, out)
    hashes = result.hashes()
    if as_json:
        print(json.dumps({**hashes, "answers_given": len(result.answers), "places": len(result.place_map.places)}))
        return
    known = sum(answer.state == "known" for answer in result.answers)
    print(
        f"{len(result.navigation.trajectory)} poses, {len(result.navigation.landmarks)} landmarks, "
        f"{len(result.place_map.places)} places; {known} of {len(result.answers)} answers name a place"
    )
    for name, value in hashes.items():
        print(f"{name:10s} {value}")


class Metronome:
    """Waits until recorded time may go on. A new pass over the recording begins when its time jumps back."""

    def __init__(self, speed: float | None) -> None:
        self._speed = speed
        self._begin: tuple[int, float] | None = None
        self._last_ns = 0

    def wait(self, t_robot_ns: int) -> None:
        """Until it is this time."""
        if self._speed is None:
            return
        if self._begin is None or t_robot_ns < self._last_ns - 1_000_000_000:
            self._begin = (t_robot_ns, time.monotonic())
        self._last_ns = t_robot_ns
        due_s = self._begin[1] + (t_robot_ns - self._begin[0]) * 1e-9 / self._speed
        time.sleep(max(0.0, due_s - time.monotonic()))


def _judge(result: Replay, place_map: PlaceMap | None, recorded: Dataset) -> JudgedAnswers | None:
    """None in the map just made of the recording itself, and without true poses."""
    if place_map is None or recorded.truth is None:
        return None
    return judge_recorded(result.answers, place_map, recorded)


def _write(result: Replay, judged: JudgedAnswers | None, out: Path) -> None:
    with write_results(out) as fresh:
        save_navigation(result.navigation, fresh / "navigation")
        save_map_folder(result.place_map, fresh / "map")
        write_answers(result.answers, judged, fresh)
        (fresh / "hashes.json").write_text(json.dumps(result.hashes(), indent=1) + "\n")
