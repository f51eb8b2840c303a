"""Maps on disk, one folder each: whole or not at all, whatever kills the process (docs/places.md, "Store").

```
<root>/<map id>.000001/    the newest number that exists is the map; older ones are being replaced
    map.json               sha256 of its content, names, places, edges, and the sha256 of every other file
    navigation/            the navigation the map was made from (station/navigation_files.py)
```
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shared.errors import DataError
from station.maps.map import Place, PlaceEdge, PlaceMap
from station.navigation_files import load_navigation, save_navigation

FORMAT = 1
MAX_NAME = 80  # characters
_FoldersOfMap = dict[str, list[Path]]  # every number there is of each map
_FOLDER = re.compile(r"(?P<id>[A-Za-z0-9][A-Za-z0-9_-]{0,99})\.(?P<number>\d{6})")


@dataclass(frozen=True, slots=True)
class MapSummary:
    """What a list of maps shows, without reading clouds and images."""

    id: str
    name: str
    places: int
    damaged: str = ""  # a sentence, where the map cannot be read


class MapStore:
    """Maps by id, in one folder."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def save(self, place_map: PlaceMap) -> None:
        """Write a map; it replaces one of the same id. Raises DataError when the folder cannot be written."""
        if not _FOLDER.fullmatch(f"{place_map.id}.000000"):
            raise DataError(f'map id "{place_map.id}" is no file name; use letters, digits, "-" and "_"')
        previous = self._folders().get(place_map.id, [])
        number = 1 + max((_number(folder) for folder in previous), default=0)
        try:
            self._root.mkdir(parents=True, exist_ok=True)
            scratch = Path(tempfile.mkdtemp(prefix=".new-", dir=self._root))
            try:
                write_map(place_map, scratch / "map")
                os.rename(scratch / "map", self._root / f"{place_map.id}.{number:06d}")
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
            _sync(self._root)
            for folder in previous:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError as exc:
            raise DataError(f"{self._root} cannot be written ({exc.strerror}); free space or choose another") from exc

    def load(self, map_id: str) -> PlaceMap:
        """Read a map. Raises DataError when there is none of this id, or naming the file that is damaged."""
        return read_map(self._newest(map_id))

    def list(self) -> tuple[MapSummary, ...]:
        """All maps, by name; a damaged one says so instead of hiding the others."""
        summaries = []
        for map_id, folders in self._folders().items():
            try:
                content = _read_content(max(folders))
                summaries.append(MapSummary(map_id, str(content["name"]), len(content["places"])))
            except DataError as exc:
                summaries.append(MapSummary(map_id, map_id, 0, damaged=str(exc)))
        return tuple(sorted(summaries, key=lambda s: (s.name, s.id)))

    def delete(self, map_id: str) -> None:
        """Forget a map. Raises DataError when there is none of this id."""
        self._newest(map_id)
        for folder in sorted(self._folders()[map_id]):  # the oldest first: an interrupted delete revives nothing old
            shutil.rmtree(folder)

    def rename_place(self, map_id: str, place_id: str, name: str) -> PlaceMap:
        """Give a place another name, and return the map. Raises DataError for an unknown place or a name in use."""
        folder = self._newest(map_id)
        place_map = with_place_renamed(read_map(folder), place_id, name)
        content = _read_content(folder)
        content["places"] = [_encode_place(place) for place in place_map.places]
        _write_content(content, folder)
        return place_map

    def _newest(self, map_id: str) -> Path:
        folders = self._folders()
        if map_id not in folders:
            known = ", ".join(sorted(folders)) or "none"
            raise DataError(f'{self._root} holds no map "{map_id}"; its maps: {known}')
        return max(folders[map_id])

    def _folders(self) -> _FoldersOfMap:
        found: _FoldersOfMap = {}
        for folder in sorted(self._root.iterdir()) if self._root.is_dir() else []:
            if (match := _FOLDER.fullmatch(folder.name)) and folder.is_dir():
                found.setdefault(match["id"], []).append(folder)
        return found


def with_place_renamed(place_map: PlaceMap, place_id: str, name: str) -> PlaceMap:
    """The map with one place named otherwise. Names are unique in a map, upper and lower case being one."""
    name = " ".join(name.split())
    if not 0 < len(name) <= MAX_NAME:
        raise DataError(f"a place's name needs 1 to {MAX_NAME} characters, not {len(name)}")
    if place_id not in {place.id for place in place_map.places}:
        raise DataError(f'map "{place_map.name}" has no place with id "{place_id}"')
    if any(place.name.casefold() == name.casefold() and place.id != place_id for place in place_map.places):
        raise DataError(f'map "{place_map.name}" has another place named "{name}"; choose a different name')
    places = tuple(replace(place, name=name) if place.id == place_id else place for place in place_map.places)
    return replace(place_map, places=places)


def write_map(place_map: PlaceMap, folder: Path) -> None:
    """Write a map into a new folder and wait until it is on the disk."""
    folder.mkdir(parents=True)
    save_navigation(place_map.navigation, folder / "navigation")
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    content = {
        "format": FORMAT,
        "id": place_map.id,
        "name": place_map.name,
        "navigation": place_map.navigation.id,
        "places": [_encode_place(place) for place in place_map.places],
        "edges": [
            {"a": e.a, "b": e.b, "bearing_rad": e.bearing_rad, "distance": e.distance, "kind": e.kind}
            for e in place_map.edges
        ],
        "config": place_map.config,
        "files": {str(path.relative_to(folder)): _sha256(path.read_bytes()) for path in files},
    }
    for path in [*files, *{path.parent for path in files}]:
        _sync(path)
    _write_content(content, folder)


def read_map(folder: Path) -> PlaceMap:
    """Read a folder written by write_map. Raises DataError naming the file that is missing or damaged."""
    content = _read_content(folder)
    for name, expected in content["files"].items():
        path = folder / name
        if not path.is_file():
            raise DataError(f"{path} is missing; restore the map from a copy or build it again")
        if _sha256(path.read_bytes()) != expected:
            raise DataError(f"{path} is damaged (its checksum differs); restore the map or build it again")
    navigation = load_navigation(folder / "navigation")
    return PlaceMap(
        id=content["id"],
        name=content["name"],
        navigation=replace(navigation, id=content["navigation"]),
        places=tuple(_decode_place(place) for place in content["places"]),
        edges=tuple(PlaceEdge(**edge) for edge in content["edges"]),
        config=content["config"],
    )


def _encode_place(place: Place) -> dict[str, Any]:
    return {
        "id": place.id,
        "name": place.name,
        "centroid_map": place.centroid_map.tolist(),
        "radius": place.radius,
        "landmark_index": place.landmark_index.tolist(),
        "keyframe_index": place.keyframe_index.tolist(),
        "representative_keyframe": place.representative_keyframe,
        "quality": place.quality,
    }


def _decode_place(values: dict[str, Any]) -> Place:
    return Place(
        id=values["id"],
        name=values["name"],
        centroid_map=np.array(values["centroid_map"], dtype=np.float64),
        radius=values["radius"],
        landmark_index=np.array(values["landmark_index"], dtype=np.int64),
        keyframe_index=np.array(values["keyframe_index"], dtype=np.int64),
        representative_keyframe=values["representative_keyframe"],
        quality=values["quality"],
    )


def _write_content(content: dict[str, Any], folder: Path) -> None:
    body = json.dumps(content, indent=1)
    scratch = folder / ".map.json"
    scratch.write_text(json.dumps({"sha256": _sha256(body.encode())}) + "\n" + body)
    _sync(scratch)
    os.replace(scratch, folder / "map.json")
    _sync(folder)


def _read_content(folder: Path) -> dict[str, Any]:
    path = folder / "map.json"
    try:
        head, _, body = path.read_text().partition("\n")
        if json.loads(head)["sha256"] != _sha256(body.encode()):
            raise DataError(f"{path} is damaged (its checksum differs); restore the map or build it again")
        content: dict[str, Any] = json.loads(body)
    except FileNotFoundError as exc:
        raise DataError(f"{folder} holds no map (no map.json); give a folder written by `station map build`") from exc
    except (ValueError, KeyError, TypeError, OSError) as exc:
        raise DataError(f"{path} is damaged; restore the map from a copy or build it again") from exc
    if content.get("format") != FORMAT:
        raise DataError(f"{path} has format {content.get('format')}, this program reads {FORMAT}; update the station")
    return content


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _number(folder: Path) -> int:
    return int(folder.name.rpartition(".")[2])


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
