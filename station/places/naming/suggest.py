"""Names for the rooms of a map that something seen speaks for. A person accepts them, or nobody does."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.naming.plates import find_plates
from station.places.naming.room_words import default_words
from station.places.naming.sightings import Sighting, suggestions
from station.places.naming.stickers import find_stickers
from station.vision.printed import CannotRead, PrintReader, can_read_print

logger = logging.getLogger(__name__)


def suggest_names(
    place_map: PlaceMap, plan: FloorPlan, say: Callable[[str], None] = lambda _: None
) -> tuple[NameSuggestion, ...]:
    """All suggestions for the rooms of a plan that are not their names yet. `say` hears how far it is."""
    stickers = find_stickers(place_map, plan.unit)
    return suggestions([*stickers, *_read_plates(place_map, plan, stickers, say)], plan)


def sticker_names(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """Those that stickers speak for: quick, beside what printed words take."""
    return suggestions(find_stickers(place_map, plan.unit), plan)


def plate_names(
    place_map: PlaceMap, plan: FloorPlan, say: Callable[[str], None] = lambda _: None
) -> tuple[NameSuggestion, ...]:
    """Those that printed words speak for."""
    if not can_read_print():
        return ()
    return suggestions(_read_plates(place_map, plan, find_stickers(place_map, plan.unit), say), plan)


def _read_plates(
    place_map: PlaceMap, plan: FloorPlan, stickers: Sequence[Sighting], say: Callable[[str], None]
) -> list[Sighting]:
    """None where nothing here reads print."""
    if not can_read_print():
        return []

    def on_picture(n: int, of: int) -> None:
        say(f"reading door plates, picture {n + 1} of {of}")

    try:
        return find_plates(place_map, plan, default_words(), PrintReader(), stickers, on_picture)
    except CannotRead as exc:
        logger.warning("no door plates are read: %s", exc)
        say("no door plates are read: the reader does not work here (the log says why)")
        return []
