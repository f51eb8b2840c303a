"""All maps of a store in one file, and back: a plain tar of records and blobs, each under its checksum."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from shared.disk import PRIVATE, make_folder, replacing
from shared.errors import DataError
from station.maps import versions
from station.maps.address import ADDRESS, address_of, heal, is_whole
from station.maps.blobs import Damaged, blob_name
from station.maps.contents import Contents, row_of
from station.maps.record import MapRecord, decode_record
from station.maps.record_files import parse_record_name
from station.maps.store import MapStore

README = b"Maps of a Sentinel station: `station map restore FILE` brings them back. File names end in sha256-crc32.\n"


@dataclass(frozen=True, slots=True)
class BackupReport:
    """What went into or came out of a backup."""

    maps: int
    versions: int
    bytes: int
    damaged: tuple[str, ...]  # sentences about what is not in it


def write_backup(store: MapStore, path: Path) -> BackupReport:
    """Every version whose record can be read, into a new file that appears when it is whole.

    Raises:
        DataError: the file exists or cannot be written.
    """
    if path.exists():
        raise DataError(f"{path} exists already; give a new name")
    store.open()
    damaged: list[str] = []
    records = list(_readable(store, damaged))
    try:
        make_folder(path.parent)
        with replacing(path, mode=PRIVATE) as file, tarfile.open(fileobj=file, mode="w|") as archive:
            _add(archive, "README.txt", README)
            written: set[str] = set()
            for record, data in records:  # first: a file that is cut later still says what there was
                _add(archive, row_of(record, data).file.name, data)
            for record, _ in records:
                _add_blobs(store.contents, archive, record, written, damaged)
    except OSError as exc:
        raise DataError(f"{path} cannot be written ({exc.strerror}); free space or choose another place") from exc
    return BackupReport(len({r.map_id for r, _ in records}), len(records), path.stat().st_size, tuple(damaged))


def restore_backup(store: MapStore, path: Path) -> BackupReport:
    """Bring the maps of a backup into a store.

    A map the store does not have comes with its whole history; one it has gets the backup's newest content as a new
    version, unless that is in its history already. Nothing of the store is lost.

    Raises:
        DataError: this is no backup, or the store cannot be written.
    """
    damaged: list[str] = []
    records: dict[str, list[tuple[MapRecord, bytes]]] = {}
    contents = store.for_writing()
    there: set[str] = set()
    try:
        with tarfile.open(path, mode="r|") as archive:
            for name, data in _members(archive):
                file = parse_record_name(name)
                address = file.address if file else name.rpartition("/")[2]
                whole = data if is_whole(data, address) else heal(data, address)
                if whole is None:
                    damaged.append(f"{path}: {name} is damaged (its checksum differs); it is left out")
                    continue
                if whole is not data:
                    store.notify(f"{path}: {name} had one wrong bit; it is put right. Check the disk")
                if file:
                    records.setdefault(file.map_id, []).append((decode_record(whole, name), whole))
                else:
                    contents.blobs.put([whole])
                    there.add(address)
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a file written by `station map backup`") from exc
    except (tarfile.TarError, EOFError) as exc:
        if not records:
            raise DataError(f"{path} is no backup ({exc}); give a file written by `station map backup`") from exc
        damaged.append(f"{path} ends early ({exc}); what came before was restored")
    count = 0
    for map_id, found in records.items():
        found.sort(key=lambda pair: pair[0].number)
        whole_ones = [pair for pair in found if {ref.address for ref in pair[0].files.values()} <= there]
        lacking = [pair for pair in found if pair not in whole_ones]
        if lacking:
            numbers = ", ".join(str(record.number) for record, _ in lacking)
            damaged.append(
                f"{path}: map {map_id} lacks files of version {numbers}; {_store_lacking(contents, lacking)}"
            )
        count += _restore_map(contents, map_id, whole_ones)
    return BackupReport(len(records), count, path.stat().st_size, tuple(damaged))


def _store_lacking(contents: Contents, found: list[tuple[MapRecord, bytes]]) -> str:
    """Records whose files may turn up; what became of them, in words. Only in SQLite are records taken in later."""
    with contents.database.reading() as connection:
        is_new = not versions.history(connection, found[0][0].map_id)
    if not (is_new and contents.database.is_sqlite):
        return "left out"
    contents.bucket.put({row_of(record, data).file.name: data for record, data in found})
    return "`station map repair FOLDER` brings it in when a folder has them"


def _restore_map(contents: Contents, map_id: str, found: list[tuple[MapRecord, bytes]]) -> int:
    """How many versions were added."""
    if not found:
        return 0
    with contents.database.writing(map_id) as connection:
        rows = versions.history(connection, map_id)
        if not rows:
            added = [(row_of(record, data), data) for record, data in found]
            contents.bucket.put({row.file.name: data for row, data in added})
            versions.add(connection, [row for row, _ in added])
            return len(found)
    newest, data = found[-1]
    if newest.kind == "deleted" or any(row.record == address_of(data) for row in rows):
        return 0
    return int(contents.save_record(replace(newest, why="from a backup")))


def _readable(store: MapStore, damaged: list[str]) -> Iterator[tuple[MapRecord, bytes]]:
    if not store.contents.database.exists:
        return
    with store.reading() as connection:
        rows = versions.all_rows(connection)
    for row in rows:
        try:
            yield store.contents.record_and_bytes(row)
        except Damaged as exc:
            damaged.append(str(exc))


def _add_blobs(
    contents: Contents, archive: tarfile.TarFile, record: MapRecord, written: set[str], damaged: list[str]
) -> None:
    """The version's files, once each; those that are lost are told."""
    for name, ref in record.files.items():
        if ref.address in written:
            continue
        written.add(ref.address)
        try:
            data = contents.blobs.get(ref.address, f"map {record.map_id}, version {record.number}: {name}")
        except Damaged as exc:
            damaged.append(str(exc))
            continue
        _add(archive, blob_name(ref.address), data)


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(data)
    archive.addfile(member, io.BytesIO(data))


def _members(archive: tarfile.TarFile) -> Iterator[tuple[str, bytes]]:
    """Records and blobs by name; anything else in the file is passed over, nothing is unpacked to the disk."""
    for member in archive:
        last = member.name.rpartition("/")[2]
        if member.isfile() and (parse_record_name(member.name) or ADDRESS.fullmatch(last)):
            file = archive.extractfile(member)
            if file is not None:
                yield member.name, file.read()
