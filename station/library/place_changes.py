"""What people made of a map's places, and what of it can be taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from station.library.active_maps import ActiveMap
from station.maps.record import MapRecord, same_places


@dataclass(frozen=True, slots=True)
class PlacesChange:
    """A place was renamed, hidden or shown, or places were merged."""

    map_id: str
    version: int  # of that map, after the change; each map counts its own
    previous: int  # the version that it changed
    why: str  # for a person
    changed_wall_s: float


@dataclass(frozen=True, slots=True, eq=False)
class PlacesEdit:
    """What somebody made of the active map just now."""

    active: ActiveMap  # as it is then
    version: int | None  # of the map, that the edit led to, for an undo of just that; None: it was so already


def changes_of(history: Sequence[MapRecord]) -> tuple[PlacesChange, ...]:
    """The edits that led from the map as it was made to the newest version; those taken back are not among them."""
    by_number = {record.number: record for record in history}
    changes: list[PlacesChange] = []
    record = by_number.get(history[0].content) if history else None
    while record is not None and record.kind == "edited":
        before = by_number.get(record.previous or 0)
        if before is None:
            break  # it cannot be read any more, so nothing leads back to it
        if not same_places(before, record):  # else the map was renamed, or names were suggested
            changed_s = record.created_ms / 1e3
            changes.append(PlacesChange(record.map_id, record.number, before.number, record.why, changed_s))
        record = by_number.get(before.content)
    return tuple(changes)


def why_not_that_one(version: int, changes: Sequence[PlacesChange]) -> str:
    """What to answer to an undo of any but the newest change."""
    newest = changes[0]
    later = next((i for i, change in enumerate(changes) if change.version == version), None)
    if later is not None:
        others = "another change" if later == 1 else f"{later} other changes"
        return f"{others} came after version {version}, the newest is version {newest.version}: {newest.why}"
    return (
        f"version {version} is no change of the places that can be taken back; "
        f"the newest is version {newest.version}: {newest.why}; GET /places/changes lists them"
    )
