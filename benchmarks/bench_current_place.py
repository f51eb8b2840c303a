"""The current place on maps that SLAM made, over several kinds of worlds; every "known" counts.

    python -m benchmarks.bench_current_place [--worlds home:600-624 plain:600-624 real] [--wrong-focal 2]
        [--one-way] [--map-all [--identical]] [--leave-kind-out] [--cache DIR] [--stored] [--jobs N]
        [--out FILE.json] [--figure FILE.png] [--results FILE]

Worlds that the cache does not hold are made first (`make_drives`: what a robot sent on drives with a hijack, one room
left out of the map; the recordings of `real` must lie beside the repository). The tracker then runs over each drive as
it was sent, with the images' poses as the localiser found them when the drive was made. `--stored` judges all that is
in the cache and makes nothing. `--leave-kind-out`: the evidence of images in flats, plain homes and real recordings is
what the two other kinds say (`fit_image_evidence`). How an answer is judged: tests/support/drives/judging.py.
`--map-all`: all rooms are in the map, also both twins, and what is said in a twin is counted beside
(tests/support/drives/twin_judging.py).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from benchmarks.drive_cache import load, stored
from benchmarks.fit_image_evidence import without
from benchmarks.make_drives import Job, add_mapping_option, jobs_of, make_missing, options_of
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from station.experiments.calibration_curve import calibration_bins, draw_calibration
from station.model.best_camera import misfit_of
from station.places.rooms.planning import planned
from station.places.tracking.config import BeliefConfig
from station.places.tracking.fitted import read_fitted
from station.places.tracking.tracker import PlaceTracker
from station.workers.repeatable import repeatable
from tests.support.drives import real
from tests.support.drives.judging import JudgedDrive, Share, Summary, judge_drive, summarise
from tests.support.drives.misfit import wrong_percent
from tests.support.drives.playback import play_back
from tests.support.drives.recorded import generator_of
from tests.support.drives.room_judging import RoomDrive, judge_rooms, summarise_rooms
from tests.support.drives.simulated import DriveOptions
from tests.support.drives.twin_judging import TwinDrive, judge_twins, summarise_twins
from tests.support.likelihood_fit import numbers

WEAKEST = 5
# Asked, per cent. Recall is of the answers in mapped rooms, by kind or by recording.
PRECISION, SILENT, FOUND_AGAIN, NOTICED = 99.0, 95.0, 90.0, 95.0
ROOM_PRECISION, ROOM_KNOWN, ROOM_SILENT, ROOM_FOUND_S = 99.0, 95.0, 95.0, 3.0
ROOM_CALIBRATION_ERROR = 0.03
TWIN_GUESSED = 1.0  # answers in a twin room that name the other one
RECALL = {"home": 85.0, "small": 85.0, "plain": 80.0, "kitchen": 85.0, "v101_halves": 75.0, "v102": 80.0}
WORST_RECALL = 70.0  # of a single flat
BADLY_WRONG, BADLY_WRONG_PRECISION = 2.0, 98.0  # with more per cent wrong it may be silent
CALIBRATION_ERROR, FALSE_ALARMS_PER_HOUR = 0.05, 1.0
ELSEWHERE = "other buildings"


@dataclass(frozen=True, slots=True)
class JudgedWorld:
    """What became of one world."""

    kind: str
    name: str
    wrong_percent: float  # of the calibration
    failure: str  # why there is no map; "" where there is one
    map_scale: float | None  # true length per length of the map
    map_error_m: float | None
    drives: tuple[JudgedDrive, ...]
    rooms: tuple[RoomDrive, ...] = ()
    is_mapped_both_ways: bool = True
    maps_all: bool = False  # no room is left out, and the robot is put down in one of two twins
    has_identical_twins: bool = False
    twins: tuple[TwinDrive, ...] = ()
    is_said_to_misfit: bool = False
    by_other_kinds: bool = False  # the evidence was fitted to the other kinds of worlds only

    @property
    def is_elsewhere(self) -> bool:
        """In a building that the map knows nothing of."""
        return self.kind == real.KIND and self.name.startswith("elsewhere")

    @property
    def group(self) -> str:
        """What is counted together."""
        by = ", evidence of other kinds" if self.by_other_kinds else ""
        if self.kind == real.KIND:
            return (ELSEWHERE if self.is_elsewhere else self.name) + by
        wrong = f", calibration {self.wrong_percent:g} % wrong" if self.wrong_percent else ""
        how = "" if self.is_mapped_both_ways else ", mapped one way round"
        if self.maps_all:
            how += ", identical twins both mapped" if self.has_identical_twins else ", twins both mapped"
        return self.kind + wrong + how + by


def judge_world(path: Path, leave_kind_out: bool = False) -> JudgedWorld:
    """Run the tracker over all drives of a stored world."""
    with repeatable(1):
        world = load(path)
        fitted = read_fitted(without(generator_of(world.kind))) if leave_kind_out else read_fitted()
        make_tracker = partial(PlaceTracker, config=BeliefConfig(fitted=fitted))
        place_map, quality = world.place_map, world.quality
        drives: list[JudgedDrive] = []
        rooms: list[RoomDrive] = []
        twins: list[TwinDrive] = []
        misfit = ""
        if place_map is not None:
            place_map = planned(place_map)
            misfit = misfit_of(place_map.navigation.report)
            played = [(d, play_back(place_map, d, make_tracker, world.tried)) for d in world.drives]
            drives += [judge_drive(place_map, d, answers) for d, answers in played]
            rooms += [judge_rooms(place_map, d, answers) for d, answers in played]
            twins += [judge_twins(place_map, d, answers) for d, answers in played]
    scale, error_m = (quality.scale, quality.error_m) if quality else (None, None)
    wrong = wrong_percent(world.misfit)
    return JudgedWorld(
        world.kind,
        world.name,
        wrong,
        world.failure,
        scale,
        error_m,
        tuple(drives),
        tuple(rooms),
        world.is_mapped_both_ways,
        maps_all=not world.left_out and world.kind != real.KIND,
        has_identical_twins=world.has_identical_twins,
        twins=tuple(twin for twin in twins if twin.answers),
        is_said_to_misfit=bool(misfit),
        by_other_kinds=leave_kind_out,
    )


def described(summary: Summary) -> str:
    per_hour = summary.false_alarms_per_hour
    return (
        f"  precision {summary.precision}\n  recall in mapped rooms {summary.recall}\n"
        f"  not known where no map is {summary.silent}\n  calibration error {summary.calibration_error:.3f}\n"
        f"  found again within 10 s {summary.found_again}, hijack noticed within 2 s {summary.noticed}\n"
        f"  false alarms {summary.false_alarms} in {summary.undisturbed_h:.2f} h"
        f"{'' if per_hour is None else f', {per_hour:.1f} an hour'}\n  left out in doorways {summary.left_out}"
    )


def line(world: JudgedWorld) -> str:
    """One world in a row."""
    if world.failure:
        return f"{world.group} {world.name}: no map: {world.failure}"
    s = summarise(world.drives)
    return (
        f"{world.group} {world.name}: recall {s.recall}, right when known {s.precision}, silent {s.silent}, "
        f"scale {world.map_scale:.3f}, ATE {world.map_error_m:.3f}"
    )


def recall_of(world: JudgedWorld) -> float:
    """0 without a map: nothing is known then."""
    return 0.0 if world.failure else (summarise(world.drives).recall.value or 0.0)


def figures_of(group: str, worlds: Sequence[JudgedWorld]) -> list[Figure]:
    """What is asked of a group of worlds; nothing where whoever mapped went one way round only, for comparison."""
    summary = summarise([drive for world in worlds for drive in world.drives])
    kind = worlds[0].name if worlds[0].kind == real.KIND else worlds[0].kind
    if not worlds[0].is_mapped_both_ways:
        return [
            share(f"{group}: right of all that is known", summary.precision.count, summary.precision.of),
            share(f"{group}: known and right in mapped rooms", summary.recall.count, summary.recall.of),
        ]
    if worlds[0].wrong_percent > BADLY_WRONG:
        return misfit_figures(group, worlds)

    def part(what: str, of: Share, at_least: float | None) -> Figure:
        return share(f"{group}: {what}", of.count, of.of, at_least=at_least)

    known = part("right of all that is known", summary.precision, PRECISION)
    silent = part("not known where the map has nothing", summary.silent, SILENT)
    if worlds[0].is_elsewhere:
        return [part("not known", summary.silent, 100.0)]
    right = part("known and right in mapped rooms", summary.recall, RECALL.get(kind))
    if worlds[0].maps_all:
        return [known, right, *twin_figures(group, [drive for world in worlds for drive in world.twins])]
    if worlds[0].kind == real.KIND:  # too few answers for more
        return [known, right]
    alarms, hours = summary.false_alarms_per_hour, summary.undisturbed_h
    found = [
        known,
        right,
        Figure(
            f"{group}: expected calibration error",
            summary.calibration_error,
            at_most=CALIBRATION_ERROR,
            of=summary.precision.of,
        ),
        Figure(
            f"{group}: false hijack alarms an hour, in {60 * hours:.0f} minutes",
            alarms,
            at_most=FALSE_ALARMS_PER_HOUR,
        ),
    ]
    return [
        *found,
        silent,
        *room_figures(group, [drive for world in worlds for drive in world.rooms]),
        part("right place within 10 s after a hijack to a mapped room", summary.found_again, FOUND_AGAIN),
        part("hijack noticed within 2 s", summary.noticed, NOTICED),
        part("answers left out in doorways", summary.left_out, None),
        Figure(
            f"{group}: known and right in mapped rooms, weakest world",
            100 * min(recall_of(world) for world in worlds),
            "%",
            at_least=WORST_RECALL if kind == "home" else None,
            of=len(worlds),
        ),
        Figure(f"{group}: worlds without a map", sum(bool(world.failure) for world in worlds), of=len(worlds)),
    ]


def misfit_figures(group: str, worlds: Sequence[JudgedWorld]) -> list[Figure]:
    """With a calibration so wrong an answer may be silent: what is known or named all the same has to be right."""
    summary = summarise([drive for world in worlds for drive in world.drives])
    known = summary.precision
    named = summarise_rooms([drive for world in worlds for drive in world.rooms]).precision
    answers = [answer for world in worlds for drive in world.drives for answer in drive.answers]
    rooms = [answer for world in worlds for drive in world.rooms for answer in drive.rooms]
    figures = [
        share(f"{group}: said not to fit", sum(world.is_said_to_misfit for world in worlds), len(worlds), at_least=100),
        share(f"{group}: hijack noticed within 2 s", summary.noticed.count, summary.noticed.of, at_least=NOTICED),
        share(f"{group}: place known", sum(answer.is_known for answer in answers), len(answers)),
        share(f"{group}: room named, but in doorways", sum(answer.is_known for answer in rooms), len(rooms)),
    ]
    told = (("right of all that is known", known), ("room right of all that is named", named))
    return figures + [
        share(f"{group}: {what}", of.count, of.of, at_least=BADLY_WRONG_PRECISION) for what, of in told if of.of
    ]


def room_figures(group: str, drives: Sequence[RoomDrive]) -> list[Figure]:
    """What is asked of the current room."""
    rooms = summarise_rooms(drives)
    precision, known, silent = rooms.precision, rooms.known, rooms.silent
    return [
        share(f"{group}: room right of all that is named", precision.count, precision.of, at_least=ROOM_PRECISION),
        share(f"{group}: room named in mapped rooms", known.count, known.of, at_least=ROOM_KNOWN),
        share(f"{group}: no room named where the map has nothing", silent.count, silent.of, at_least=ROOM_SILENT),
        Figure(
            f"{group}: expected calibration error of the room",
            rooms.calibration_error,
            at_most=ROOM_CALIBRATION_ERROR,
            of=precision.of,
        ),
        Figure(
            f"{group}: right room after a hijack, median",
            rooms.found_again_s,
            "s",
            at_most=ROOM_FOUND_S,
            of=sum(drive.was_put_down for drive in drives),
        ),
    ]


def twin_figures(group: str, drives: Sequence[TwinDrive]) -> list[Figure]:
    """What is said in a twin room that the robot was put down in, until it leaves it."""
    twins = summarise_twins(drives)
    said = (
        ("wrong room named", twins.guessed, TWIN_GUESSED),
        ("right room named", twins.right, None),
        ("one of two", twins.one_of_two, None),
        ("wrong place known", twins.place_wrong, TWIN_GUESSED),
    )
    return [
        *(share(f"{group}: in a twin, {what}", of.count, of.of, at_most=at_most) for what, of, at_most in said),
        share(
            f"{group}: first room named in a twin is wrong", twins.first_wrong.count, twins.first_wrong.of, at_most=None
        ),
    ]


def figures_of_all_real(worlds: Iterable[JudgedWorld]) -> list[Figure]:
    """Every known answer to a real recording, other buildings included."""
    drives = [drive for world in worlds if world.kind == real.KIND for drive in world.drives]
    known = summarise(drives).precision
    return (
        [share("real recordings: right of all that is known", known.count, known.of, at_least=PRECISION)]
        if drives
        else []
    )


def grouped(worlds: Iterable[JudgedWorld]) -> dict[str, list[JudgedWorld]]:
    groups: dict[str, list[JudgedWorld]] = {}
    for world in worlds:
        groups.setdefault(world.group, []).append(world)
    return groups


def draw(groups: dict[str, list[JudgedWorld]], path: Path) -> None:
    """The calibration curve of each group, over all of its known answers."""
    curves = []
    for group, worlds in groups.items():
        answers = [a for world in worlds for drive in world.drives for a in drive.answers]
        known = [(a.probability, a.is_right) for a in answers if a.is_known and not a.is_left_out]
        if known:
            curves.append((group, calibration_bins(known)))
    draw_calibration(curves, path)


def print_report(groups: dict[str, list[JudgedWorld]]) -> None:
    for group, worlds in groups.items():
        print(f"{group}: {len(worlds)} worlds")
        print(described(summarise([drive for world in worlds for drive in world.drives])))
        for figure in room_figures(group, [drive for world in worlds for drive in world.rooms]):
            print(f"  {figure.what}: {figure.value}")
        if worlds[0].maps_all:
            for figure in twin_figures(group, [drive for world in worlds for drive in world.twins]):
                print(f"  {figure.what}: {figure.value} of {figure.of}")
        print("  weakest:")
        for world in sorted(worlds, key=recall_of)[:WEAKEST]:
            print(f"  - {line(world)}")


def jobs_asked(worlds: Sequence[str], wrong_focal: float, options: DriveOptions, cache: Path) -> list[Job]:
    """`home:600-624` or `real`."""
    jobs: list[Job] = []
    for text in worlds:
        kind, _, seeds = text.partition(":")
        jobs += jobs_of(kind, numbers(seeds) if seeds else [], wrong_focal, options, cache)
    return jobs


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["small:0-2"])
    parser.add_argument("--wrong-focal", type=float, default=0.0, help="per cent; what goes with it: make_drives")
    add_mapping_option(parser)
    parser.add_argument("--cache", type=Path, help="folder of drives; by default one of the present code")
    parser.add_argument("--stored", action="store_true", help="all that is in the cache, and nothing else")
    parser.add_argument("--leave-kind-out", action="store_true", help="fitted to the other kinds of worlds only")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, help="every judged answer")
    parser.add_argument("--figure", type=Path, help="draw the calibration curves into this file")
    add_results_option(parser, "current_place")
    a = parser.parse_args()
    run = Run.begin()
    cache: Path = a.cache or work_folder() / "drives"
    options = options_of(a)
    jobs = [] if a.stored else jobs_asked(a.worlds, a.wrong_focal, options, cache)
    is_complete = make_missing(jobs, a.jobs)
    paths = stored(cache) if a.stored else [job.path for job in jobs if job.path.exists()]
    worlds: list[JudgedWorld] = []
    with ProcessPoolExecutor(a.jobs, get_context("spawn")) as pool:
        for world in pool.map(partial(judge_world, leave_kind_out=a.leave_kind_out), paths):
            worlds.append(world)
            print(line(world), flush=True)
    groups = grouped(worlds)
    print_report(groups)
    found = [figure for group, some in groups.items() for figure in figures_of(group, some)]
    run.write(a.results, [*found, *figures_of_all_real(worlds)])
    if a.out:
        a.out.write_text(json.dumps([asdict(world) for world in worlds]))
    if a.figure:
        draw(groups, a.figure)
    return 0 if is_complete else 1


if __name__ == "__main__":
    sys.exit(main())
