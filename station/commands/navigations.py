"""Navigations that a command is given: a folder of one, a map's, or the id of a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.errors import DataError
from station.commands.map_store import open_map
from station.files.navigation_folder import load_navigation
from station.model.navigation import Navigation

NavigationArgument = Annotated[
    str,
    typer.Argument(
        metavar="NAVIGATION",
        help="Folder of a navigation (station slam, or one of the station's) or of a map (station map build);"
        " or id of a map the station keeps.",
    ),
]


def open_navigation(source: str, data: Path | None, config: Path | None) -> Navigation:
    """A navigation, or the one that a map was made from. Raises DataError where there is none, or a damaged one."""
    folder = navigation_folder(Path(source))
    if folder is not None:
        return load_navigation(folder)
    if len(Path(source).parts) > 1 and not Path(source).is_dir():
        raise DataError(
            f"{source} is no folder; give one written by `station slam` or `station map build`, or a map's id"
        )
    return open_map(source, data, config).navigation


def navigation_folder(source: Path) -> Path | None:
    """Where a navigation lies: in this folder, or below it, when a station made it. A map's folder holds one too."""
    if (source / "map.json").is_file():
        return None
    return next((folder for folder in (source, source / "navigation") if (folder / "navigation.json").is_file()), None)
