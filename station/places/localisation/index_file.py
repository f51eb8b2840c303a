"""The localisation index of a map, kept in a file: one worker makes it, those of all robots share its memory.

The file is mapped read-only, so that however many workers look at it, it is in memory once. It is derived: when it is
missing, damaged or of another version it is made again; when it cannot be kept, each worker makes its own.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import mmap
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import msgspec
import numpy as np
import numpy.typing as npt

from shared.disk import lock, replacing
from station.config import MAX_ACTIVE_MAPS
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.localisation.described_pictures import DescribedPictures
from station.places.localisation.index_path import SUFFIX, index_path
from station.places.localisation.make_index import make_index
from station.places.localisation.map_index import MapIndex, fingerprint

logger = logging.getLogger(__name__)
SCRATCH, LOCK = ".new", "lock"
KEPT = MAX_ACTIVE_MAPS  # else a set of them would be described anew at each start
MAGIC = b"SentinelIndex\n"
ALIGNED = 64  # as numpy's own arrays


class _Part(msgspec.Struct, frozen=True):
    """Where an array lies, behind the head."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    begin: int


class _Head(msgspec.Struct, frozen=True):
    """The second line of the file; padding and arrays follow."""

    fingerprint: str
    sha256: str  # of everything behind the head
    parts: tuple[_Part, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedIndex:
    """Of a navigation that is to become a map."""

    fingerprint: str
    index: MapIndex

    @classmethod
    def of(cls, navigation: Navigation, pictures: DescribedPictures) -> PreparedIndex:
        place_map = PlaceMap("", "", navigation, (), (), {})  # an index knows of no places
        return cls(fingerprint(place_map), make_index(place_map, pictures=pictures))


def index_of(
    root: Path,
    place_map: PlaceMap,
    on_keyframe: Callable[[], None],
    on_wait: Callable[[], None],
    pictures: DescribedPictures | None = None,
    prepared: PreparedIndex | None = None,
) -> MapIndex:
    """The index of a map of the store at `root`: the one that is kept, or made now.

    `on_keyframe` is called before each picture that is described, `on_wait` when another process does that already;
    `pictures`: what is described already; `prepared`: an index that may be of this map.
    """

    def make() -> MapIndex:
        if prepared is not None and prepared.fingerprint == wanted:
            return prepared.index
        return make_index(place_map, on_keyframe, pictures)

    wanted = fingerprint(place_map)
    path = index_path(root, place_map.id)
    if (kept := _read(path, wanted)) is not None:
        return kept
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock_file = (path.parent / LOCK).open("ab")
    except OSError as exc:
        logger.warning("%s cannot be written (%s); each robot makes its own index", path.parent, exc.strerror)
        return make()
    with lock_file:
        _wait_for(lock_file, on_wait)
        if (kept := _read(path, wanted)) is not None:  # made while we waited
            return kept
        made = make()
        try:
            _write(path, wanted, made)
        except OSError as exc:
            logger.warning("%s cannot be written (%s); each robot makes its own index", path, exc.strerror)
            return made
    return _read(path, wanted) or made


def _wait_for(file: IO[bytes], on_wait: Callable[[], None]) -> None:
    """Lock a file, however long that takes; where files have no locks, go on without."""
    try:
        if not lock(file, timeout_s=0):
            on_wait()
            lock(file)
    except OSError as exc:
        logger.warning("no file can be locked here (%s)", exc.strerror)


def _read(path: Path, wanted: str) -> MapIndex | None:
    """None when there is none, or not this one."""
    try:
        with path.open("rb") as file:
            mapped = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
            if bytes(mapped[: len(MAGIC)]) != MAGIC:
                return None
            file.seek(len(MAGIC))
            line = file.readline()
        with contextlib.suppress(OSError):  # a disk that takes no writes
            os.utime(path)  # it is in use
    except (OSError, ValueError):  # an empty file cannot be mapped
        return None
    try:
        head = msgspec.json.decode(line, type=_Head)
        body = mapped[_aligned(len(MAGIC) + len(line)) :]
        if head.fingerprint != wanted or hashlib.sha256(body).hexdigest() != head.sha256:
            return None
        return MapIndex.of_arrays({part.name: _array(body, part) for part in head.parts})
    except (msgspec.DecodeError, KeyError, ValueError, TypeError) as exc:
        logger.warning("%s is damaged (%s); it is made again", path, exc)
        return None


def _array(body: memoryview, part: _Part) -> npt.NDArray[np.generic]:
    count = int(np.prod(part.shape))
    flat: npt.NDArray[np.generic] = np.frombuffer(body, np.dtype(part.dtype), count, part.begin)
    return flat.reshape(part.shape)


def _write(path: Path, wanted: str, index: MapIndex) -> None:
    """Under the lock: nobody else writes here. Also removes what is kept no longer."""
    for scratch in path.parent.glob(f"*{SCRATCH}"):  # of a process that was killed
        scratch.unlink(missing_ok=True)
    parts, pieces, end = [], [], 0
    for name, array in index.arrays().items():
        parts.append(_Part(name, array.dtype.str, array.shape, end))
        data = np.ascontiguousarray(array).tobytes()
        pieces.append(data.ljust(_aligned(len(data)), b"\0"))
        end += len(pieces[-1])
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    head = MAGIC + msgspec.json.encode(_Head(wanted, digest.hexdigest(), tuple(parts))) + b"\n"
    with replacing(path, scratch=path.with_name(path.name + SCRATCH)) as file:
        file.write(head.ljust(_aligned(len(head)), b"\0"))
        file.writelines(pieces)
    for old in list(_newest_first(path.parent))[KEPT:]:
        old.unlink(missing_ok=True)


def _newest_first(folder: Path) -> Iterator[Path]:
    return iter(sorted(folder.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime, reverse=True))


def _aligned(size: int) -> int:
    return -(-size // ALIGNED) * ALIGNED
