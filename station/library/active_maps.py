"""Which maps a station looks for its robots in: chosen by a person, kept in `active.json`, and never two of one flat.

The first one is *the* active map, whose places and graph are shown and edited; the others are looked in as well. The
order of the others means nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from shared.disk import make_folder, replace_file
from station.errors import Conflict, Unknown
from station.files.unwritable import cannot_write
from station.model.map_store import StoreAddress
from station.model.place_map import Place, PlaceMap

FILE = "active.json"  # beside the maps


class _Choice(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the file says; without `also`, as with one map only, it is what stations before there were sets wrote."""

    id: str | None
    also: tuple[str, ...] = ()


def kept_choice(root: Path) -> tuple[str, ...]:
    """The ids that were chosen last, the first one first; none where nothing was, or nothing that can be read."""
    return _written(root) or ()


def keep_choice(root: Path, chosen: tuple[str, ...]) -> None:
    """Raises Unwritable."""
    if chosen == _written(root):
        return
    content = msgspec.json.encode(_Choice(chosen[0] if chosen else None, chosen[1:])) + b"\n"
    try:
        make_folder(root)
        replace_file(root / FILE, content)
    except OSError as exc:
        raise cannot_write(root, exc) from exc


def _written(root: Path) -> tuple[str, ...] | None:
    """What the file says; None where it says nothing."""
    try:
        choice = msgspec.json.decode((root / FILE).read_bytes(), type=_Choice)
    except (OSError, msgspec.DecodeError):
        return None
    return () if choice.id is None else tuple(dict.fromkeys((choice.id, *choice.also)))


def why_not_together(maps: Sequence[PlaceMap]) -> str:
    """Why these cannot be active at once, in a sentence; empty when they can.

    Two maps of the same rooms explain every picture equally well: half of the belief would go to each, and neither be
    known. That two navigations went through the same rooms nobody can tell from the maps alone; that two maps come from
    one navigation, or that one was made again from the other, their navigations and places tell.
    """
    for a, b in itertools.combinations(maps, 2):
        navigations = sorted(_navigations(a) & _navigations(b))
        if navigations or {place.id for place in a.places} & {place.id for place in b.places}:
            both = f"both are made from {navigations[0]}" if navigations else "they share places"
            return (
                f"{a.name} and {b.name} ({a.id}, {b.id}) are maps of the same rooms, {both}; together the robot would "
                "be known in neither: choose one of them, or build one map from all their navigations"
            )
    return ""


def _navigations(place_map: PlaceMap) -> set[str]:
    """Those it was made from: the ids of several are joined (merge.py)."""
    return set(place_map.navigation.id.split("+"))


@dataclass(frozen=True, slots=True, eq=False)
class ActiveMap:
    """A map in use, and what is derived from it once."""

    place_map: PlaceMap
    place_of_point: npt.NDArray[np.uint8]  # (M,) number of its place, NO_PLACE for none
    numbers: Mapping[str, int]  # of the places, by id; also of some that are gone and may come back

    def place(self, place_id: str) -> Place:
        """Raises Unknown."""
        for place in self.place_map.places:
            if place.id == place_id:
                return place
        raise Unknown(f"the active map has no place {place_id!r}; GET /places lists them")

    @property
    def visible_places(self) -> tuple[Place, ...]:
        """Those that are not hidden: the graph's nodes."""
        return tuple(place for place in self.place_map.places if not place.hidden)


class ActiveMaps:
    """The maps in which robots are looked for; *the* active map is the first of them."""

    def __init__(self, address: StoreAddress) -> None:
        self.address = address
        self._active: tuple[ActiveMap, ...] = ()
        self.revision = 0  # counts what the active map was, so that a page knows when to read it again

    @property
    def active(self) -> ActiveMap | None:
        """The first of the active maps."""
        return self._active[0] if self._active else None

    @property
    def all_active(self) -> tuple[ActiveMap, ...]:
        """The first one first."""
        return self._active

    def among_active(self, map_id: str) -> ActiveMap | None:
        """The active map of this id."""
        return next((active for active in self._active if active.place_map.id == map_id), None)

    def require_active(self) -> ActiveMap:
        """Raises Conflict in words when no map is active."""
        if not self._active:
            raise Conflict("no map is active; build one with POST /maps and choose it with PUT /maps/active")
        return self._active[0]
