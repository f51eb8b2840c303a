"""Names of places that no person named: "Place 17", and where the rooms are known "Kitchen · 2"."""

from __future__ import annotations

import re

NAME_PREFIX = "Place "
ROOM_SEPARATOR = " · "
DOOR_SIDE = "door side"
_IN_ROOM = re.compile(rf".{ROOM_SEPARATOR}(\d+|{DOOR_SIDE})\Z")


def has_own_name(name: str) -> bool:
    """Whether a person named the place, not its clustering or its room."""
    is_numbered = name.startswith(NAME_PREFIX) and name.removeprefix(NAME_PREFIX).isdecimal()
    return not is_numbered and _IN_ROOM.search(name) is None


def name_in_room(room: str, which: int | str) -> str:
    return f"{room}{ROOM_SEPARATOR}{which}"
