"""What was deleted and can still be brought back: the dates. The things themselves stay with who keeps them."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from shared.disk import make_folder, replace_file
from shared.errors import DataError

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

    @property
    def gone_wall_s(self) -> float:
        """When it is deleted for good, at the latest."""
        return self.deleted_wall_s + KEEP_S


class Bin:
    """When each thing was deleted, in one small file, written whole or not at all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._entries: dict[tuple[str, str], BinEntry] = {}
        self._written: dict[tuple[str, str], BinEntry] = {}
        self._updating = threading.Lock()  # two requests may each delete something at once

    def open(self) -> None:
        """Read the file; without one, what `update` is told of was deleted then."""
        try:
            entries = msgspec.json.decode(self._path.read_bytes(), type=list[BinEntry])
        except (OSError, msgspec.DecodeError):
            entries = []
        self._entries = self._written = {(entry.kind, entry.id): entry for entry in entries}

    def update(self, there: Mapping[Kind, Iterable[tuple[str, str]]], now_s: float) -> None:
        """What is there now, (id, name) of each kind: others are forgotten, unknown ones were deleted now.

        Raises:
            DataError: the file cannot be written.
        """
        with self._updating:
            before = self._entries
            self._entries = {
                (kind, found): before.get((kind, found)) or BinEntry(kind, found, name, now_s)
                for kind, things in there.items()
                for found, name in things
            }
            if self._entries != self._written:
                self._write()
                self._written = self._entries

    def list(self) -> tuple[BinEntry, ...]:
        """The newest first."""
        return tuple(sorted(self._entries.values(), key=lambda e: (-e.deleted_wall_s, e.kind, e.id)))

    def due(self, now_s: float) -> tuple[BinEntry, ...]:
        """What is to be deleted for good: too old, or too many."""
        return tuple(e for i, e in enumerate(self.list()) if i >= MAX_KEPT or e.gone_wall_s <= now_s)

    def _write(self) -> None:
        try:
            make_folder(self._path.parent)
            scratch = self._path.with_name(f".{self._path.name}")
            replace_file(self._path, msgspec.json.encode(self.list()), scratch=scratch)
        except OSError as exc:
            raise DataError(f"{self._path} cannot be written ({exc.strerror}); free space or choose another") from exc
