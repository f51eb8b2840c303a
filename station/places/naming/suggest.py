"""Names for the rooms of a map that something seen speaks for. A person accepts them, or nobody does."""

from __future__ import annotations

from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.naming.stickers import stickers_in


def suggest_names(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """All suggestions for the rooms of a plan that are not their names yet."""
    return stickers_in(place_map, plan)
