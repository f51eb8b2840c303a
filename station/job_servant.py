"""What runs in the process of a heavy job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from station.maps.store import MapStore, StoreAddress
from station.navigation_files import load_navigation
from station.places.build import build_map, carry_names
from station.places.config import PlacesConfig, PlacesMode
from station.places.merge import merge_navigations


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

    def build_map(self, folders: list[Path], address: StoreAddress, name: str, mode: PlacesMode | None) -> BuiltMap:
        """Navigation folders -> a map in the store. Places of an earlier map of the first drive keep their names."""
        self._emit((0.05, "reading the navigation"))
        navigations = [load_navigation(folder) for folder in folders]
        config = PlacesConfig() if mode is None else PlacesConfig(mode=mode)
        if len(navigations) > 1:
            self._emit((0.1, f"registering {len(navigations) - 1} drives to {navigations[0].id}"))
        navigation = merge_navigations(navigations, config)
        self._emit((0.5, f"grouping {len(navigation.landmarks)} landmarks into places"))
        place_map = build_map(navigation, config=config, name=name)
        store = MapStore(address)
        earlier = store.newest_of_drive(navigations[0].id)
        if earlier is not None:
            place_map = carry_names(earlier, place_map)
        self._emit((0.8, f"saving {len(place_map.places)} places"))
        store.save(place_map, f"built from {navigation.id}"[:200])
        return BuiltMap(place_map.id, place_map.name, len(place_map.places))
