"""One map as a folder of its own, as `station map build --out` writes it: the store's format without its numbering."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from shared.errors import DataError
from station.maps.map import PlaceMap
from station.maps.store import read_map, write_map


def save_map_folder(place_map: PlaceMap, folder: Path, extras: Mapping[str, str] | None = None) -> None:
    """Write a map, whole or not at all, replacing one that is there; `extras` are text files put beside it.

    Raises:
        DataError: the folder holds something else, or cannot be written.
    """
    folder = folder.absolute()
    if folder.exists() and not (folder / "map.json").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError(f"{folder} exists and is no map; give a new folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            write_map(place_map, scratch / "new")
            for name, text in (extras or {}).items():
                (scratch / "new" / name).write_text(text, encoding="utf-8")
            if folder.exists():
                os.rename(folder, scratch / "old")
            os.rename(scratch / "new", folder)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as exc:
        raise DataError(f"{folder} cannot be written ({exc.strerror}); choose another folder") from exc


def load_map_folder(folder: Path) -> PlaceMap:
    """Read a map folder. Raises DataError naming the file that is missing or damaged."""
    return read_map(folder)
