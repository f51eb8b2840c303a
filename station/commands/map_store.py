"""`station map list, history, undo, delete, purge, verify, repair, backup, restore`: the maps a station keeps."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from shared.advice import complete
from shared.errors import DataError
from station.commands.options import Config, Data, Json, data_folder
from station.commands.progress import working
from station.config import load_config
from station.maps.blobs import REPAIR_OR_RESTORE
from station.maps.contents import NoSuchMap
from station.maps.folder import load_map_folder
from station.maps.record_files import ASIDE, record_files
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap

MapId = Annotated[str, typer.Argument(metavar="MAP", help="Id of a map; `station map list` shows them.")]
MapArgument = Annotated[
    str, typer.Argument(metavar="MAP", help="Folder written by `station map build`, or id of a map the station keeps.")
]


def register(maps: typer.Typer) -> None:
    maps.command("list")(list_maps)
    maps.command("history")(history)
    maps.command("undo")(undo)
    maps.command("delete")(delete)
    maps.command("purge")(purge_map)
    maps.command("verify")(verify_maps)
    maps.command("repair")(repair_maps)
    maps.command("backup")(backup)
    maps.command("restore")(restore)


def store_address(data: Path | None, config: Path | None) -> StoreAddress:
    """Where the maps of a station with this data folder and this configuration lie."""
    settings = load_config(config)
    root = data_folder(data, settings) / "maps"
    return StoreAddress(root, settings.store.database, settings.store.blobs, settings.name)


def hint(sentence: str, data: Path | None, config: Path | None) -> str:
    """A sentence in which every command that it advises reaches the same maps."""
    return complete(sentence, "station", {"--data": data, "--config": config})


def list_maps(data: Data = None, config: Config = None, as_json: Json = False) -> None:
    """The maps of a station, and those that were deleted but not purged."""
    store = open_store(data, config)
    maps, deleted = store.list(), store.deleted()
    if as_json:
        shown = [
            {"id": s.id, "name": s.name, "places": s.places, "deleted": s in deleted, "damaged": s.damaged}
            for s in (*maps, *deleted)
        ]
        print(json.dumps({"maps": shown}))
        return
    for summary in maps:
        print(f"{summary.id}  {summary.name}: {summary.damaged or f'{summary.places} places'}")
    for summary in deleted:
        undeleted = hint(f"`station map undo {summary.id}` brings it back", data, config)
        print(f"{summary.id}  {summary.name}: deleted; {undeleted}")
    if not maps and not deleted:
        place = store.contents.bucket.place
        is_there = "://" in place or Path(place).is_dir()
        print(f"no maps in {place}" + ("" if is_there else ", which is not there: is it the right folder?"))


def history(map_id: MapId, data: Data = None, config: Config = None, as_json: Json = False) -> None:
    """Every version of a map, the newest first."""
    with in_folder(data):
        records = open_store(data, config).history(map_id)
    if as_json:
        keys = ("number", "kind", "why", "author", "created_ms", "previous", "content", "name")
        print(json.dumps({"versions": [{key: getattr(record, key) for key in keys} for record in records]}))
        return
    for record in records:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(record.created_ms / 1000))
        author = f" by {record.author}" if record.author else ""
        print(f"{record.number:4d}  {when}  {record.kind}{author}: {record.why} ({len(record.places)} places)")


def undo(
    map_id: MapId,
    to: Annotated[int | None, typer.Option("--to", help="Go to this version instead of one step back.")] = None,
    data: Data = None,
    config: Config = None,
) -> None:
    """Take back the last change of a map, also its deletion; again: the change before."""
    with in_folder(data):
        record = open_store(data, config).undo(map_id, to)
    print(
        f"{record.name} ({map_id}) is {record.why}, with {len(record.places)} places; this is version {record.number}"
    )


def delete(map_id: MapId, data: Data = None, config: Config = None) -> None:
    """Delete a map; `station map undo MAP` brings it back until it is purged."""
    with in_folder(data):
        open_store(data, config).delete(map_id)
    sentence = (
        f"{map_id} is deleted; `station map undo {map_id}` brings it back,"
        f" `station map purge {map_id} --yes` frees its space"
    )
    print(hint(sentence, data, config))


def purge_map(
    map_id: MapId,
    yes: Annotated[bool, typer.Option("--yes", help="Do it: there is no way back.")] = False,
    data: Data = None,
    config: Config = None,
) -> None:
    """Forget the earlier versions of a map for good; a deleted map altogether."""
    if not yes:
        raise DataError(f"purging {map_id} cannot be undone; add --yes")
    from station.maps.repair.purging import purge_versions

    for sentence in purge_versions(open_store(data, config).for_writing(), map_id):
        print(sentence)


def verify_maps(data: Data = None, config: Config = None, as_json: Json = False) -> None:
    """Compare every byte of every version with its checksum. Exit code 1 when something is damaged."""
    from station.maps.repair.check import verify

    found: list[str] = []
    store = existing_store(data, config, found)
    with working("comparing checksums"):
        damages = verify(store)
    if as_json:
        print(json.dumps({"repaired": found, "damaged": [damage.sentence for damage in damages]}))
    else:
        for sentence in dict.fromkeys((*found, *(damage.sentence for damage in damages))):
            print(hint(sentence, data, config))
        if not damages:
            print("all maps are as they were written" if store.list() else f"no maps in {store.contents.bucket.place}")
        for aside in record_files(store.contents.bucket, ASIDE):
            print(f"version {aside.number} of map {aside.map_id} was lost: {store.contents.bucket.place}/{aside.name}")
    if damages:
        sys.exit(1)


def repair_maps(
    copies: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FOLDER]...", help="Folders that may hold copies of damaged files."),
    ] = None,
    data: Data = None,
    config: Config = None,
) -> None:
    """Put right what can be: from checksums, from the navigations maps were made from, from earlier versions."""
    from station.maps.repair.check import repair

    found: list[str] = []
    address = store_address(data, config)
    for folder in copies or []:
        if not folder.is_dir():
            raise DataError(f"{folder} is no folder; name one that may hold copies of damaged files")
    folders = [folder for folder in (address.root.parent / "navigations", *(copies or [])) if folder.is_dir()]
    store = existing_store(data, config, found)
    with working("repairing"):
        result = repair(store, folders)
    for sentence in dict.fromkeys((*found, *result.done)):
        print(hint(sentence, data, config))
    for damage in result.left:
        advice = "name a folder that may hold a copy of it, or restore a backup"
        print(f"not repaired: {damage.sentence.replace(REPAIR_OR_RESTORE, advice)}")
    if result.left:
        sys.exit(1)
    print("nothing is damaged any more" if result.done else "all maps are as they were written")


def backup(
    out: Annotated[Path, typer.Argument(metavar="FILE", help="File to write, .tar; must not exist.")],
    data: Data = None,
    config: Config = None,
) -> None:
    """All maps with their history in one file."""
    from station.maps.backup import write_backup

    store = existing_store(data, config)
    with working(f"writing {out}"):
        report = write_backup(store, out)
    for sentence in report.damaged:
        print(f"not in the backup: {sentence}", file=sys.stderr)
    print(f"{report.maps} maps, {report.versions} versions, {report.bytes / 1e6:.1f} MB, written to {out}")
    if report.damaged:
        sys.exit(1)


def restore(
    file: Annotated[Path, typer.Argument(help="File written by `station map backup`.")],
    data: Data = None,
    config: Config = None,
) -> None:
    """Bring the maps of a backup into this station; what it has already stays in the history."""
    from station.maps.backup import restore_backup

    store = open_store(data, config)
    with working(f"reading {file}"):
        report = restore_backup(store, file)
    for sentence in report.damaged:
        print(sentence, file=sys.stderr)
    print(f"{report.maps} maps read from {file}, {report.versions} versions added")
    if report.versions:
        print("a station looks for its robot in the maps chosen on its page, or by PUT /maps/active")
    if report.damaged:
        sys.exit(1)


def open_map(which: str, data: Path | None, config: Path | None) -> PlaceMap:
    """A map from a folder, or from the station's store.

    Raises:
        DataError: there is none, or it is damaged.
    """
    if is_folder(which):
        return load_map_folder(Path(which))
    if len(Path(which).parts) > 1:
        raise DataError(f"{which} is no folder; give one written by `station map build`, or the id of a map")
    with in_folder(data):
        return open_store(data, config).load(which)


@contextmanager
def in_folder(data: Path | None) -> Iterator[None]:
    """Where a map is not in the folder that is looked in by default, the sentence says how to name another one."""
    try:
        yield
    except NoSuchMap as exc:
        if data is not None:
            raise
        raise DataError(f"{exc}; where the station keeps its maps elsewhere, name its data folder with --data") from exc


def is_folder(which: str) -> bool:
    """Whether a map is given by its folder; one in the working directory may have the id of a map by chance."""
    folder = Path(which)
    return (folder / "map.json").is_file() or (len(folder.parts) > 1 and folder.is_dir())


def existing_store(data: Path | None, config: Path | None, found: list[str] | None = None) -> MapStore:
    """Raises DataError where nobody ever kept anything: a mistyped folder must not look like a sound one."""
    store = open_store(data, config, found)
    if store.contents.database.is_sqlite and not store.address.root.parent.is_dir():
        raise DataError(f"{store.address.root.parent} is not there; name the station's data folder with --data")
    return store


def open_store(data: Path | None, config: Path | None, found: list[str] | None = None) -> MapStore:
    """What it tells goes to stderr, unless it is to be found."""
    address = store_address(data, config)
    if found is not None:
        return MapStore(address, found.append)
    return MapStore(address, lambda sentence: print(hint(sentence, data, config), file=sys.stderr))
