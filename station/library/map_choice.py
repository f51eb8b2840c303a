"""Which maps a station looks for its robots in: chosen by a person, kept in `active.json`, and never two of one flat.

The first one is *the* active map, whose places and graph are shown and edited; the others are looked in as well. The
order of the others means nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import msgspec

from shared.bounded import MAX_SETTINGS_BYTES, read_file
from shared.disk import make_folder, replace_file
from station.files.unwritable import cannot_write
from station.model.place_map import PlaceMap

FILE = "active.json"  # beside the maps


class _Choice(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the file says; without `also`, as with one map only, it is what stations before there were sets wrote."""

    id: str | None
    also: tuple[str, ...] = ()


def stored_choice(root: Path) -> tuple[str, ...]:
    """The ids that were chosen last, the first one first; none where nothing was, or nothing that can be read."""
    return _written(root) or ()


def store_choice(root: Path, chosen: tuple[str, ...]) -> None:
    """For one caller at a time. Raises Unwritable."""
    if chosen == _written(root):
        return
    content = msgspec.json.encode(_Choice(chosen[0] if chosen else None, chosen[1:])) + b"\n"
    try:
        make_folder(root)
        replace_file(root / FILE, content, scratch=root / f".{FILE}")
    except OSError as exc:
        raise cannot_write(root, exc) from exc


def _written(root: Path) -> tuple[str, ...] | None:
    """What the file says; None where it says nothing."""
    try:
        choice = msgspec.json.decode(read_file(root / FILE, MAX_SETTINGS_BYTES), type=_Choice)
    except (OSError, msgspec.DecodeError):
        return None
    return () if choice.id is None else tuple(dict.fromkeys((choice.id, *choice.also)))


def why_not_together(maps: Sequence[PlaceMap]) -> str:
    """Why these cannot be active at once, in a sentence; empty when they can.

    Two maps of the same rooms explain every picture equally well: half of the belief would go to each, and neither be
    known. That two navigations went through the same rooms nobody can tell from the maps alone; that two maps come from
    one navigation, or that one was made again from the other, their navigations and places tell.
    """
    for a, b in itertools.combinations(maps, 2):
        navigations = sorted(_navigations(a) & _navigations(b))
        if navigations or {place.id for place in a.places} & {place.id for place in b.places}:
            both = f"both are made from {navigations[0]}" if navigations else "they share places"
            return (
                f"{a.name} and {b.name} ({a.id}, {b.id}) are maps of the same rooms, {both}; together the robot would "
                "be known in neither: choose one of them, or build one map from all their navigations"
            )
    return ""


def _navigations(place_map: PlaceMap) -> set[str]:
    """Those it was made from: the ids of several are joined (merge.py)."""
    return set(place_map.navigation.id.split("+"))
