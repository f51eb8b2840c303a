"""Names for the rooms of a map that something seen speaks for. A person accepts them, or nobody does."""

from __future__ import annotations

from collections.abc import Callable

from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.naming.plates import find_plates
from station.places.naming.room_words import default_words
from station.places.naming.sightings import suggestions
from station.places.naming.stickers import find_stickers
from station.vision.printed import PrintReader, can_read_print


def suggest_names(
    place_map: PlaceMap, plan: FloorPlan, say: Callable[[str], None] = lambda _: None
) -> tuple[NameSuggestion, ...]:
    """All suggestions for the rooms of a plan that are not their names yet. `say` hears how far it is."""
    found = find_stickers(place_map, plan.unit)
    if can_read_print():
        found += find_plates(
            place_map,
            plan,
            default_words(),
            PrintReader(),
            found,
            lambda n, of: say(f"reading door plates, picture {n + 1} of {of}"),
        )
    return suggestions(found, plan)
