"""The floor plan of a map: made with it, and made anew whenever the map or what people made of its plan is another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count

from station.model.floor_plan import FloorPlan, NameSuggestion, SuggestionSource
from station.model.place_map import PlaceMap
from station.places.naming.facing import room_named
from station.places.rooms.gathering import gathered
from station.places.rooms.place_names import named_by_rooms

LEAST_CERTAINTY = 1e-6  # of a room: a name of one without any is divided by it


def planned(place_map: PlaceMap, earlier: PlaceMap | None = None) -> PlaceMap:
    """The map with its floor plan, and with its places by room where it is of that grain.

    Rooms keep the ids and names that they had in it, or in an `earlier` map of the same frame, and so does what people
    made of them.
    """
    from station.places.rooms.plan import make_floor_plan  # SciPy, which a station needs only once somebody edits doors

    before = place_map if earlier is None else earlier
    plan = make_floor_plan(place_map.navigation, place_map.places, before.plan_edits, before.plan)
    if place_map.grain == "rooms":
        place_map = gathered(place_map, plan.room_of_place)
        ids = {place.id for place in place_map.places}
        plan = replace(plan, room_of_place={id: room for id, room in plan.room_of_place.items() if id in ids})
    return with_plan(replace(place_map, plan_edits=before.plan_edits), plan)


def with_plan(place_map: PlaceMap, plan: FloorPlan) -> PlaceMap:
    """The map with this plan, its places called after their rooms, and suggested names with the rooms they speak of."""
    plan = _told_apart(plan)
    places = named_by_rooms(place_map.places, plan)
    return replace(place_map, places=places, plan=plan, suggestions=_handed_on(place_map, plan))


def _handed_on(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """The suggestions, each for the room that what speaks for it names now; none for rooms that are gone.

    Several names by one source in one room share their confidence, and none is surer than the plan is of the room.
    """
    certainty = {room.id: room.certainty for room in plan.rooms}
    earlier = {} if place_map.plan is None else {room.id: room.certainty for room in place_map.plan.rooms}
    names_before = Counter((s.room, s.source) for s in place_map.suggestions)
    found: dict[tuple[str, str, str], NameSuggestion] = {}
    for s in sorted(place_map.suggestions, key=lambda s: s.confidence):  # of equal names the surest is kept
        if (room := _room_of(s, place_map, plan)) in certainty:
            found[room, s.name, s.source] = s
    names_now = Counter((room, source) for room, _, source in found)
    return tuple(
        replace(
            s,
            room=room,
            confidence=min(
                1.0,
                s.confidence
                * (names_before[s.room, s.source] / names_now[room, s.source])
                * (certainty[room] / max(earlier.get(s.room, certainty[room]), LEAST_CERTAINTY)),
            ),
        )
        for (room, _, _), s in sorted(found.items(), key=lambda item: item[0])
    )


def _room_of(suggestion: NameSuggestion, place_map: PlaceMap, plan: FloorPlan) -> str:
    """Id of the room that what speaks for a name names now, or the suggestion's own where nobody knows."""
    if suggestion.p_map is None or suggestion.keyframe_index is None:
        return suggestion.room
    T_map_cam = place_map.navigation.keyframes.T_world_cam[suggestion.keyframe_index]
    number = room_named(plan, suggestion.source, suggestion.p_map, T_map_cam[:3, 3])
    return suggestion.room if number is None else plan.rooms[number].id


def _told_apart(plan: FloorPlan) -> FloorPlan:
    """The plan with no name and no door's id twice, which records must not have. The first keeps what it has.

    A room that comes back may have been given the name that another one has by now; doors are called after where they
    are, in steps that are too large where a map's unit is.
    """
    names = _distinct([room.name for room in plan.rooms], "Room ")
    ids = _distinct([door.id for door in plan.doors], "door-")
    rooms = tuple(replace(room, name=name) for room, name in zip(plan.rooms, names, strict=True))
    doors = tuple(replace(door, id=id) for door, id in zip(plan.doors, ids, strict=True))
    return replace(plan, rooms=rooms, doors=doors)


def _distinct(words: Sequence[str], prefix: str) -> list[str]:
    """The words, upper and lower case being one; those that are there already become `prefix` and a free number."""
    free = (word for word in (f"{prefix}{n}" for n in count(1)) if word.casefold() not in {w.casefold() for w in words})
    seen: set[str] = set()
    distinct = []
    for word in words:
        distinct.append(next(free) if word.casefold() in seen else word)
        seen.add(word.casefold())
    return distinct


def with_suggestions_of(place_map: PlaceMap, source: SuggestionSource, found: Sequence[NameSuggestion]) -> PlaceMap:
    """The map with these suggestions in the place of all that its source made before."""
    if place_map.plan is None:
        return place_map
    others = tuple(s for s in place_map.suggestions if s.source != source)
    return with_plan(replace(place_map, suggestions=(*others, *found)), place_map.plan)


def with_suggestions_too(place_map: PlaceMap, before: PlaceMap) -> PlaceMap:
    """The map with what sources suggested in the other version that had suggested nothing in this one."""
    spoke = {s.source for s in place_map.suggestions}
    later = tuple(s for s in before.suggestions if s.source not in spoke)
    if place_map.plan is None or not later:
        return place_map
    return with_plan(replace(place_map, suggestions=(*place_map.suggestions, *later)), place_map.plan)


def with_suggestions(place_map: PlaceMap, say: Callable[[str], None] = lambda _: None) -> PlaceMap:
    """The map with names that something in its pictures speaks for; nothing is named yet.

    Looks at every picture, and says how far it is where that takes long.
    """
    from station.places.naming.suggest import suggest_names  # as above: workers make maps

    if place_map.plan is None:
        return place_map
    return replace(place_map, suggestions=suggest_names(place_map, place_map.plan, say))
