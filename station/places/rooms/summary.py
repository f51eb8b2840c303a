"""A floor plan in words and in plain values."""

from __future__ import annotations

from typing import Any

from shared.text import fitted
from station.model.floor_plan import FloorPlan, NameSuggestion, Room, SuggestionSource
from station.model.place_map import PlaceMap

NAME_COLUMNS = 40  # of a line: a longer name is cut, and whole as JSON
SOURCES: dict[SuggestionSource, str] = {"door plate": "printed word", "other map": "another map"}  # as on the page


def suggested(place_map: PlaceMap, room: Room) -> list[NameSuggestion]:
    """Names that something seen speaks for, and that the room has not, the surest first."""
    found = [s for s in place_map.suggestions if s.room == room.id and s.name.casefold() != room.name.casefold()]
    return sorted(found, key=lambda s: -s.confidence)


def plan_summary(plan: FloorPlan, place_map: PlaceMap) -> dict[str, Any]:
    """`{"map", "metric", "rooms": [...], "doors": [...]}`; areas and widths in m² and m, or of the map's own units."""
    is_metric = place_map.navigation.is_metric
    return {
        "map": place_map.id,
        "metric": is_metric,
        "rooms": [
            {
                "id": room.id,
                "name": room.name,
                "named": room.id in place_map.plan_edits.names,
                "area": round(room.area, 3),
                "middle": [round(float(v), 3) for v in room.middle],
                "places": [place for place, its_room in plan.room_of_place.items() if its_room == room.id],
                "suggestions": [
                    {
                        "name": s.name,
                        "source": s.source,
                        "confidence": round(s.confidence, 3),
                        "reason": s.reason,
                        "picture": s.keyframe_index,
                    }
                    for s in suggested(place_map, room)
                ],
            }
            for room in plan.rooms
        ],
        "doors": [
            {
                "id": door.id,
                "rooms": list(door.rooms),
                "width": round(door.width, 3),
                "ends": [[round(float(v), 3) for v in end] for end in door.ends],
                "drawn": door.is_drawn,
            }
            for door in plan.doors
        ],
    }


def plan_lines(plan: FloorPlan, place_map: PlaceMap) -> list[str]:
    """A line for each room and beneath it for each name that is suggested, then for each door."""
    is_metric = place_map.navigation.is_metric
    name = {room.id: fitted(room.name, NAME_COLUMNS) for room in plan.rooms}
    if not plan.rooms:
        return ["no room: the navigation saw no free space"]
    lines = []
    for room in plan.rooms:
        area = f"{room.area:.1f} m², " if is_metric else ""
        count = sum(its_room == room.id for its_room in plan.room_of_place.values())
        lines.append(f"{name[room.id]}: {area}{count} place{'' if count == 1 else 's'}")
        lines.extend(f"  {_in_words(suggestion)}" for suggestion in suggested(place_map, room))
    for door in plan.doors:
        other = "outside of the map" if door.rooms[1] is None else name[door.rooms[1]]
        width = f", {door.width:.2f} m wide" if is_metric else ""
        lines.append(f"{name[door.rooms[0]]} - {other}: door{width}")
    return lines


def _in_words(s: NameSuggestion) -> str:
    picture = "" if s.keyframe_index is None else f" (picture {s.keyframe_index})"
    return (
        f"{fitted(s.name, NAME_COLUMNS)}? ({s.confidence:.0%}, {SOURCES.get(s.source, s.source)}) {s.reason}{picture}"
    )
