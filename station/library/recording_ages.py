"""How old each recording is, by what the station has lived through since: no clock that is set takes one away."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable
from pathlib import Path

import msgspec

from shared.bounded import MAX_SETTINGS_BYTES, read_file
from shared.disk import make_folder, replace_file
from station.library.lived_time import LivedTime


class _File(msgspec.Struct, frozen=True):
    looked_wall_s: float  # the ages are true of then
    ages_s: dict[str, float]  # by navigation


class RecordingAges:
    """In one small file, written whole or not at all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lived: LivedTime | None = None  # not read yet
        self._ages_s: dict[str, float] = {}
        self._updating = threading.Lock()  # navigations of two robots may end at once

    def update(self, there: Iterable[str], now_s: float, run_s: float) -> dict[str, float]:
        """Seconds since each recording that is there now was first seen here. Others are forgotten.

        Args:
            there: the navigations whose recordings there are.
            now_s: on the wall.
            run_s: of a clock that nobody sets, whenever it began.
        """
        with self._updating:
            lived = self._lived = self._lived or self._read()
            lived_s = lived.look(now_s, run_s)
            self._ages_s = {id_: self._ages_s[id_] + lived_s if id_ in self._ages_s else 0.0 for id_ in there}
            self._write(lived.looked_wall_s)
            return self._ages_s

    def _read(self) -> LivedTime:
        """Without a file all that is there is new."""
        try:
            read = msgspec.json.decode(read_file(self._path, MAX_SETTINGS_BYTES), type=_File)
        except (OSError, msgspec.DecodeError):
            return LivedTime()
        self._ages_s = read.ages_s
        return LivedTime(read.looked_wall_s)

    def _write(self, looked_wall_s: float) -> None:
        """Where that fails they count until the station ends: a full disk is when recordings must go."""
        with contextlib.suppress(OSError):
            make_folder(self._path.parent)
            content = msgspec.json.encode(_File(looked_wall_s, self._ages_s))
            replace_file(self._path, content, scratch=self._path.with_name(f".{self._path.name}"))
