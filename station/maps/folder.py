"""One map as a folder of its own, as `station map build` writes it.

```
map.json               sha256 of its content, names, places, edges, rooms, and the sha256 of every other file
floor_plan.npz         cells and walls of its floor plan, where it has one
navigation/            the navigation the map was made from (station/files/navigation_folder.py)
```
The map store of the first release kept maps this way too; the present one imports them (opening.py).
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from shared.bounded import MAX_FILE_BYTES, MAX_JSON_BYTES, open_file, parse_json, read_file, read_text, shown
from shared.disk import make_folder, replacing_folder, settle_folder
from shared.errors import DataError
from station.files.navigation_folder import load_navigation, save_navigation
from station.files.npz import UNREADABLE as UNREADABLE_ARRAYS
from station.maps.plan_files import CELLS, decode_plan, plan_files, with_plan
from station.maps.record import UNREADABLE, check_references, decode_edges, decode_places, describe_map, encode_content
from station.model.place_map import PlaceMap

FORMAT = 1


def save_map_folder(place_map: PlaceMap, folder: Path, extras: Mapping[str, str] | None = None) -> None:
    """Write a map, whole or not at all, replacing one that is there; `extras` are text files put beside it.

    What else a person put beside the one that is there stays.

    Raises:
        DataError: the folder holds something else, or cannot be written.
    """
    folder = folder.absolute()
    if folder.exists() and not (folder / "map.json").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError(f"{folder} exists and is no map; give a new folder")
    try:
        make_folder(folder.parent)
        with replacing_folder(folder) as fresh:
            _write_map(place_map, fresh)
            for name, text in (extras or {}).items():
                (fresh / name).write_text(text, encoding="utf-8")
            _copy_others(folder, fresh)
    except OSError as exc:
        raise DataError(f"{folder} cannot be written ({exc.strerror}); choose another folder") from exc


def _copy_others(folder: Path, fresh: Path) -> None:
    """What lies in a folder beside its map."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name == CELLS or (fresh / path.name).exists():  # a map without a plan has no cells
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.copytree(path, fresh / path.name, symlinks=True)
        else:
            shutil.copy2(path, fresh / path.name, follow_symlinks=False)


def _write_map(place_map: PlaceMap, folder: Path) -> None:
    save_navigation(place_map.navigation, folder / "navigation")
    for name, data in plan_files(place_map).items():
        (folder / name).write_bytes(data)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    content = {
        "format": FORMAT,
        "id": place_map.id,
        **encode_content(describe_map(place_map, {})),
        "files": {str(path.relative_to(folder)): _sha256(path.read_bytes()) for path in files},
    }
    body = json.dumps(content, indent=1)
    (folder / "map.json").write_text(json.dumps({"sha256": _sha256(body.encode())}) + "\n" + body)


class _Document(msgspec.Struct):
    """What must be in map.json."""

    id: str
    name: str
    navigation: str
    places: list[dict[str, Any]]
    edges: list[dict[str, Any]]
    config: dict[str, Any]
    files: dict[str, str]  # path → SHA-256


def load_map_folder(folder: Path) -> PlaceMap:
    """Read a folder written by save_map_folder. Raises DataError naming the file that is missing or damaged."""
    settle_folder(folder)
    path = folder / "map.json"
    try:
        content = _read_content(folder)
        document = msgspec.convert(content, _Document)
        places, edges, plan = decode_places(document.places), decode_edges(document.edges), decode_plan(content)
    except UNREADABLE as exc:
        raise DataError(f"{path} is no map ({shown(exc)}); restore it from a copy or build it again") from exc
    for name, expected in document.files.items():
        _check_file(folder / name, expected)
    navigation = replace(load_navigation(folder / "navigation"), id=document.navigation)
    place_map = PlaceMap(document.id, document.name, navigation, places, edges, document.config)
    try:
        check_references(place_map)
    except ValueError as exc:
        raise DataError(f"{path}: {exc}; restore it from a copy or build it again") from exc
    if plan is None:
        return place_map
    if CELLS not in document.files:
        raise DataError(f"{path} has rooms but names no {CELLS}; restore it from a copy or build it again")
    try:
        return with_plan(place_map, plan, read_file(folder / CELLS, MAX_FILE_BYTES))
    except UNREADABLE_ARRAYS as exc:
        why = shown(exc)
        raise DataError(f"{folder / CELLS} is no floor plan ({why}); restore the map or build it again") from exc


def _check_file(path: Path, expected: str) -> None:
    try:
        with open_file(path) as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as exc:
        why = exc.strerror
        raise DataError(f"{path} is missing ({why}); restore the map from a copy or build it again") from exc
    if digest != expected:
        raise DataError(f"{path} is damaged (its checksum differs); restore the map or build it again")


def _read_content(folder: Path) -> dict[str, Any]:
    path = folder / "map.json"
    try:
        head, _, body = read_text(path, MAX_JSON_BYTES).partition("\n")
        if parse_json(head)["sha256"] != _sha256(body.encode()):
            raise DataError(f"{path} is damaged (its checksum differs); restore the map or build it again")
        content = parse_json(body)
        file_format = content["format"]
    except FileNotFoundError as exc:
        raise DataError(f"{folder} holds no map (no map.json); give a folder written by `station map build`") from exc
    except (ValueError, KeyError, TypeError, OSError) as exc:
        raise DataError(f"{path} is damaged ({shown(exc)}); restore the map or build it again") from exc
    if file_format != FORMAT:
        raise DataError(f"{path} has format {shown(file_format)}, this program reads {FORMAT}; update the station")
    return content


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
