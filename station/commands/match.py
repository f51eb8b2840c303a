"""`station match`: a navigation's locations against a map's places."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.errors import ConfigError
from station.commands.map_store import MapArgument, open_map
from station.commands.match_report import finish
from station.commands.options import AlignBy, Config, Data, Mode, check_out_folder
from station.commands.progress import working
from station.experiments.experiment import Experiment, Story, judge
from station.experiments.inputs import open_truth
from station.files.navigation_folder import load_navigation
from station.places.joining.match import match_navigation
from station.places.making.changes import without_hidden
from station.places.making.config import PlacesConfig, ThesisConfig


def register(app: typer.Typer) -> None:
    app.command()(match)


def match(
    which: MapArgument,
    navigation: Annotated[Path, typer.Argument(help="Folder written by `station slam`.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for results.json, report.html and figures.")],
    mode: Mode = "default",
    eps: Annotated[float, typer.Option(help="Thesis mode: DBSCAN's eps, m or normalised.")] = 0.3,
    min_pts: Annotated[int, typer.Option(help="Thesis mode: DBSCAN's MinPts.")] = 11,
    inlier_ratio: Annotated[float, typer.Option(help="Thesis mode: share of the closest pairs kept.")] = 0.75,
    truth1: Annotated[Path | None, typer.Option(help="Dataset with true poses of the map's drive.")] = None,
    truth2: Annotated[Path | None, typer.Option(help="Dataset with true poses of the navigation's drive.")] = None,
    align_by: AlignBy = "both",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    data: Data = None,
    config_file: Config = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print results.json on stdout.")] = False,
) -> None:
    """Register a navigation to a map, match its locations with the places, and write a report."""
    if (truth1 is None) != (truth2 is None):
        raise ConfigError("judging needs --truth1 and --truth2; give both or none")
    check_out_folder(out)
    config = PlacesConfig(mode, ThesisConfig(eps, min_pts, inlier_ratio), align_by)
    truths = open_truth(truth1), open_truth(truth2)
    # A place that a person has hidden is no answer here either.
    place_map, second = without_hidden(open_map(which, data, config_file)), load_navigation(navigation)
    with working(f"matching {second.id} with {place_map.name}"):
        result = match_navigation(place_map, second, config, seed=seed)
        judgement, not_judged = judge(place_map, second, truths, result)
    story = Story(title=f"{navigation.name} in {place_map.name}")
    done = Experiment(story, place_map, second, result, judgement, config, seed, {}, not_judged, truths)
    finish(done, out, as_json)
