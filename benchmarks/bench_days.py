"""One flat on three days: other light, chairs, boxes and baskets elsewhere, another way through it. Do names survive?

    python -m benchmarks.bench_days --flats 1-3
    python -m benchmarks.bench_days --made-up 30        # in a minute: made-up clouds instead of pictures and SLAM

As a person would: the first drive becomes a map, each place and each room gets a name; the second drive is merged in,
what is new gets a name; then the third. All by the code of the station's job (`POST /maps`) and its store. The
simulator's truth judges: a name is kept where the place that bears it truly lies where it lay, and where most landmarks
of the room that bears it truly are in the room that they were in; a duplicate stands where another one does.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.result import FOLDER, RESULTS_HELP, Run, share, work_folder
from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.errors import EstimationError
from shared.geometry import FloatArray
from station.datasets import open_dataset
from station.experiments.matches import count_duplicates, true_landmarks
from station.files.navigation_folder import load_navigation, save_navigation
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.making.scale import half_extent
from station.places.rooms.edits import require_plan
from station.slam.backends import make_backend
from station.slam.run import run_backend
from station.workers.library_jobs import LibraryJobs
from tests.support.days import Drive, made_up_days
from tests.support.store import rename_place, rename_room

ROUTES = ("mapping", "second", "mapping")  # of the three days
NAMES_KEPT_PERCENT, DUPLICATES_PERCENT, ROOM_NAMES_KEPT_PERCENT = 95.0, 5.0, 98.0  # asked
RoomAt = Callable[[float, float], str]  # name of the true room at a position, m


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flat."""

    name: str
    names: int  # that a person gave, over both merges
    kept: int
    elsewhere: int  # of those lost: the name is there, at another place
    places: int  # at the end
    duplicates: int
    rooms: int = 0  # that a person gave a name, over both merges
    rooms_kept: int = 0
    refused: str = ""  # why a drive could not be merged; nothing is lost then

    def __str__(self) -> str:
        if self.refused:
            return f"{self.name}: {self.refused}"
        return (
            f"{self.name}: {self.kept} of {self.names} names kept ({self.elsewhere} are elsewhere now), {self.places}"
            f" places in the end, {self.duplicates} duplicates; {self.rooms_kept} of {self.rooms} rooms' names kept"
        )


# The days


def simulated_days(world: str, seed: int, backend: str, fps: float, folder: Path) -> list[Drive]:
    """Three drives through one flat; each is made once and kept in the folder."""
    drives = []
    for day, route in enumerate(ROUTES):
        visit = 1000 * seed + day if day else None
        settings = SimulationConfig(camera_rate_hz=fps, moved_chairs_seed=visit, light_seed=visit)
        dataset, navigation = folder / f"day-{day}", folder / f"day-{day}-{backend}"
        if not dataset.is_dir():
            flat = make_world(world, seed, settings)
            plan = plan_route(flat, route, day, settings.body.radius_m)
            scratch = dataset.with_suffix(".part")
            shutil.rmtree(scratch, ignore_errors=True)
            record_drive(flat, plan, settings, 10 * seed + day, scratch, default_cache_dir())
            scratch.rename(dataset)
        data = open_dataset(dataset)
        if not navigation.is_dir():
            slam = make_backend(backend, data.calibration, 1)
            save_navigation(replace(run_backend(slam, data.events()), id=f"flat-{seed}-day-{day}"), navigation)
        truth = data.truth
        assert truth is not None
        drives.append(Drive(navigation, true_landmarks(load_navigation(navigation), truth)))
    return drives


# A person's work over the days


def live_there(name: str, drives: list[Drive], folder: Path, room_at: RoomAt | None) -> Outcome:
    """Build, name, merge, name, merge; judged after each merge. `room_at`: where rooms are judged, too."""
    address = StoreAddress(folder / "maps")
    store, library = MapStore(address), LibraryJobs(lambda _: None)
    named = kept = elsewhere = rooms = rooms_kept = 0
    before: PlaceMap | None = None
    for count in range(1, len(drives) + 1):
        try:
            built = library.build_map([drive.folder for drive in drives[:count]], address, name, None)
        except EstimationError as exc:
            return Outcome(name, named, kept, elsewhere, 0, 0, rooms, rooms_kept, refused=str(exc))
        place_map = store.load(built.map_id)
        p_true = np.concatenate([drive.p_true for drive in drives[:count]])
        if before is not None:
            judged = [judge(place.name, before, place_map, p_true) for place in before.places]
            named, kept, elsewhere = named + len(judged), kept + judged.count("kept"), elsewhere + judged.count("moved")
        if room_at is not None:
            if before is not None:
                is_kept = judge_rooms(before, place_map, p_true, room_at)
                rooms, rooms_kept = rooms + len(is_kept), rooms_kept + sum(is_kept)
            place_map = name_rooms(store, place_map, count)
        before = name_all(store, place_map, count)
    assert before is not None
    duplicates = count_duplicates(before.places, p_true)
    return Outcome(name, named, kept, elsewhere, len(before.places), duplicates, rooms, rooms_kept)


def name_all(store: MapStore, place_map: PlaceMap, count: int) -> PlaceMap:
    """A person names what has no name yet."""
    for number, place in enumerate(place_map.places):
        if not place.name.startswith("Corner"):
            place_map = rename_place(store, place_map.id, place.id, f"Corner {count}.{number}")
    return place_map


def name_rooms(store: MapStore, place_map: PlaceMap, count: int) -> PlaceMap:
    """The same of rooms."""
    for number, room in enumerate(require_plan(place_map).rooms):
        if room.id not in place_map.plan_edits.names:
            place_map = rename_room(store, place_map.id, room.id, f"Chamber {count}.{number}")
    return place_map


def judge_rooms(before: PlaceMap, after: PlaceMap, p_true: FloatArray, room_at: RoomAt) -> list[bool]:
    """Of each room that had a name whether the room of that name is truly the same one now."""
    old, new = (true_room_of(place_map, p_true, room_at) for place_map in (before, after))
    return [new.get(name) == true_room for name, true_room in old.items()]


def true_room_of(place_map: PlaceMap, p_true: FloatArray, room_at: RoomAt) -> dict[str, str]:
    """By the name of each room of the plan the true room that most landmarks in it are in."""
    plan = require_plan(place_map)
    p_map = place_map.navigation.landmarks.p_world
    inside = plan.rooms_at(p_map)
    known = np.isfinite(p_true[: len(p_map), 0])
    found = {}
    for number, room in enumerate(plan.rooms):
        true = Counter(room_at(x, y) for x, y, _ in p_true[: len(p_map)][known & (inside == number)].tolist())
        if true:
            found[room.name] = true.most_common(1)[0][0]
    return found


def judge(name: str, before: PlaceMap, after: PlaceMap, p_true: FloatArray) -> str:
    """What became of a name: "kept", "moved" to what truly is another place, or "lost".

    The landmarks of `before` are the first of `after`. Kept: the true centroids lie nearer to each other than half the
    larger one's extent, as for matches (station/experiments/matches.py).
    """
    old = next(place for place in before.places if place.name == name)
    new = next((place for place in after.places if place.name == name), None)
    if new is None:
        return "lost"
    points = [p_true[place.landmark_index] for place in (old, new)]
    points = [p[np.isfinite(p[:, 0])] for p in points]
    distance = float(np.linalg.norm(points[0].mean(axis=0) - points[1].mean(axis=0)))
    return "kept" if distance <= max(half_extent(p) for p in points) else "moved"


def study(
    names: list[str],
    make: Callable[[str, Path], list[Drive]],
    rooms_of: Callable[[str], RoomAt | None],
    work: Path | None,
) -> list[Outcome]:
    """All flats, told as they are done."""
    outcomes = []
    for name in names:
        folder = Path(tempfile.mkdtemp(prefix="days-")) if work is None else work / name.replace(" ", "-")
        shutil.rmtree(folder / "maps", ignore_errors=True)
        outcomes.append(live_there(name, make(name, folder), folder, rooms_of(name)))
        print(outcomes[-1], flush=True)
        if work is None:
            shutil.rmtree(folder)
    return outcomes


def main(
    flats: Annotated[str, typer.Option(help="Seeds of simulated flats, such as 1-3.")] = "1-3",
    world: Annotated[str, typer.Option(help="Kind of flat.")] = "small",
    backend: Annotated[str, typer.Option(help="SLAM backend.")] = "sfm",
    fps: Annotated[float, typer.Option(help="Pictures per second.")] = 10.0,
    made_up: Annotated[int, typer.Option(help="Instead: so many made-up rooms, without pictures and SLAM.")] = 0,
    first: Annotated[int, typer.Option(help="Seed of the first made-up room.")] = 0,
    work: Annotated[
        Path | None, typer.Option(help="Where drives are kept. Usually in benchmarks/results/work.")
    ] = None,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "days.json",
) -> None:
    """Exit code 1 when fewer than 95 % of the names are kept or more than 5 % of the places are duplicates."""
    run = Run.begin()
    low, _, high = flats.partition("-")
    if made_up:
        names = [f"room {n}" for n in range(first, first + made_up)]
        outcomes = study(names, lambda n, f: made_up_days(int(n.split()[1]), f), lambda _: None, None)
    else:
        names = [f"{world} {n}" for n in range(int(low), int(high or low) + 1)]
        outcomes = study(
            names,
            lambda n, f: simulated_days(world, int(n.split()[1]), backend, fps, f),
            lambda n: make_world(world, int(n.split()[1]), SimulationConfig()).room_at,
            work or work_folder() / f"days-{backend}-{fps:g}",
        )
    merged = [outcome for outcome in outcomes if not outcome.refused]
    kept, total = sum(o.kept for o in merged), sum(o.names for o in merged)
    duplicates, places = sum(o.duplicates for o in merged), sum(o.places for o in merged)
    print(
        f"{len(merged)} of {len(outcomes)} flats merged; names kept {kept} of {total} = {kept / max(total, 1):.1%};"
        f" duplicates {duplicates} of {places} = {duplicates / max(places, 1):.1%}"
    )
    rooms_kept, rooms = sum(o.rooms_kept for o in merged), sum(o.rooms for o in merged)
    homes = "made-up rooms" if made_up else "simulated flats"
    run.write(
        results,
        [
            share(f"three days in {homes}: all days placed in one map", len(merged), len(outcomes)),
            share(f"three days in {homes}: names kept", kept, total, at_least=NAMES_KEPT_PERCENT),
            share(f"three days in {homes}: places that are duplicates", duplicates, places, at_most=DUPLICATES_PERCENT),
        ]
        + (
            [share(f"three days in {homes}: rooms' names kept", rooms_kept, rooms, at_least=ROOM_NAMES_KEPT_PERCENT)]
            if rooms
            else []
        ),
    )
    if not merged or 100 * kept < NAMES_KEPT_PERCENT * total or 100 * duplicates > DUPLICATES_PERCENT * places:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
