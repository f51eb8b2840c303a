"""What runs in the process of a heavy job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shared.errors import ConfigError
from station.maps.store import MapStore
from station.navigation import Navigation
from station.navigation_files import load_navigation
from station.places.build import build_map
from station.places.config import PlacesMode


@dataclass(frozen=True, slots=True, eq=False)
class BuiltMap:
    """What building left in the store."""

    map_id: str
    name: str
    places: int


class JobServant:
    """One heavy job; sends (fraction, sentence) as it goes."""

    def __init__(self, emit: Callable[[tuple[float, str]], None]) -> None:
        self._emit = emit

    def build_map(self, folders: list[Path], store: Path, name: str, mode: PlacesMode | None) -> BuiltMap:
        """Navigation folders -> a map in the store."""
        self._emit((0.05, "reading the navigation"))
        navigations = [load_navigation(folder) for folder in folders]
        self._emit((0.2, f"grouping {sum(len(n.landmarks) for n in navigations)} landmarks into places"))
        place_map = build_map(_only(navigations), mode, name=name)
        self._emit((0.8, f"saving {len(place_map.places)} places"))
        MapStore(store).save(place_map)
        return BuiltMap(place_map.id, place_map.name, len(place_map.places))


def _only(navigations: list[Navigation]) -> Navigation:
    if len(navigations) != 1:
        raise ConfigError(f"a map is built from one navigation, {len(navigations)} were given; name one")
    return navigations[0]
