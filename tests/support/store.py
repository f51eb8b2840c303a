"""Harm for map stores in folders."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from station.maps.store import MapStore


def blobs(store: MapStore) -> Iterator[Path]:
    return (p for p in sorted((store.address.root / "blobs").rglob("*")) if p.is_file())


def largest_blob(store: MapStore) -> Path:
    return max(blobs(store), key=lambda path: path.stat().st_size)


def newest_record(store: MapStore) -> Path:
    return max((store.address.root / "records").iterdir())


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])
