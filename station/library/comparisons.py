"""Comparisons of two navigations: each a folder with its report, written whole by a job or not at all."""

from __future__ import annotations

import os
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from shared.bounded import MAX_SETTINGS_BYTES, read_file, shown
from shared.errors import DataError
from station.errors import Unknown
from station.library.dated_id import free_dated_id

_SCRATCH = ".new-"
FILES = {"report.html": "text/html; charset=utf-8", "results.json": "application/json"}


@dataclass(frozen=True, slots=True)
class Comparison:
    """What came out of comparing a second navigation with the map of a first one."""

    id: str
    name: str
    first: str  # navigation ids
    second: str
    made_wall_s: float  # seconds since 1970
    places: int
    locations: int
    matches: int
    accepted: bool  # the registration
    reasons: tuple[str, ...]  # why not
    T_first_second: tuple[tuple[float, ...], ...] | None  # (4, 4), upper-left scale · R


class Comparisons:
    """All comparisons in one folder. Small files only: safe to call on the event loop."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def list(self) -> tuple[Comparison, ...]:
        """The newest first. Folders that cannot be read are left out."""
        found = []
        for folder in sorted(self._root.glob("cmp-*"), reverse=True):
            try:
                found.append(
                    msgspec.json.decode(read_file(folder / "comparison.json", MAX_SETTINGS_BYTES), type=Comparison)
                )
            except (OSError, msgspec.DecodeError):
                continue
        return tuple(found)

    def get(self, comparison_id: str) -> Comparison:
        """Raises Unknown."""
        for comparison in self.list():
            if comparison.id == comparison_id:
                return comparison
        raise Unknown(f"there is no comparison {shown(comparison_id)}; GET /comparisons lists them")

    def file(self, comparison_id: str, name: str) -> Path:
        """One of FILES. Raises Unknown."""
        self.get(comparison_id)
        if name not in FILES:
            raise Unknown(f"a comparison has no file {shown(name)}; it has {' and '.join(FILES)}")
        return self._root / comparison_id / name

    def prepare(self) -> tuple[str, Path]:
        """A new id and an empty folder for a job to write into; what an ended job left there is removed."""
        try:
            self._root.mkdir(parents=True, exist_ok=True)
            candidate = free_dated_id(
                "cmp", lambda name: any((self._root / (s + name)).exists() for s in ("", _SCRATCH))
            )
            folder = self._root / (_SCRATCH + candidate)
            folder.mkdir()
        except OSError as exc:
            raise DataError(f"{self._root} cannot be written ({exc.strerror}); choose another folder") from exc
        return candidate, folder

    def store(self, comparison: Comparison, folder: Path) -> None:
        """The job is done: its folder becomes a comparison."""
        try:
            (folder / "comparison.json").write_bytes(msgspec.json.encode(comparison))
            os.rename(folder, self._root / comparison.id)
        except OSError as exc:
            raise DataError(f"{folder} cannot be written ({exc.strerror}); free space") from exc

    def discard(self, folder: Path) -> None:
        """The job failed or was cancelled."""
        shutil.rmtree(folder, ignore_errors=True)

    def clean(self) -> None:
        """Remove what jobs of an earlier station left unfinished."""
        for folder in self._root.glob(f"{_SCRATCH}*"):
            shutil.rmtree(folder, ignore_errors=True)

    def delete(self, comparison_id: str) -> None:
        """Raises Unknown."""
        self.get(comparison_id)
        shutil.rmtree(self._root / comparison_id, ignore_errors=True)


def summarise(comparison_id: str, name: str, navigations: tuple[str, str], results: dict[str, Any]) -> Comparison:
    """From the experiment's results.json."""
    registration = results["registration"]
    T = registration["T_target_source"]
    return Comparison(
        id=comparison_id,
        name=name,
        first=navigations[0],
        second=navigations[1],
        made_wall_s=time.time(),
        places=results["places"],
        locations=results["locations"],
        matches=len(results["matches"]),
        accepted=registration["accepted"],
        reasons=tuple(registration["reasons"]),
        T_first_second=None if T is None else tuple(tuple(row) for row in T),
    )
