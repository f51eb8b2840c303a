"""A floor plan in words and in plain values."""

from __future__ import annotations

from typing import Any

from station.model.floor_plan import FloorPlan
from station.model.place_map import PlaceMap


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
                "area": round(room.area, 3),
                "middle": [round(float(v), 3) for v in room.middle],
                "places": [place for place, its_room in plan.room_of_place.items() if its_room == room.id],
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
    """A line for each room, then for each door."""
    is_metric = place_map.navigation.is_metric
    name = {room.id: room.name for room in plan.rooms}
    if not plan.rooms:
        return ["no room: the navigation saw no free space"]
    lines = []
    for room in plan.rooms:
        area = f"{room.area:.1f} m², " if is_metric else ""
        count = sum(its_room == room.id for its_room in plan.room_of_place.values())
        lines.append(f"{room.name}: {area}{count} place{'' if count == 1 else 's'}")
    for door in plan.doors:
        other = "outside of the map" if door.rooms[1] is None else name[door.rooms[1]]
        width = f", {door.width:.2f} m wide" if is_metric else ""
        lines.append(f"{name[door.rooms[0]]} - {other}: door{width}")
    return lines
