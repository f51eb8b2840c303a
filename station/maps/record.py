"""One version of a map as a document: what places there are, and the addresses of the files they were made from."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from shared.bounded import parse_json, shown
from shared.errors import DataError
from shared.text import is_printable, printable
from station.files.navigation_folder import DEPTH, REPORT, decode_navigation, encode_navigation
from station.files.npz import UNREADABLE as UNREADABLE_ARRAYS
from station.maps.address import address_of
from station.maps.blobs import REPAIR_OR_RESTORE, Blobs, Damaged
from station.maps.plan_files import CELLS, PlanRecord, decode_plan, describe_plan, encode_plan, plan_files, with_plan
from station.model.map_store import VersionKind
from station.model.place_map import Place, PlaceEdge, PlaceMap

FORMAT = 2  # 1 was a folder per map (station/maps/folder.py)
MAP_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}")
UNREADABLE = (ValueError, KeyError, TypeError, OverflowError, msgspec.ValidationError)  # of a document that is none
# Names that no person gave, in records from before it was noted who gave them: "Place 17", "Kitchen · 2".
_MADE_UP = re.compile(r"Place \d+|.+ · (\d+|door side)")
_MEASURED = ("wall_s", "cpu_s", "realtime_factor", "versions", "id")  # differ between runs that gave the same


@dataclass(frozen=True, slots=True)
class FileRef:
    """A file of the map's navigation, or the cells of its floor plan."""

    address: str
    size: int


@dataclass(frozen=True, slots=True, eq=False)
class MapRecord:
    """A version. `number` counts a map's versions from 1; the highest is the map."""

    map_id: str
    name: str
    navigation: str  # its id
    places: tuple[Place, ...]
    edges: tuple[PlaceEdge, ...]
    config: dict[str, Any]
    files: dict[str, FileRef]
    plan: PlanRecord | None = None
    # Its place in a history; as it stands here, none yet:
    number: int = 0
    kind: VersionKind = "saved"
    why: str = "saved"  # or "Place 3 is now Sofa": for a person
    author: str = ""  # the station that wrote it
    created_ms: int = 0  # since 1970
    previous: int | None = None  # the version whose content this one changed; undo goes back there
    content: int = 0  # the version that first had this content: its own number, or of the one it restores


def describe_map(place_map: PlaceMap, files: dict[str, FileRef]) -> MapRecord:
    """A record of this content, still without place in a history. Raises DataError: a name cannot be shown."""
    for name in (place_map.name, *(place.name for place in place_map.places)):
        if not is_printable(name):
            raise DataError(f"map {place_map.id}: the name {name!r} holds characters that cannot be shown")
    return MapRecord(
        map_id=place_map.id,
        name=place_map.name,
        navigation=place_map.navigation.id,
        places=place_map.places,
        edges=place_map.edges,
        config=place_map.config,
        files=files,
        plan=describe_plan(place_map),
    )


def map_files(place_map: PlaceMap) -> dict[str, bytes]:
    """The files of a map: their names, and what is in them."""
    return encode_navigation(place_map.navigation) | plan_files(place_map)


def read_map(record: MapRecord, blobs: Blobs) -> PlaceMap:
    """The map of a record. Raises Damaged naming the file that cannot be had."""
    what = Path(f"map {record.map_id}, version {record.number}")

    def read(name: str) -> bytes:
        if name not in record.files:
            raise Damaged(f"{what}: its record names no {name}; run `station map repair` or restore a backup")
        return blobs.get(record.files[name].address, f"{what}: {name}")

    navigation = decode_navigation(read, what, has_depth=DEPTH in record.files)
    place_map = PlaceMap(
        id=record.map_id,
        name=record.name,
        navigation=replace(navigation, id=record.navigation),
        places=record.places,
        edges=record.edges,
        config=record.config,
    )
    try:
        check_references(place_map)
    except ValueError as exc:
        raise Damaged(f"{what}: {exc}; {REPAIR_OR_RESTORE}") from exc
    if record.plan is None:
        return place_map
    try:
        return with_plan(place_map, record.plan, read(CELLS))
    except UNREADABLE_ARRAYS as exc:
        raise Damaged(f"{what}: {CELLS} is no floor plan ({shown(exc)}); {REPAIR_OR_RESTORE}") from exc


def check_references(place_map: PlaceMap) -> None:
    """Whatever a place or an edge names is in the map. Raises ValueError: somebody's record names something else."""
    ids = {place.id for place in place_map.places}
    num_keyframes, num_landmarks = len(place_map.navigation.keyframes.t_robot_ns), len(place_map.navigation.landmarks)
    if len(ids) < len(place_map.places):
        raise ValueError("two of its places have one id")
    for place in place_map.places:
        keyframes = place.keyframe_index
        if place.representative_keyframe != -1:  # a place without images
            keyframes = np.append(keyframes, place.representative_keyframe)
        for kind, index, count in (
            ("landmark", place.landmark_index, num_landmarks),
            ("keyframe", keyframes, num_keyframes),
        ):
            if len(index) and not 0 <= index.min() <= index.max() < count:
                raise ValueError(f"a place of it names a {kind} that is not there")
    if any({edge.a, edge.b} - ids for edge in place_map.edges):
        raise ValueError("an edge of it leads to a place that is not there")


def same_places(a: MapRecord, b: MapRecord) -> bool:
    """Whether two versions of a map, its rooms included, differ in nothing but its name and what is suggested."""
    return encode_content(_unnamed(a)) == encode_content(_unnamed(b))


def _unnamed(record: MapRecord) -> MapRecord:
    return replace(record, name="", plan=None if record.plan is None else replace(record.plan, suggestions=()))


def same_content(a: MapRecord, b: MapRecord) -> bool:
    """Whether two records say the same of the map, whatever their place in its history."""
    unplaced = replace(b, **{key: getattr(a, key) for key in _HISTORY})
    return encode_record(a) == encode_record(unplaced)


def encode_record(record: MapRecord) -> bytes:
    """As JSON."""
    content = {
        "format": FORMAT,
        **{key: getattr(record, key) for key in _PLAIN},
        **encode_content(record),
        "files": {name: asdict(ref) for name, ref in record.files.items()},
    }
    return json.dumps(content, indent=1).encode()


def decode_record(data: bytes, what: str) -> MapRecord:
    """Raises Damaged when these bytes are no record, DataError when a newer program wrote it."""
    try:
        content = parse_json(data)
        if content["format"] > FORMAT:
            raise DataError(f"{what} has format {content['format']}, this program reads {FORMAT}; update the station")
        msgspec.convert(content, _Document)
        return MapRecord(
            **{key: _shown(content[key]) for key in _PLAIN},
            places=decode_places(content["places"]),
            edges=decode_edges(content["edges"]),
            config=content["config"],
            files={name: FileRef(**ref) for name, ref in content["files"].items()},
            plan=decode_plan(content),
        )
    except UNREADABLE as exc:
        raise Damaged(f"{what} is no record of a map ({shown(exc)}); run `station map repair`") from exc


def content_hash(record: MapRecord, report: bytes) -> str:
    """SHA-256 over what the map is: places, edges, rooms, settings, files; not when, by whom or how fast it was made.

    `report` is the content of its navigation.json. Two runs that gave the same map give the same hash.
    """
    files = {name: ref.address.partition("-")[0] for name, ref in record.files.items()}
    files[REPORT] = json.dumps({k: v for k, v in json.loads(report).items() if k not in _MEASURED}, sort_keys=True)
    return hashlib.sha256(
        json.dumps([encode_content(record), sorted(files.items())], sort_keys=True).encode()
    ).hexdigest()


def map_content_hash(place_map: PlaceMap) -> str:
    """As content_hash, of a map that was not stored (or not read back: files round poses to nine digits)."""
    files = map_files(place_map)
    refs = {name: FileRef(address_of(data), len(data)) for name, data in files.items()}
    return content_hash(describe_map(place_map, refs), files[REPORT])


def encode_content(record: MapRecord) -> dict[str, Any]:
    """What it says of the map, in plain types."""
    return {
        "name": record.name,
        "navigation": record.navigation,
        "places": [encode_place(place) for place in record.places],
        "edges": [asdict(edge) for edge in record.edges],
        "config": record.config,
        **encode_plan(record.plan),
    }


_HISTORY = ("number", "kind", "why", "author", "created_ms", "previous", "content")
_PLAIN = ("map_id", "number", "kind", "why", "author", "created_ms", "previous", "content", "name", "navigation")


def encode_place(place: Place) -> dict[str, Any]:
    """A place in plain types."""
    return {
        "id": place.id,
        "name": place.name,
        "centroid_map": place.centroid_map.tolist(),
        "radius": place.radius,
        "landmark_index": place.landmark_index.tolist(),
        "keyframe_index": place.keyframe_index.tolist(),
        "representative_keyframe": place.representative_keyframe,
        "quality": place.quality,
        **({"hidden": True} if place.hidden else {}),  # absent: as in records from before places could be hidden
        **({"named": place.named} if place.named == _is_made_up(place.name) else {}),  # absent: as the name reads
    }


def decode_places(documents: list[dict[str, Any]]) -> tuple[Place, ...]:
    """The places that `encode_content` wrote. Raises one of UNREADABLE, also for a place that is nowhere."""
    return tuple(_decode_place(document) for document in documents)


def decode_edges(documents: list[dict[str, Any]]) -> tuple[PlaceEdge, ...]:
    """The edges that `encode_content` wrote. Raises one of UNREADABLE."""
    edges = msgspec.convert(documents, tuple[PlaceEdge, ...])
    _check_finite(number for edge in edges for number in (edge.bearing_rad, edge.distance))
    return edges


def _shown(value: Any) -> Any:
    """A value that people are shown: without what a terminal obeys, which earlier releases let into names."""
    return printable(value) if isinstance(value, str) else value


def _decode_place(values: dict[str, Any]) -> Place:
    msgspec.convert(values, _PlaceDocument)
    _check_finite((*values["centroid_map"], values["radius"], values["quality"]))
    return Place(
        id=values["id"],
        name=_shown(values["name"]),
        centroid_map=np.array(values["centroid_map"], dtype=np.float64),
        radius=values["radius"],
        landmark_index=np.array(values["landmark_index"], dtype=np.int64),
        keyframe_index=np.array(values["keyframe_index"], dtype=np.int64),
        representative_keyframe=values["representative_keyframe"],
        quality=values["quality"],
        hidden=values.get("hidden", False),
        named=values.get("named", not _is_made_up(values["name"])),
    )


def _is_made_up(name: str) -> bool:
    """Whether a name reads as if no person gave it: a person may have given it all the same, which is then noted."""
    return _MADE_UP.fullmatch(name) is not None


def _check_finite(numbers: Iterable[float]) -> None:
    if not all(map(math.isfinite, numbers)):
        raise ValueError("a number of it is not finite")


class _PlaceDocument(msgspec.Struct):
    id: str
    name: str
    centroid_map: tuple[float, float, float]
    radius: float
    landmark_index: list[int]
    keyframe_index: list[int]
    representative_keyframe: int
    quality: float
    hidden: bool = False
    named: bool = False


class _Document(msgspec.Struct):
    """What must be in a record, but for its places and edges."""

    map_id: Annotated[str, msgspec.Meta(pattern=f"^{MAP_ID.pattern}$")]  # it becomes a file's name
    number: Annotated[int, msgspec.Meta(ge=1, lt=2**31)]
    kind: VersionKind
    why: str
    author: str
    created_ms: Annotated[int, msgspec.Meta(ge=0, lt=2**62)]
    previous: int | None
    content: int
    name: str
    navigation: str
    config: dict[str, Any]
    files: dict[str, FileRef]
