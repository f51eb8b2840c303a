"""Where a map store is, and what it says of a map without reading it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

VersionKind = Literal["saved", "edited", "restored", "deleted"]


@dataclass(frozen=True, slots=True)
class StoreAddress:
    """Where a store is. Picklable: worker processes are given it."""

    root: Path  # the folder of maps.db, blobs and records where no URL says otherwise
    database: str = ""  # postgresql://user@host/name; empty: SQLite in the folder
    blobs: str = ""  # a URL that fsspec knows; empty: in the folder
    author: str = ""  # the station's name, kept with every version it writes


@dataclass(frozen=True, slots=True)
class MapSummary:
    """What a list of maps shows, without reading clouds and images."""

    id: str
    name: str
    places: int
    damaged: str = ""  # a sentence, where the map cannot be read
