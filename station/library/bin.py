"""What was deleted and can still be brought back: the dates. The things themselves stay with who keeps them.

How long a thing has been kept is what the station has lived through since, not what the clock on the wall says: one
that is set, or starts anew with an empty battery, would take away what was deleted five minutes ago.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from shared.bounded import MAX_SETTINGS_BYTES, read_file
from shared.disk import make_folder, replace_file
from shared.errors import DataError
from station.library.lived_time import LivedTime

KEEP_S = 7 * 86_400.0  # deleted things are kept so long,
MAX_KEPT = 20  # but no more than this many: recordings are large
Kind = Literal["navigation", "map"]


@dataclass(frozen=True, slots=True)
class BinEntry:
    """One deleted thing."""

    kind: Kind
    id: str
    name: str
    deleted_wall_s: float  # seconds since 1970
    kept_s: float = 0.0  # since then, as the station counts
    gone_wall_s: float = 0.0  # when it is deleted for good, where the station runs until then

    @property
    def is_due(self) -> bool:
        return self.kept_s >= KEEP_S


class _File(msgspec.Struct, frozen=True):
    looked_wall_s: float  # how long the things were kept is true of then
    entries: tuple[BinEntry, ...]


class Bin:
    """When each thing was deleted, in one small file, written whole or not at all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._entries: dict[tuple[str, str], BinEntry] = {}
        self._lived = LivedTime()
        self._written: dict[tuple[str, str], BinEntry] = {}
        self._updating = threading.Lock()  # two requests may each delete something at once

    def open(self) -> None:
        """Read the file; without one, what `update` is told of was deleted then."""
        try:
            read = msgspec.json.decode(read_file(self._path, MAX_SETTINGS_BYTES), type=_File | list[BinEntry])
        except (OSError, msgspec.DecodeError):
            read = []
        if isinstance(read, _File):
            self._lived, entries = LivedTime(read.looked_wall_s), read.entries
        else:  # of a station until November 2026, which counted nothing
            entries = tuple(read)
        self._entries = self._written = {(entry.kind, entry.id): entry for entry in entries}

    def update(self, there: Mapping[Kind, Iterable[tuple[str, str]]], now_s: float, run_s: float) -> None:
        """What is there now, (id, name) of each kind: others are forgotten, unknown ones were deleted now.

        Args:
            now_s: on the wall.
            run_s: of a clock that nobody sets, whenever it began.
        Raises:
            DataError: the file cannot be written.
        """
        with self._updating:
            lived_s = self._lived.look(now_s, run_s)
            before = self._entries
            self._entries = {
                (kind, found): _kept_on(before[kind, found], lived_s, now_s)
                if (kind, found) in before
                else BinEntry(kind, found, name, now_s, gone_wall_s=now_s + KEEP_S)
                for kind, things in there.items()
                for found, name in things
            }
            if self._entries != self._written:
                self._write()
                self._written = self._entries

    def list(self) -> tuple[BinEntry, ...]:
        """The newest first."""
        return tuple(sorted(self._entries.values(), key=lambda e: (e.kept_s, -e.deleted_wall_s, e.kind, e.id)))

    def due(self) -> tuple[BinEntry, ...]:
        """What is to be deleted for good: kept long enough, or too many."""
        return tuple(e for i, e in enumerate(self.list()) if i >= MAX_KEPT or e.is_due)

    def _write(self) -> None:
        try:
            make_folder(self._path.parent)
            scratch = self._path.with_name(f".{self._path.name}")
            content = msgspec.json.encode(_File(self._lived.looked_wall_s, self.list()))
            replace_file(self._path, content, scratch=scratch)
        except OSError as exc:
            raise DataError(f"{self._path} cannot be written ({exc.strerror}); free space or choose another") from exc


def _kept_on(entry: BinEntry, lived_s: float, now_s: float) -> BinEntry:
    kept_s = entry.kept_s + lived_s
    return replace(entry, kept_s=kept_s, gone_wall_s=now_s + max(0.0, KEEP_S - kept_s))
