"""Recorded drives on disk: one file per world, so that making them goes on where it ended.

Pickled, for benchmarks only: a file from elsewhere must not be read. Values are stored by the names of their fields, so
that a class may gain fields with defaults, or lose some, without the files being lost.
"""

from __future__ import annotations

import dataclasses
import gzip
import pickle
from pathlib import Path
from typing import Any

import msgspec

from tests.support.drives.recorded import RecordedWorld

# Counted up by hand when the localiser, SLAM or the simulator give something else; files of other numbers stay unread.
VERSION = 9


def path_of(cache: Path, kind: str, name: str, *how: str) -> Path:
    """`how`: what sets it apart from others of the same world."""
    return cache / "-".join(part for part in (kind, name, *how, f"v{VERSION}.pickle.gz") if part)


def store(world: RecordedWorld, path: Path) -> None:
    """Write a world's file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    with gzip.open(unfinished, "wb", compresslevel=1) as file:
        _Pickler(file, protocol=5).dump(world)
    unfinished.replace(path)


def load(path: Path) -> RecordedWorld:
    with gzip.open(path, "rb") as file:
        world: RecordedWorld = pickle.load(file)
    return world


def stored(cache: Path) -> list[Path]:
    """All files of this version."""
    return sorted(cache.glob(f"*-v{VERSION}.pickle.gz"))


class _Pickler(pickle.Pickler):
    def reducer_override(self, value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return rebuild, (type(value), {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init})
        if isinstance(value, msgspec.Struct):
            return rebuild, (type(value), msgspec.structs.asdict(value))
        return NotImplemented


def rebuild(cls: Any, values: dict[str, Any]) -> Any:
    """A dataclass or a msgspec structure from those of its fields that it has today."""
    fields = msgspec.structs.fields(cls) if issubclass(cls, msgspec.Struct) else dataclasses.fields(cls)
    known = {f.name for f in fields}
    return cls(**{name: value for name, value in values.items() if name in known})
