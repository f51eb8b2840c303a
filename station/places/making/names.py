"""Names of places that no person named: "Place 17", and where the rooms are known "Kitchen · 2"."""

from __future__ import annotations

from station.model.place_map import ROOM_SEPARATOR

NAME_PREFIX = "Place "
DOOR_SIDE = "door side"  # of a room with one door


def name_in_room(room: str, which: int | str) -> str:
    return f"{room}{ROOM_SEPARATOR}{which}"
