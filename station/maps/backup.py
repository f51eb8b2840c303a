"""All maps of a store in one file, and back: a plain tar of records and blobs, each under its checksum."""

from __future__ import annotations

import io
import shutil
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from shared.bounded import MAX_FILE_BYTES, MAX_JSON_BYTES, Refused, open_file, shortened
from shared.disk import PRIVATE, make_folder, replacing
from shared.errors import DataError
from shared.text import printable
from station.maps import backup_list, versions
from station.maps.address import ADDRESS, address_of, heal, is_nearly, is_whole
from station.maps.archive import MAX_PIECE_BYTES, DamagedArchive, members
from station.maps.backup_list import BackupList, Listed, with_right_headers
from station.maps.blobs import Damaged, blob_name
from station.maps.contents import Contents, row_of
from station.maps.record import MapRecord, decode_record
from station.maps.record_files import RecordFile, parse_record_name
from station.maps.store import MapStore

# What tarfile raises for one that is none: it trusts what it finds in headers, and follows them one in another.
_NO_ARCHIVE = (tarfile.TarError, EOFError, ValueError, OverflowError, RecursionError)
README_NAME = "README.txt"
README_BEFORE_LISTS = (
    b"Maps of a Sentinel station: `station map restore FILE` brings them back. File names end in sha256-crc32.\n"
)
README = README_BEFORE_LISTS + b"The last file lists all others.\n"


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
        with (
            replacing(path, mode=PRIVATE) as file,
            tarfile.open(fileobj=file, mode="w|", format=tarfile.PAX_FORMAT) as archive,
        ):
            writer = _Writer(archive)
            writer.add(README_NAME, README)
            for record, data in records:  # first: a file that is cut later still says what there was
                writer.add(row_of(record, data).file.name, data)
            written: set[str] = set()
            for record, _ in records:
                _add_blobs(store.contents, writer, record, written, damaged)
            writer.add(*backup_list.encode(writer.files))
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
    contents = store.for_writing()
    with contents.bucket.adding():
        return _restore(store, contents, path)


class _Writer:
    """Adds files to an archive and knows what it has added."""

    def __init__(self, archive: tarfile.TarFile) -> None:
        self.files: list[Listed] = []
        self._archive = archive

    def add(self, name: str, data: bytes) -> None:
        member = tarfile.TarInfo(name)
        member.size = len(data)
        self._archive.addfile(member, io.BytesIO(data))
        self.files.append(Listed.behind(self.files[-1] if self.files else None, name, len(data)))


def _restore(store: MapStore, contents: Contents, path: Path) -> BackupReport:
    found = _Found(store, path)
    try:
        with open_file(path) as file:
            found.listed = backup_list.read(file)
            whole, names = with_right_headers(file, found.listed) if found.listed else (file, [])
            for name in names:
                found.header_put_right(name)
            with DamagedArchive(whole) as archive:
                for member in members(archive, found.lost):
                    found.add(archive, member)
    except (Refused, *_NO_ARCHIVE) as exc:
        if not found.records:
            why = found.damaged[0].removeprefix(f"{path}: ") if found.damaged else exc
            raise DataError(f"{path} is no backup ({why}); give a file written by `station map backup`") from exc
        found.ends_early = True
        found.damaged.append(f"{path} ends early ({exc}); what came before was restored")
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a file written by `station map backup`") from exc
    found.compare()
    if not found.records and (found.damaged or found.strangers or not found.entries):
        nothing = "there is no map in it" if found.entries else "it holds nothing"
        why = found.damaged[0].removeprefix(f"{path}: ") if found.damaged else nothing
        raise DataError(f"{path} is no backup that can be read ({why}); give a file written by `station map backup`")
    if found.strangers:
        first = _shown(found.first_stranger)
        found.damaged.append(f"{path} holds what no backup does: {first}, {found.strangers} in all; it is left out")
    count = 0
    for map_id, by_number in found.records.items():
        pairs = [by_number[number] for number in sorted(by_number)]
        whole_ones = [pair for pair in pairs if {ref.address for ref in pair[0].files.values()} <= found.addresses]
        lacking = [pair for pair in pairs if pair not in whole_ones]
        if lacking:
            numbers = ", ".join(str(record.number) for record, _ in lacking)
            found.damaged.append(
                f"{path}: map {map_id} lacks files of version {numbers}; {_store_lacking(contents, lacking)}"
            )
        count += _restore_map(contents, map_id, whole_ones)
    return BackupReport(len(found.records), count, path.stat().st_size, tuple(found.damaged))


class _Found:
    """What a backup holds; nothing of it is unpacked to the disk but files of maps, under the addresses they have."""

    def __init__(self, store: MapStore, path: Path) -> None:
        self.records: dict[str, dict[int, tuple[MapRecord, bytes]]] = {}  # of a map, by the version's number
        self.addresses: set[str] = set()  # of the files
        self.damaged: list[str] = []
        self.entries = 0  # of any kind
        self.strangers, self.first_stranger = 0, ""  # entries that no backup has
        self.listed: BackupList | None = None  # what was written into it, where it says so
        self.ends_early = False
        self._names: set[str] = set()
        self._has_no_list = False  # it was written before there were lists
        self._has_damaged_list = False
        self._store = store
        self._path = path

    def lost(self, count: int, where: str) -> None:
        """Bytes that no header leads to."""
        self.damaged.append(f"{self._path}: {count} bytes {_shown(where)} cannot be read; what they held is left out")

    def add(self, archive: tarfile.TarFile, member: tarfile.TarInfo) -> None:
        """A record or a blob; what is something else is counted. Raises what an unreadable archive does."""
        self.entries += 1
        self._names.add(member.name)
        file = parse_record_name(member.name)
        address = file.address if file else member.name.rpartition("/")[2]
        if member.isfile() and backup_list.is_list(member.name):
            self._look_at_list(archive, member, address)
            return
        if not member.isfile() or not ADDRESS.fullmatch(address):
            if member.isfile() and member.name == README_NAME and member.size == len(README_BEFORE_LISTS):
                self._has_no_list = is_nearly(_read(archive, member, member.size), README_BEFORE_LISTS)
            if member.name != README_NAME:
                self.strangers += 1
                self.first_stranger = self.first_stranger or member.name
            return
        try:
            data = self._whole(_read(archive, member, MAX_JSON_BYTES if file else MAX_FILE_BYTES), member.name, address)
            if file is not None:
                self._add_record(file, data)
                return
        except (Refused, _LeftOut) as exc:
            self.damaged.append(f"{self._path}: {_shown(member.name)} {exc}; it is left out")
            return
        self._store.contents.blobs.put([data])
        self.addresses.add(address)

    def _whole(self, data: bytes, name: str, address: str) -> bytes:
        if is_whole(data, address):
            return data
        healed = heal(data, address)
        if healed is None:
            raise _LeftOut("is damaged (its checksum differs)")
        self.put_right(name)
        return healed

    def _look_at_list(self, archive: tarfile.TarFile, member: tarfile.TarInfo, address: str) -> None:
        """How it is; it was read before, but where something stands behind it."""
        try:
            data = self._whole(_read(archive, member, MAX_FILE_BYTES), member.name, address)
            self.listed = self.listed or backup_list.decode(data, member.name, member.offset)
        except (Refused, _LeftOut) as exc:
            self._has_damaged_list = True
            self.damaged.append(f"{self._path}: its list {exc}; whether something was taken out cannot be told")

    def put_right(self, name: str) -> None:
        self._store.notify(f"{self._path}: {_shown(name)} had one wrong bit; it is put right. Check the disk")

    def header_put_right(self, name: str) -> None:
        self._store.notify(f"{self._path}: the header of {_shown(name)} was wrong; it is put right. Check the disk")

    def compare(self) -> None:
        """With what was written into it."""
        if self.listed is None:
            self._say_that_the_list_is_missing()
            return
        count = missing = 0
        first = ""
        for name in self.listed.names():
            count += 1
            if name not in self._names:
                missing += 1
                first = first or name
        if missing:
            self.damaged.append(
                f"{self._path}: {missing} of the {count} files that its list names are missing,"
                f" the first is {_shown(first)}"
            )

    def _say_that_the_list_is_missing(self) -> None:
        """Unless that follows from what was said."""
        is_ours = self.records or self.addresses
        if is_ours and not (self._has_no_list or self._has_damaged_list or self.ends_early):
            self.damaged.append(f"{self._path}: its list is missing; whether something was taken out cannot be told")

    def _add_record(self, file: RecordFile, data: bytes) -> None:
        try:
            record = decode_record(data, "it")
        except DataError as exc:
            raise _LeftOut(f"cannot be read: {str(exc).partition(';')[0]}") from exc
        if (record.map_id, record.number) != (file.map_id, file.number):
            raise _LeftOut(f"is a record of map {record.map_id}, version {record.number}")
        self.records.setdefault(file.map_id, {}).setdefault(file.number, (record, data))


def _shown(name: str) -> str:
    """A name that somebody else gave."""
    return shortened(printable(name))


class _LeftOut(Exception):
    """Why a part of a backup cannot be used."""


def _read(archive: tarfile.TarFile, member: tarfile.TarInfo, max_bytes: int) -> bytes:
    """A member's bytes. Raises Refused for one with holes, which unpacks to any size, and for what is too large."""
    file = archive.extractfile(member)
    if file is None or member.issparse() or member.size > max_bytes:
        raise Refused(f"claims {member.size} bytes, more than what is read")
    whole = io.BytesIO()
    shutil.copyfileobj(file, whole, MAX_PIECE_BYTES)
    return whole.getvalue()


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


def _add_blobs(contents: Contents, writer: _Writer, record: MapRecord, written: set[str], damaged: list[str]) -> None:
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
        writer.add(blob_name(ref.address), data)
