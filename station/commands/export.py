"""`station export`: a navigation or map in formats that other tools read."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import typer

from shared.errors import DataError
from station.commands.map_store import open_map
from station.commands.navigations import navigation_folder
from station.commands.options import Config, Data
from station.files.colmap import export_colmap
from station.files.export import export_euroc, export_mcap, export_ply
from station.files.navigation_folder import format_tum, load_navigation
from station.model.floor_plan import FloorPlan
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.making.changes import without_hidden
from station.places.making.graph import to_graphml
from station.places.rooms.edits import require_plan
from station.places.rooms.geojson import floorplan_json
from station.places.rooms.planning import planned
from station.places.rooms.png import floorplan_png
from station.places.rooms.svg import floorplan_svg


def register(app: typer.Typer) -> None:
    app.command()(export)


def export(
    source: Annotated[
        str,
        typer.Argument(
            metavar="NAVIGATION|MAP",
            help="Folder of a navigation (station slam, or one of the station's) or of a map (station map build);"
            " or id of a map the station keeps.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="File to write; a folder for euroc and colmap. Must not exist.")],
    file_format: Annotated[
        Literal["tum", "ply", "graphml", "euroc", "mcap", "colmap", "floorplan"],
        typer.Option("--format", help="What to write."),
    ],
    data: Data = None,
    config: Config = None,
) -> None:
    """Write trajectory (tum, euroc), cloud (ply), place graph (graphml), COLMAP model, or all for Foxglove (mcap).

    A map's floor plan (floorplan) is drawn as the file's ending says: .svg, .png, or .json (GeoJSON).
    """
    drawn = _floorplan_format(out) if file_format == "floorplan" else None
    try:
        is_taken = out.exists()
    except OSError as exc:  # too long a name
        raise DataError(f"{out} cannot be written ({exc.strerror}); choose another place") from exc
    if is_taken:
        raise DataError(f"{out} exists already; give a new name with --out")
    place_map: PlaceMap | None = None
    folder = navigation_folder(Path(source))
    if folder is not None:
        nav = load_navigation(folder)
    else:
        place_map = open_map(source, data, config)
        nav = place_map.navigation
    if file_format == "graphml":
        if place_map is None:
            raise DataError(f"{source} is a navigation and has no place graph; give a map for --format graphml")
        text = to_graphml(without_hidden(place_map))
        _whole_or_not(out, lambda path: path.write_text(text))
        return
    if drawn is not None:
        if place_map is None:
            raise DataError(f"{source} is a navigation and has no rooms; give a map for --format floorplan")
        with_plan = place_map if place_map.plan is not None else planned(place_map)
        picture = drawn(require_plan(with_plan), without_hidden(with_plan))
        _whole_or_not(out, lambda path: path.write_bytes(picture))
        return
    if file_format in ("tum", "euroc") and not len(nav.trajectory):
        raise DataError(f"{source} has no trajectory to write, not one pose; make the navigation again")
    writers: dict[str, Callable[[Navigation, Path], object]] = {
        "tum": lambda nav, path: path.write_text(format_tum(nav.trajectory)),
        "ply": export_ply,
        "euroc": export_euroc,
        "mcap": export_mcap,
        "colmap": export_colmap,
    }
    _whole_or_not(out, lambda path: writers[file_format](nav, path))


def _floorplan_format(out: Path) -> Callable[[FloorPlan, PlaceMap], bytes]:
    makers = {".svg": floorplan_svg, ".png": floorplan_png, ".json": floorplan_json, ".geojson": floorplan_json}
    if out.suffix.lower() not in makers:
        raise DataError(f"{out} does not say how to draw a floor plan; let its name end in .svg, .png or .json")
    return makers[out.suffix.lower()]


def _whole_or_not(out: Path, write: Callable[[Path], object]) -> None:
    """Write beside the target first: what has the name is complete."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as exc:
        raise DataError(f"{out} cannot be written ({exc.strerror}); choose another place") from exc
    try:
        write(scratch / "whole")
        (scratch / "whole").rename(out)
    except OSError as exc:
        raise DataError(f"{out} cannot be written ({exc.strerror}); choose another place") from exc
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
