"""The maps of this station: which there are, which are active, and what the first of these shows."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from shared.advice import complete
from shared.bounded import shown
from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from station.errors import Conflict, Unknown
from station.events import Notifier
from station.files.unwritable import Unwritable
from station.library.active_maps import ActiveMap, ActiveMaps, numbered
from station.library.map_choice import store_choice, stored_choice, why_not_together
from station.library.place_changes import PlacesChange, PlacesEdit, changes_of, why_not_that_one
from station.maps.editing import tidy_name, with_place_renamed
from station.maps.repair.purging import collect_garbage, purge, tidy_up
from station.maps.store import MapStore
from station.model.map_store import MapSummary, StoreAddress
from station.model.place_map import PlaceMap
from station.places.localisation.index_path import forget_index
from station.places.making.changes import with_place_hidden, with_places_merged
from station.places.rooms.edits import (
    with_door_erased,
    with_name_taken_back,
    with_room_renamed,
    with_room_split,
    with_rooms_merged,
)
from station.places.rooms.planning import with_suggestions_too

logger = logging.getLogger(__name__)
MAX_WHY = 200


class Maps:
    """The store and the active maps. Reading and writing maps happens in threads."""

    def __init__(self, address: StoreAddress, events: Notifier) -> None:
        self.address = address
        self._store = MapStore(address, self._found_damage)
        self._events = events
        self._loop: asyncio.AbstractEventLoop | None = None
        self._chosen: tuple[str, ...] = ()  # by a person; of these the active maps are those that can be read
        self.active = ActiveMaps()
        self._changing = asyncio.Lock()

    async def list(self) -> tuple[MapSummary, ...]:
        return await asyncio.to_thread(self._store.list)

    async def open(self) -> None:
        """Activate the maps that were active when the station ended, as far as they can be read; says which cannot.

        What was chosen stays written down: a disk that is away for one start must not make a person choose again.
        """
        self._loop = asyncio.get_running_loop()
        async with self._changing:
            self._chosen = stored_choice(self.address.root)
            usable: list[ActiveMap] = []
            for map_id in self._chosen:
                try:
                    await self._require(map_id)
                    found = await asyncio.to_thread(_derive, self._store, map_id)
                    _require_together([*usable, found])
                except RobotSystemError as exc:
                    self._events.notify("map", f"a map that was in use is left out, it cannot be used: {exc}", "error")
                else:
                    usable.append(found)
            self._use(usable)

    async def activate(self, map_ids: Sequence[str]) -> None:
        """Use these maps, the first one first, or none. Nothing changes where one of them cannot be used.

        Where the choice cannot be written down it holds until the station ends, and a warning says so.

        Raises:
            Unknown: there is no such map.
            DataError: the files of a map are damaged.
            Conflict: two of them are of the same rooms.
        """
        chosen = tuple(dict.fromkeys(map_ids))
        async with self._changing:
            for map_id in chosen:
                await self._require(map_id)
            wanted = [await asyncio.to_thread(_derive, self._store, map_id) for map_id in chosen]
            _require_together(wanted)
            self._use(wanted)
            await self._choose(chosen)

    def _use(self, maps: Sequence[ActiveMap]) -> None:
        self.active.use(maps)
        self._events.changed("map")
        names = [active.place_map.name for active in maps]
        if names:
            self._events.notify(
                "map", f"using {names[0]}" + (f", and {' and '.join(names[1:])} too" if names[1:] else "")
            )

    async def _choose(self, chosen: tuple[str, ...]) -> None:
        self._chosen = chosen
        try:
            await asyncio.to_thread(store_choice, self.address.root, chosen)
        except Unwritable as exc:
            self._events.notify("map", f"which map is in use will be forgotten at the next start: {exc}", "warning")

    async def delete(self, map_id: str) -> bool:
        """Put a map into the bin; True where robots were looked for in it, and are no longer.

        Raises Unknown, or Conflict when it is the one whose places are in use.
        """
        async with self._changing:
            first = self.active.first
            if first is not None and first.place_map.id == map_id:
                raise Conflict(f"{first.place_map.name} is in use; choose another map first")
            await self._require(map_id)
            await asyncio.to_thread(self._store.delete, map_id)
            if map_id in self._chosen:
                await self._choose(tuple(chosen for chosen in self._chosen if chosen != map_id))
            gone = self.active.find(map_id)
            if gone is not None:
                self._events.notify(
                    "map", f"{gone.place_map.name} is deleted, so it is left out from now on", "warning"
                )
                self._use([active for active in self.active.all if active is not gone])
        self._events.changed("map")
        return gone is not None

    async def deleted(self) -> tuple[MapSummary, ...]:
        """Maps that can be restored."""
        return await asyncio.to_thread(self._store.deleted)

    async def restore(self, map_id: str) -> MapSummary:
        """Take a map out of the bin. Raises Unknown."""
        if map_id not in {summary.id for summary in await self.deleted()}:
            raise Unknown(f"there is no deleted map {shown(map_id)}; GET /bin lists what can be restored")
        await asyncio.to_thread(self._store.undo, map_id)
        self._events.changed("map")
        return next(summary for summary in await self.list() if summary.id == map_id)

    async def purge(self, map_id: str) -> None:
        """Delete a deleted map for good."""
        await asyncio.to_thread(lambda: purge(self._store.for_writing(), map_id))
        await asyncio.to_thread(lambda: collect_garbage(self._store.for_writing()))
        await asyncio.to_thread(forget_index, self._store.address.root, map_id)

    async def tidy_up(self) -> None:
        """Remove what builds left that were killed. Raises DataError."""
        await asyncio.to_thread(tidy_up, self._store)

    async def rename(self, map_id: str, name: str) -> MapSummary:
        """Name a map, in use or not. Raises Unknown, or DataError for a name that is empty or too long."""
        name = tidy_name(name, "a map's name")
        async with self._changing:
            await self._require(map_id)
            change = partial(replace, name=name)
            why = f"the map is {name} now"[:MAX_WHY]
            place_map, _ = await asyncio.to_thread(self._store.edit, map_id, change, why)
            if self.active.find(map_id) is not None:
                self._replace(place_map)
        self._events.changed("map")
        return next(summary for summary in await self.list() if summary.id == map_id)

    async def refresh(self, map_id: str) -> None:
        """A job changed this map in the store; show it as it is there, where it is active. Raises DataError."""
        async with self._changing:
            if self.active.find(map_id) is not None:
                self._replace(await asyncio.to_thread(self._store.load, map_id))

    async def rename_place(self, place_id: str, name: str) -> PlacesEdit:
        """Raises Conflict, Unknown, or DataError for a name in use."""
        rename = partial(with_place_renamed, place_id=place_id, name=name)
        return await self._edit(rename, lambda active: f"{active.place(place_id).name} is {name.strip()} now")

    async def hide_place(self, place_id: str, hidden: bool) -> PlacesEdit:
        """Leave a place out of answers and graph, or show it again. Raises Conflict, Unknown."""
        hide = partial(with_place_hidden, place_id=place_id, hidden=hidden)
        become = "hidden" if hidden else "shown again"
        return await self._edit(hide, lambda active: f"{active.place(place_id).name} is {become}")

    async def merge_places(self, place_ids: Sequence[str]) -> PlacesEdit:
        """Make several places one, which keeps id and name of the first. Raises Conflict, Unknown, DataError."""
        return await self._edit(
            partial(with_places_merged, place_ids=place_ids),
            lambda active: f"{' and '.join(active.place(place_id).name for place_id in place_ids)} are one",
        )

    async def rename_room(self, room_id: str, name: str) -> PlacesEdit:
        """Raises Conflict, Unknown, or DataError for a name in use."""
        name = tidy_name(name, "a room's name")
        rename = partial(with_room_renamed, room_id=room_id, name=name)
        return await self._edit(rename, lambda active: f"{active.room(room_id).name} is {name} now")

    async def take_room_name_back(self, room_id: str) -> PlacesEdit:
        """The room is called as one that nobody named. Raises Conflict, Unknown, DataError."""
        forget = partial(with_name_taken_back, room_id=room_id)
        return await self._edit(forget, lambda active: f"{active.room(room_id).name} has no name any more")

    async def merge_rooms(self, room_ids: Sequence[str]) -> PlacesEdit:
        """Make several rooms one, which keeps id and name of the first. Raises Conflict, Unknown, DataError."""
        return await self._edit(
            partial(with_rooms_merged, room_ids=room_ids),
            lambda active: f"{' and '.join(active.room(room_id).name for room_id in room_ids)} are one",
        )

    async def split_room(self, line: FloatArray) -> PlacesEdit:
        """Draw a door along a line (2, 2) on the ground. Raises Conflict, DataError."""
        return await self._edit(partial(with_room_split, line=line), lambda _: "a door was drawn")

    async def erase_door(self, door_id: str) -> PlacesEdit:
        """Make one room of those that it leads to. Raises Conflict, Unknown, DataError."""

        def why(active: ActiveMap) -> str:
            rooms = [active.room(room_id).name for room_id in active.door(door_id).rooms if room_id is not None]
            return f"the door between {' and '.join(rooms)} was erased"

        return await self._edit(partial(with_door_erased, door_id=door_id), why)

    async def _edit(self, change: Callable[[PlaceMap], PlaceMap], why: Callable[[ActiveMap], str]) -> PlacesEdit:
        """Change the active map. `why` says what is done to it, and raises where that cannot be."""
        async with self._changing:
            active = self.active.require_first()
            said = why(active)[:MAX_WHY]
            place_map, version = await asyncio.to_thread(self._store.edit, active.place_map.id, change, said)
            return PlacesEdit(self._replace(place_map), version)

    async def changes(self) -> tuple[PlacesChange, ...]:
        """What people made of the active map's places and rooms, newest first: `undo` takes them. Raises Conflict."""
        map_id = self.active.require_first().place_map.id
        return changes_of(await asyncio.to_thread(self._store.history, map_id))

    async def undo(self, version: int | None, of_map: str | None = None) -> PlacesChange:
        """Take back the newest change of places or rooms; `version`: only if it is that one. Returns the change.

        `of_map`: only if that map is in use: another one's change may have the same version.

        The map keeps its name, and what was suggested meanwhile: these are no changes of its places.

        Raises:
            Conflict: no map is active, another one is, there is nothing to take back, or `version` is not the newest
                change.
        """
        async with self._changing:
            before = self.active.require_first().place_map
            map_id = before.id
            if of_map is not None and of_map != map_id:
                why = f"the change is of {shown(of_map)}, and {before.name} ({map_id}) is in use"
                raise Conflict(f"{why}; use that map to take it back")
            history = await asyncio.to_thread(self._store.history, map_id)
            changes = changes_of(history)
            if not changes:
                raise Conflict("no change of the places can be taken back: they are as they were made")
            if version is not None and changes[0].version != version:
                raise Conflict(why_not_that_one(version, changes))
            to = changes[0].previous
            await asyncio.to_thread(self._store.undo, map_id, to, newest_is=history[0].number, keeps_name=True)
            keep = partial(with_suggestions_too, before=before)
            kept, _ = await asyncio.to_thread(self._store.edit, map_id, keep, "names are suggested as before")
            self._replace(kept)
            return changes[0]

    def _replace(self, place_map: PlaceMap) -> ActiveMap:
        """An active map with other places or names."""
        changed = self.active.replace(place_map)
        self._events.changed("map")
        return changed

    def _found_damage(self, sentence: str) -> None:
        """The store found something wrong, in whatever thread it was read."""
        if not (self.address.database or self.address.blobs):  # they are named by a file that we do not know
            sentence = complete(sentence, "station", {"--data": self.address.root.parent})
        logger.warning("%s", sentence)
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._events.notify, "map", sentence, "warning")

    async def load(self, map_id: str) -> ActiveMap:
        """Any map, for looking at. Raises Unknown or DataError."""
        if (active := self.active.find(map_id)) is not None:
            return active
        await self._require(map_id)
        return await asyncio.to_thread(_derive, self._store, map_id)

    async def _require(self, map_id: str) -> None:
        known = {summary.id for summary in await self.list()}
        if map_id not in known:
            raise Unknown(f"there is no map {shown(map_id)}; GET /maps lists them")


def _derive(store: MapStore, map_id: str) -> ActiveMap:
    return numbered(store.load(map_id), {})


def _require_together(maps: Sequence[ActiveMap]) -> None:
    """Raises Conflict where two of them are of the same rooms."""
    if reason := why_not_together([active.place_map for active in maps]):
        raise Conflict(reason)
