"""Opens a map, from a folder or from the store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.errors import DataError
from station.commands import map_store
from station.maps.folder import load_map_folder
from station.model.place_map import PlaceMap

MapArgument = Annotated[
    str, typer.Argument(metavar="MAP", help="Folder written by `station map build`, or id of a map the station keeps.")
]


def open_map(which: str, data: Path | None, config: Path | None) -> PlaceMap:
    """A map from a folder, or from the station's store.

    Raises:
        DataError: there is none, or it is damaged.
    """
    if Path(which).is_dir():
        return load_map_folder(Path(which))
    if len(Path(which).parts) > 1:
        raise DataError(f"{which} is no folder; give one written by `station map build`, or the id of a map")
    return map_store.open_store(data, config).load(which)
