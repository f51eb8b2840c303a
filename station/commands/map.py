"""`station map`: places, their graph and their names from one or more navigations."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from shared.errors import DataError
from station.commands import map_store
from station.commands.map_store import MapArgument, open_map
from station.commands.options import Config, Data, Mode, Places, check_out_folder
from station.commands.progress import Bar, working
from station.commands.results_folder import naming_replaced
from station.config import check_backend, check_executor
from station.datasets import open_dataset
from station.files.navigation_folder import load_navigation
from station.maps.editing import tidy_name
from station.maps.folder import load_map_folder, save_map_folder
from station.model.navigation import Navigation
from station.model.place_map import PlaceEdge, PlaceMap
from station.places.joining.growing import keep_places
from station.places.making.changes import without_hidden
from station.places.making.config import PlacesConfig, ThesisConfig
from station.places.making.graph import shortest_route, to_graphml, to_json_dict
from station.places.making.repeatability import repeatability
from station.places.rooms.edits import require_plan
from station.places.rooms.planning import planned, with_suggestions
from station.places.rooms.summary import plan_lines, plan_summary
from station.workers.executors.opening import open_executor
from station.workers.executors.port import Executor
from station.workers.mapping import MapOfNavigations, Reconstruction, Recorded, make_map, reconstruct_all


def register(app: typer.Typer) -> None:
    maps = typer.Typer(no_args_is_help=True, help="Places, their graph and their names.")
    maps.command("build")(build)
    maps.command("show")(show)
    maps.command("route")(route)
    maps.command("rooms")(rooms)
    map_store.register(maps)
    app.add_typer(maps, name="map")


def build(
    navigations: Annotated[
        list[Path], typer.Argument(help="Folders written by `station slam`, or recordings; the main one first.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the map.")],
    name: Annotated[str, typer.Option(help="Name of the map.")] = "",
    mode: Mode = "default",
    eps: Annotated[float, typer.Option(help="Thesis mode: DBSCAN's eps, m or normalised.")] = 0.3,
    min_pts: Annotated[int, typer.Option(help="Thesis mode: DBSCAN's MinPts.")] = 11,
    places: Places = "rooms",
    names_from: Annotated[Path | None, typer.Option(help="An earlier map of the first one: keeps its names.")] = None,
    executor: Annotated[
        str, typer.Option(help="processes (of this machine) or dask://HOST:PORT of a Dask scheduler.")
    ] = "processes",
    backend: Annotated[str, typer.Option(help="SLAM over recordings: auto, ukf, smoothing, sfm, mono.")] = "sfm",
    seed: Annotated[int, typer.Option(help="Seed of SLAM over recordings.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the graph as JSON on stdout.")] = False,
) -> None:
    """Cluster landmarks into named places and write the map, with its graph as GraphML beside it.

    Further navigations are registered to the first one and extend it. SLAM runs over recordings first, side by side.
    """
    check_executor(executor)
    check_backend(backend)
    check_out_folder(out)
    if out.is_dir() and any(out.iterdir()) and not (out / "map.json").is_file():
        raise DataError(f"{out} exists and is no map; give a new folder")
    name = name and tidy_name(name, "--name")
    config = PlacesConfig(mode, ThesisConfig(eps, min_pts))
    old = None if names_from is None else load_map_folder(names_from)
    with working("reading the navigations") as bar, open_executor(executor) as machines:
        loaded = _navigations(navigations, machines, backend, seed, bar)
        if old is not None:
            check_names_source(old, loaded, names_from)
        bar.step("joining navigations" if len(loaded) > 1 else "clustering landmarks")
        made = machines.map(make_map, [MapOfNavigations(tuple(loaded), config, name)])[0]
        place_map = made.with_grain(places)
        if old is not None:
            place_map = keep_places(old, place_map)
        bar.step("looking for rooms and doors")
        place_map = planned(place_map, old)
        bar.step("looking for stickers that name rooms")
        place_map = with_suggestions(place_map, bar.advance)
    with naming_replaced(out, "the map", "map.json"):
        save_map_folder(place_map, out, {"graph.graphml": to_graphml(place_map)})
    if as_json:
        print(json.dumps(to_json_dict(place_map)))
        return
    for place in place_map.places:
        print(f"{place.name}: {len(place.landmark_index)} landmarks, quality {place.quality:.2f}")
    if not place_map.places:
        print(f"no place: {_why_no_place(place_map)}")
    print(f"{len(place_map.places)} places, {len(place_map.edges)} edges, written to {out}")


def _why_no_place(place_map: PlaceMap) -> str:
    p = place_map.navigation.landmarks.p_world
    finite = int(np.count_nonzero(np.isfinite(p).all(axis=1)))
    if not len(p):
        return "the navigation has no landmarks"
    return f"its landmarks ({finite}) form no group" if finite else f"none of its {len(p)} landmarks is finite"


def _navigations(paths: list[Path], machines: Executor, backend: str, seed: int, bar: Bar) -> list[Navigation]:
    """What is done already is read first, and the recordings are looked at: SLAM over them takes long."""
    recorded = [path for path in paths if path.exists() and not (path / "navigation.json").is_file()]
    done = {path: load_navigation(path) for path in paths if path not in recorded}
    for path in recorded:
        if not open_dataset(path).has_images:
            raise DataError(f"{path} has no pictures; SLAM needs them")
    if recorded:
        bar.step("SLAM over recordings", len(recorded))
    made = reconstruct_all(
        machines,
        [Reconstruction(Recorded(path), backend, seed) for path in recorded],
        lambda _: bar.advance(),
    )
    done |= dict(zip(recorded, made, strict=True))
    return [done[path] for path in paths]


def check_names_source(old: PlaceMap, navigations: list[Navigation], names_from: Path | None) -> None:
    """Names are carried by position: the old map must be in the frame of the first navigation.

    Raises:
        DataError: the map was made from another navigation, or from another run of SLAM over it.
    """
    ids = [navigation.id for navigation in navigations]
    if old.navigation.id not in ("+".join(ids[: n + 1]) for n in range(len(ids))):
        raise DataError(f"{names_from} was made from {old.navigation.id}, not {ids[0]}; give its own map")


def show(
    which: MapArgument,
    data: Data = None,
    config: Config = None,
    with_repeatability: Annotated[
        bool,
        typer.Option("--repeatability", help="Measure how surely each place would be found again: groups them anew."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the graph as JSON on stdout.")] = False,
) -> None:
    """List a map's places and edges."""
    place_map = open_map(which, data, config)
    measured: dict[str, float] = {}
    if with_repeatability:
        with working("grouping the landmarks anew"):
            shares = repeatability(place_map).tolist()
        measured = {place.id: share for place, share in zip(place_map.places, shares, strict=True)}
    if as_json:
        print(json.dumps(to_json_dict(place_map, measured)))
        return
    print(f"{place_map.name} ({place_map.id})")
    if not place_map.places:
        print(f"  no place: {_why_no_place(place_map)}")
    for place in place_map.places:
        seen = f"{len(place.landmark_index)} landmarks, {len(place.keyframe_index)} images"
        again = f", repeatability {measured[place.id]:.2f}" if place.id in measured else ""
        print(f"  {place.name}: {seen}, quality {place.quality:.2f}{again}{', hidden' if place.hidden else ''}")
    name = {place.id: place.name for place in place_map.places}
    for edge in place_map.edges:
        print(f"  {name[edge.a]} - {name[edge.b]}: {_leg(edge, place_map)}, {edge.kind}")


def rooms(
    which: MapArgument,
    data: Data = None,
    config: Config = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print rooms and doors as JSON on stdout.")] = False,
) -> None:
    """Rooms, the names that are suggested for them, and doors. Of a map older than plans they are found now.

    Nothing is named by a suggestion: click into the room on the page, or PATCH /rooms/{id}, to use it.
    """
    place_map = open_map(which, data, config)
    if place_map.plan is None:
        with working("looking for rooms and doors"):
            place_map = planned(place_map)
    plan = require_plan(place_map)
    if as_json:
        print(json.dumps(plan_summary(plan, place_map)))
        return
    print("\n".join([f"{place_map.name} ({place_map.id})", *(f"  {line}" for line in plan_lines(plan, place_map))]))


def _leg(edge: PlaceEdge, place_map: PlaceMap) -> str:
    """Distance and bearing, for a person."""
    unit = " m" if place_map.navigation.is_metric else ""
    return f"{edge.distance:.2f}{unit} at {math.degrees(edge.bearing_rad):.0f} degrees"


def route(
    which: MapArgument,
    start: Annotated[str, typer.Argument(help="Name or id of a place.")],
    goal: Annotated[str, typer.Argument(help="Name or id of a place.")],
    data: Data = None,
    config: Config = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the route as JSON on stdout.")] = False,
) -> None:
    """The shortest way between two places, and each leg's bearing: in the ground plane, from +x towards +y."""
    place_map = without_hidden(open_map(which, data, config))
    found = shortest_route(place_map, start, goal)
    if found is None:
        raise DataError(f"no edges lead from {start} to {goal}")
    if as_json:
        legs = [asdict(leg) for leg in found.legs]
        print(json.dumps({"places": found.place_ids, "names": found.names, "legs": legs, "length": found.length}))
        return
    print(f"{' > '.join(found.names)} ({found.length:.2f}{' m' if place_map.navigation.is_metric else ''})")
    for name, leg in zip(found.names[1:], found.legs, strict=True):
        print(f"  to {name}: {_leg(leg, place_map)}")
