"""Heavy work as pieces: functions of plain data alone, so that any machine gives the same result, bit for bit.

reconstruct: a recording → its navigation          make_map: navigations → a map
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from shared.errors import DataError
from station.datasets import open_dataset
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.joining.merge import merge_navigations
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig
from station.slam.backends import make_backend
from station.slam.run import run_backend
from station.workers.executors.port import Executor
from station.workers.repeatable import repeatable

MAX_TRAVEL_BYTES = 2**31  # a recording that travels is held in memory by us, by the scheduler and by the worker


@dataclass(frozen=True, slots=True)
class Recorded:
    """A dataset, where it lies or with all its files."""

    path: Path
    files: tuple[tuple[str, bytes], ...] | None = None  # relative to `path`; "" is `path` itself


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """Run SLAM over a recording. `id` names the navigation; without one its content does."""

    recorded: Recorded
    backend: str = "sfm"
    seed: int = 1
    id: str = ""
    first: int | None = None  # frames, as everywhere
    last: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MapOfNavigations:
    """Register navigations to the first one and find their places."""

    navigations: tuple[Navigation, ...]
    config: PlacesConfig = field(default_factory=PlacesConfig)
    name: str = ""


def reconstruct(piece: Reconstruction) -> Navigation:
    """Raises DataError, EstimationError, ConfigError."""
    with tempfile.TemporaryDirectory(prefix="sentinel-") as scratch, repeatable(1):
        data = open_dataset(_unpacked(piece.recorded, Path(scratch)), piece.first, piece.last)
        if not data.has_images:
            raise DataError(f"{piece.recorded.path} has no pictures; SLAM needs them")
        backend = make_backend(piece.backend, data.calibration, piece.seed, 1, data.intrinsics_known)
        navigation = run_backend(backend, data.events())
    return replace(navigation, id=piece.id or navigation.id)


def make_map(piece: MapOfNavigations) -> PlaceMap:
    """Raises EstimationError: a navigation cannot be registered with certainty."""
    with repeatable(1):
        navigation = merge_navigations(list(piece.navigations), piece.config)
        return build_map(navigation, config=piece.config, name=piece.name)


def reconstruct_all(
    executor: Executor, pieces: Sequence[Reconstruction], done: Callable[[int], None] = lambda _: None
) -> list[Navigation]:
    """SLAM over each recording, side by side; with their files in the pieces where paths of ours mean nothing."""
    if not executor.shares_disk:
        pieces = [replace(piece, recorded=packed(piece.recorded.path)) for piece in pieces]
    return executor.map(reconstruct, pieces, done)


def packed(path: Path) -> Recorded:
    """A dataset with all its files. Raises DataError when it is too large to travel, or cannot be read."""
    if not path.exists():
        raise DataError(f"{path} cannot be read: there is no such file or folder; give a recorded navigation")
    try:
        paths = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
        if sum(p.stat().st_size for p in paths) > MAX_TRAVEL_BYTES:
            raise DataError(f"{path} has more than {MAX_TRAVEL_BYTES >> 30} GB; cut it, or work on this machine")
        files = [("" if p == path else p.relative_to(path).as_posix(), p.read_bytes()) for p in paths]
    except OSError as exc:
        raise DataError(
            f"{path} cannot be read ({exc.strerror}); give the file or folder of a recorded navigation"
        ) from exc
    return Recorded(path, tuple(files))


def _unpacked(recorded: Recorded, scratch: Path) -> Path:
    if recorded.files is None:
        return recorded.path
    root = scratch / recorded.path.name
    for name, content in recorded.files:
        target = root / name if name else root
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    return root
