"""Changes a person makes to a map. Pure: a map in, another one out; MapStore.edit keeps it."""

from __future__ import annotations

from dataclasses import replace

from shared.errors import DataError
from shared.text import is_seen_whole, look_of
from station.model.place_map import PlaceMap

MAX_NAME = 80  # characters


def tidy_name(name: str, what: str) -> str:
    """Without stray spaces. Raises DataError for one that is empty, too long or cannot be shown."""
    name = " ".join(name.split())
    if not is_seen_whole(name):
        raise DataError(f"{what} holds a character that cannot be shown or seen; give letters, digits and signs")
    if not 0 < len(name) <= MAX_NAME:
        raise DataError(f"{what} needs 1 to {MAX_NAME} characters, not {len(name)}")
    return name


def with_place_renamed(place_map: PlaceMap, place_id: str, name: str) -> PlaceMap:
    """The map with one place named otherwise. Names are unique in a map, upper and lower case being one."""
    name = tidy_name(name, "a place's name")
    if place_id not in {place.id for place in place_map.places}:
        raise DataError(f'map "{place_map.name}" has no place with id "{place_id}"')
    look = look_of(name).casefold()
    if any(look_of(place.name).casefold() == look and place.id != place_id for place in place_map.places):
        raise DataError(f'map "{place_map.name}" has another place named "{name}"; choose a different name')
    places = tuple(
        replace(place, name=name, named=True) if place.id == place_id else place for place in place_map.places
    )
    return replace(place_map, places=places)
