"""The floor plan of a map: made with it, and made anew whenever the map or what people made of its plan is another."""

from __future__ import annotations

from dataclasses import replace

from station.model.floor_plan import FloorPlan
from station.model.place_map import PlaceMap
from station.places.rooms.place_names import named_by_rooms


def planned(place_map: PlaceMap, earlier: PlaceMap | None = None) -> PlaceMap:
    """The map with its floor plan. Rooms keep the ids and names that they had in it, or in an `earlier` map of the same
    frame, and so does what people made of them.
    """
    from station.places.rooms.plan import make_floor_plan  # SciPy, which a station needs only once somebody edits doors

    before = place_map if earlier is None else earlier
    plan = make_floor_plan(place_map.navigation, place_map.places, before.plan_edits, before.plan)
    return with_plan(replace(place_map, plan_edits=before.plan_edits), plan)


def with_plan(place_map: PlaceMap, plan: FloorPlan) -> PlaceMap:
    """The map with this plan, its places called after their rooms, and without suggestions for rooms that are gone."""
    ids = {room.id for room in plan.rooms}
    suggestions = tuple(suggestion for suggestion in place_map.suggestions if suggestion.room in ids)
    places = named_by_rooms(place_map.places, plan)
    return replace(place_map, places=places, plan=plan, suggestions=suggestions)


def with_suggestions(place_map: PlaceMap) -> PlaceMap:
    """The map with names that something in its pictures speaks for. Looks at every picture; nothing is named yet."""
    from station.places.naming.suggest import suggest_names  # as above: workers make maps

    if place_map.plan is None:
        return place_map
    return replace(place_map, suggestions=suggest_names(place_map, place_map.plan))
