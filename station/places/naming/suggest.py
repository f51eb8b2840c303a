"""Names for the rooms of a map that something seen speaks for. A person accepts them, or nobody does."""

from __future__ import annotations

import logging
from collections.abc import Callable

from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.naming.plates import find_plates
from station.places.naming.room_words import default_words
from station.places.naming.sightings import suggestions
from station.places.naming.stickers import find_stickers
from station.vision.printed import CannotRead, PrintReader, can_read_print

logger = logging.getLogger(__name__)


def suggest_names(
    place_map: PlaceMap, plan: FloorPlan, say: Callable[[str], None] = lambda _: None
) -> tuple[NameSuggestion, ...]:
    """All suggestions for the rooms of a plan that are not their names yet. `say` hears how far it is."""
    found = find_stickers(place_map, plan.unit)
    if can_read_print():
        try:
            found += find_plates(
                place_map,
                plan,
                default_words(),
                PrintReader(),
                found,
                lambda n, of: say(f"reading door plates, picture {n + 1} of {of}"),
            )
        except CannotRead as exc:
            logger.warning("no door plates are read: %s", exc)
            say("no door plates are read: the reader does not work here (the log says why)")
    return suggestions(found, plan)
