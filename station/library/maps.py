"""The maps of this station: which there are, which are active, and what the first of these shows."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import numpy.typing as npt

from shared.advice import complete
from shared.errors import RobotSystemError
from station.errors import Conflict, Unknown
from station.events import Notifier
from station.files.unwritable import Unwritable
from station.library.active_maps import keep_choice, kept_choice, why_not_together
from station.maps.editing import tidy_name, with_place_renamed
from station.maps.record import MapRecord, says_same_of_places
from station.maps.repair.purging import collect_garbage, purge
from station.maps.store import MapStore
from station.model.map_store import MapSummary, StoreAddress
from station.model.place_map import Place, PlaceMap
from station.model.points import NO_PLACE
from station.places.localisation.index_file import forget_index
from station.places.making.changes import with_place_hidden, with_places_merged
from station.places.making.colours import number_places
from station.places.making.place_images import evidence_of_place

logger = logging.getLogger(__name__)
MAX_WHY = 200
WHITE_DEVIATION = 100.0  # grey levels, as in the reports: images of one place seldom differ by more


@dataclass(frozen=True, slots=True, eq=False)
class ActiveMap:
    """A map in use, and what is derived from it once."""

    place_map: PlaceMap
    place_of_point: npt.NDArray[np.uint8]  # (M,) number of its place, NO_PLACE for none
    numbers: Mapping[str, int]  # of the places, by id; also of some that are gone and may come back

    def place(self, place_id: str) -> Place:
        """Raises Unknown."""
        for place in self.place_map.places:
            if place.id == place_id:
                return place
        raise Unknown(f"the active map has no place {place_id!r}; GET /places lists them")

    @property
    def visible_places(self) -> tuple[Place, ...]:
        """Those that are not hidden: the graph's nodes."""
        return tuple(place for place in self.place_map.places if not place.hidden)


@dataclass(frozen=True, slots=True)
class PlacesChange:
    """A place was renamed, hidden or shown, or places were merged."""

    version: int  # of the map, that it led to
    previous: int  # the version that it changed
    why: str  # for a person
    changed_wall_s: float


class Maps:
    """The store and the active maps. Reading and writing maps happens in threads.

    The robots are looked for in all active maps. *The* active map is the first of them: places, graph and what is made
    of them are its own.
    """

    def __init__(self, address: StoreAddress, events: Notifier) -> None:
        self.address = address
        self._store = MapStore(address, self._found_damage)
        self._events = events
        self._loop: asyncio.AbstractEventLoop | None = None
        self._chosen: tuple[str, ...] = ()  # by a person; of these the active maps are those that can be read
        self._active: tuple[ActiveMap, ...] = ()
        self._changing = asyncio.Lock()
        self.revision = 0  # counts what the active map was, so that a page knows when to read it again

    @property
    def active(self) -> ActiveMap | None:
        """The first of the active maps."""
        return self._active[0] if self._active else None

    @property
    def all_active(self) -> tuple[ActiveMap, ...]:
        """The first one first."""
        return self._active

    def among_active(self, map_id: str) -> ActiveMap | None:
        """The active map of this id."""
        return next((active for active in self._active if active.place_map.id == map_id), None)

    def require_active(self) -> ActiveMap:
        """Raises Conflict in words when no map is active."""
        if not self._active:
            raise Conflict("no map is active; build one with POST /maps and choose it with PUT /maps/active")
        return self._active[0]

    async def list(self) -> tuple[MapSummary, ...]:
        return await asyncio.to_thread(self._store.list)

    async def open(self) -> None:
        """Activate the maps that were active when the station ended, as far as they can be read; says which cannot.

        What was chosen stays written down: a disk that is away for one start must not make a person choose again.
        """
        self._loop = asyncio.get_running_loop()
        async with self._changing:
            self._chosen = kept_choice(self.address.root)
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
        self._active = tuple(maps)
        self.revision += 1
        self._events.changed("map")
        names = [active.place_map.name for active in maps]
        if names:
            self._events.notify(
                "map", f"using {names[0]}" + (f", and {' and '.join(names[1:])} too" if names[1:] else "")
            )

    async def _choose(self, chosen: tuple[str, ...]) -> None:
        self._chosen = chosen
        try:
            await asyncio.to_thread(keep_choice, self.address.root, chosen)
        except Unwritable as exc:
            self._events.notify("map", f"which map is in use will be forgotten at the next start: {exc}", "warning")

    async def delete(self, map_id: str) -> bool:
        """Put a map into the bin; True where robots were looked for in it, and are no longer.

        Raises Unknown, or Conflict when it is the one whose places are in use.
        """
        async with self._changing:
            if self._active and self._active[0].place_map.id == map_id:
                raise Conflict(f"{self._active[0].place_map.name} is in use; choose another map first")
            await self._require(map_id)
            await asyncio.to_thread(self._store.delete, map_id)
            if map_id in self._chosen:
                await self._choose(tuple(chosen for chosen in self._chosen if chosen != map_id))
            gone = self.among_active(map_id)
            if gone is not None:
                self._events.notify(
                    "map", f"{gone.place_map.name} is deleted, so it is left out from now on", "warning"
                )
                self._use([active for active in self._active if active is not gone])
        self._events.changed("map")
        return gone is not None

    async def deleted(self) -> tuple[MapSummary, ...]:
        """Maps that can be restored."""
        return await asyncio.to_thread(self._store.deleted)

    async def restore(self, map_id: str) -> MapSummary:
        """Take a map out of the bin. Raises Unknown."""
        if map_id not in {summary.id for summary in await self.deleted()}:
            raise Unknown(f"there is no deleted map {map_id!r}; GET /bin lists what can be restored")
        await asyncio.to_thread(self._store.undo, map_id)
        self._events.changed("map")
        return next(summary for summary in await self.list() if summary.id == map_id)

    async def purge(self, map_id: str) -> None:
        """Delete a deleted map for good."""
        await asyncio.to_thread(purge, self._store, map_id)
        await asyncio.to_thread(collect_garbage, self._store)
        await asyncio.to_thread(forget_index, self._store.address.root, map_id)

    async def rename(self, map_id: str, name: str) -> MapSummary:
        """Name a map, in use or not. Raises Unknown, or DataError for a name that is empty or too long."""
        name = tidy_name(name, "a map's name")
        async with self._changing:
            await self._require(map_id)
            change = partial(replace, name=name)
            place_map = await asyncio.to_thread(self._store.edit, map_id, change, f"the map is {name} now"[:MAX_WHY])
            if self.among_active(map_id) is not None:
                self._take(place_map)
        self._events.changed("map")
        return next(summary for summary in await self.list() if summary.id == map_id)

    async def rename_place(self, place_id: str, name: str) -> Place:
        """Raises Conflict, Unknown, or DataError for a name in use."""
        async with self._changing:
            active = self.require_active()
            why = f"{active.place(place_id).name} is {name.strip()} now"[:MAX_WHY]
            rename = partial(with_place_renamed, place_id=place_id, name=name)
            place_map = await asyncio.to_thread(self._store.edit, active.place_map.id, rename, why)
            return self._take(place_map).place(place_id)

    async def hide_place(self, place_id: str, hidden: bool) -> Place:
        """Leave a place out of answers and graph, or show it again. Raises Conflict, Unknown."""
        await self._regroup(
            [place_id],
            lambda m: with_place_hidden(m, place_id, hidden),
            lambda places: f"{places[0].name} is {'hidden' if hidden else 'shown again'}",
        )
        return self.require_active().place(place_id)

    async def merge_places(self, place_ids: Sequence[str]) -> Place:
        """Make several places one, which keeps id and name of the first. Raises Conflict, Unknown, DataError."""
        await self._regroup(
            place_ids,
            lambda m: with_places_merged(m, place_ids),
            lambda places: f"{' and '.join(place.name for place in places)} are one",
        )
        return self.require_active().place(place_ids[0])

    async def _regroup(
        self, place_ids: Sequence[str], change: Callable[[PlaceMap], PlaceMap], why: Callable[[Sequence[Place]], str]
    ) -> None:
        async with self._changing:
            active = self.require_active()
            places = tuple(active.place(place_id) for place_id in place_ids)
            self._take(await asyncio.to_thread(self._store.edit, active.place_map.id, change, why(places)[:MAX_WHY]))

    async def changes(self) -> tuple[PlacesChange, ...]:
        """What people made of the active map's places, the newest first: what `undo` takes back. Raises Conflict."""
        map_id = self.require_active().place_map.id
        return _changes(await asyncio.to_thread(self._store.history, map_id))

    async def undo(self, version: int | None) -> PlacesChange:
        """Take back the newest change of the places; `version`: only if it is that one. Returns what was taken back.

        The map keeps its name: that is no change of its places.

        Raises:
            Conflict: no map is active, there is nothing to take back, or `version` is not the newest change.
        """
        async with self._changing:
            map_id = self.require_active().place_map.id
            history = await asyncio.to_thread(self._store.history, map_id)
            changes = _changes(history)
            if not changes:
                raise Conflict("no change of the places can be taken back: they are as they were made")
            if version is not None and changes[0].version != version:
                raise Conflict(_why_not_that_one(version, changes))
            to = changes[0].previous
            await asyncio.to_thread(self._store.undo, map_id, to, newest_is=history[0].number, keeps_name=True)
            self._take(await asyncio.to_thread(self._store.load, map_id))
            return changes[0]

    def _take(self, place_map: PlaceMap) -> ActiveMap:
        """An active map with other places or names."""
        self.revision += 1
        before = self.among_active(place_map.id)
        taken = _numbered(place_map, {} if before is None else before.numbers)
        self._active = tuple(taken if active is before else active for active in self._active)
        self._events.changed("map")
        return taken

    def _found_damage(self, sentence: str) -> None:
        """The store found something wrong, in whatever thread it was read."""
        if not (self.address.database or self.address.blobs):  # they are named by a file that we do not know
            sentence = complete(sentence, "station", {"--data": self.address.root.parent})
        logger.warning("%s", sentence)
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._events.notify, "map", sentence, "warning")

    def changed(self) -> None:
        """A map was added to the store."""
        self._events.changed("map")

    async def load(self, map_id: str) -> ActiveMap:
        """Any map, for looking at. Raises Unknown or DataError."""
        if (active := self.among_active(map_id)) is not None:
            return active
        await self._require(map_id)
        return await asyncio.to_thread(_derive, self._store, map_id)

    async def _require(self, map_id: str) -> None:
        known = {summary.id for summary in await self.list()}
        if map_id not in known:
            raise Unknown(f"there is no map {map_id!r}; GET /maps lists them")


def mean_image(place_map: PlaceMap, place: Place) -> bytes:
    """A place's mean image as JPEG (eq. 4.2). Raises Unknown when it has no images."""
    return _as_jpeg(evidence_of_place(place_map, place).mean_bgr, place)


def deviation_image(place_map: PlaceMap, place: Place) -> bytes:
    """How much the brightness of a place's images differs, as JPEG. Raises Unknown when it has no images."""
    deviation = evidence_of_place(place_map, place).deviation
    return _as_jpeg(np.clip(deviation * (255.0 / WHITE_DEVIATION), 0, 255).astype(np.uint8), place)


def _as_jpeg(pixels: npt.NDArray[np.uint8], place: Place) -> bytes:
    if pixels.size == 0:
        raise Unknown(f"{place.name} has no readable images")
    ok, encoded = cv2.imencode(".jpg", pixels)
    if not ok:
        raise Unknown(f"{place.name} has no readable images")
    return encoded.tobytes()


def keyframe_image(place_map: PlaceMap, keyframe: int) -> bytes:
    """A keyframe's image file. Raises Unknown."""
    encoded = place_map.navigation.keyframes.encoded
    if not 0 <= keyframe < len(encoded) or not encoded[keyframe]:
        raise Unknown(f"map {place_map.id} has no image {keyframe}")
    return encoded[keyframe]


def _derive(store: MapStore, map_id: str) -> ActiveMap:
    return _numbered(store.load(map_id), {})


def _require_together(maps: Sequence[ActiveMap]) -> None:
    """Raises Conflict where two of them are of the same rooms."""
    if reason := why_not_together([active.place_map for active in maps]):
        raise Conflict(reason)


def _numbered(place_map: PlaceMap, kept: Mapping[str, int]) -> ActiveMap:
    numbers = number_places(place_map.places, place_map.edges, kept)
    return ActiveMap(place_map, _place_of_point(place_map, numbers), {**kept, **numbers})


def _changes(history: Sequence[MapRecord]) -> tuple[PlacesChange, ...]:
    """The edits that led from the map as it was made to the newest version; those taken back are not among them."""
    by_number = {record.number: record for record in history}
    changes: list[PlacesChange] = []
    record = by_number.get(history[0].content) if history else None
    while record is not None and record.kind == "edited":
        before = by_number.get(record.previous or 0)
        if before is None:
            break  # it cannot be read any more, so nothing leads back to it
        if not says_same_of_places(before, record):  # else the map was renamed
            changes.append(PlacesChange(record.number, before.number, record.why, record.created_ms / 1e3))
        record = by_number.get(before.content)
    return tuple(changes)


def _why_not_that_one(version: int, changes: Sequence[PlacesChange]) -> str:
    """Why this version is not the change that can be taken back."""
    newest = changes[0]
    later = next((i for i, change in enumerate(changes) if change.version == version), None)
    if later is not None:
        others = "another change" if later == 1 else f"{later} other changes"
        return f"{others} came after version {version}, the newest is version {newest.version}: {newest.why}"
    return (
        f"version {version} is no change of the places that can be taken back; "
        f"the newest is version {newest.version}: {newest.why}; GET /places/changes lists them"
    )


def _place_of_point(place_map: PlaceMap, numbers: Mapping[str, int]) -> npt.NDArray[np.uint8]:
    place_of_point = np.full(len(place_map.navigation.landmarks), NO_PLACE, np.uint8)
    for place in place_map.places:
        if not place.hidden:
            place_of_point[place.landmark_index] = numbers.get(place.id, NO_PLACE)
    return place_of_point
