"""One wrong bit anywhere in a map store: found and put right, or without effect; never a wrong map."""

from __future__ import annotations

import random
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

from shared.errors import DataError
from station.maps.store import MapStore
from tests.support.crashing.maps import MAP, variant
from tests.support.store import content_hash, rename_place

OTHER = "map-other"


def make_store(folder: Path) -> dict[str, set[str]]:
    """Two maps with several versions; returns the content hashes each of them ever had, the newest under "id now"."""
    store = MapStore(folder)
    hashes: dict[str, set[str]] = {MAP.id: set(), OTHER: set()}
    for map_id in list(hashes):
        for number in (0, 1):
            store.save(replace(variant(number), id=map_id))
            hashes[map_id].add(content_hash(store, map_id))
        rename_place(store, map_id, MAP.places[0].id, "Sofa")
        hashes[map_id].add(content_hash(store, map_id))
        hashes[f"{map_id} now"] = {content_hash(store, map_id)}
    return hashes


def flip_once(original: Path, hashes: dict[str, set[str]], scratch: Path, seed: int) -> str:
    """Flip one bit of one file of a copy, open it, and say what came of it. Raises AssertionError for a wrong map."""
    rng = random.Random(seed)
    shutil.rmtree(scratch, ignore_errors=True)
    shutil.copytree(original, scratch)
    files = sorted(p for p in scratch.rglob("*") if p.is_file() and p.stat().st_size)
    # Half of the flips hit the database: it is one file of many, and the one with the most that can go wrong.
    path = scratch / "maps.db" if rng.random() < 0.5 else rng.choice(files)
    data = bytearray(path.read_bytes())
    bit = rng.randrange(8 * len(data))
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    where = f"bit {bit} of {path.relative_to(scratch)}"
    told: list[str] = []
    try:
        store = MapStore(scratch, told.append)
        listed = {summary.id for summary in store.list()}
        now = {map_id: content_hash(store, map_id) for map_id in (MAP.id, OTHER)}
        maps = {map_id: store.load(map_id) for map_id in (MAP.id, OTHER)}
    except DataError as exc:
        raise AssertionError(f"{where}: nothing opens: {exc}") from exc
    assert listed == set(maps), f"{where}: {listed} are listed"
    is_newest = all({value} == hashes[f"{map_id} now"] for map_id, value in now.items())
    for map_id, place_map in maps.items():
        assert now[map_id] in hashes[map_id], f"{where}: {map_id} is none of its versions"
        assert len(place_map.places) == len(MAP.places), f"{where}: places differ"
    if is_newest:
        return "put right" if told else "harmless"
    assert told, f"{where}: an older version opens and nobody says so"
    return "older version"


def flip_many(count: int, seed: int, folder: Path) -> Counter[str]:
    """How the flips ended."""
    hashes = make_store(folder / "original")
    return Counter(flip_once(folder / "original", hashes, folder / "flipped", seed + n) for n in range(count))
