"""Work on a map store for the crash tests: saving, building, renaming, merging, migrating; and what must hold after."""

from __future__ import annotations

import functools
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from sqlalchemy import text

from shared.errors import DataError
from station.files.navigation_folder import save_navigation
from station.maps.database import VERSIONS, upgrade
from station.maps.folder import save_map_folder
from station.maps.repair.check import verify
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.navigation import Navigation
from station.model.place_map import PlaceGrain, PlaceMap
from station.places.making.build import build_map
from station.places.making.changes import with_places_merged
from station.workers.library_jobs import LibraryJobs
from tests.support.crashing.child import Child, Scenario
from tests.support.store import rename_place
from tests.support.synthetic_home import drive, furnished_room, navigate

DATABASE = "database-url"  # a file with the URL of a PostgreSQL database; absent: SQLite in the folder
DRIVES = ("nav-a", "nav-b", "nav-c")  # the first two of one room
NAMED = "Sofa"
STATIONS = ("desk", "hall")


def made_up_navigation(number: int) -> Navigation:
    """A drive through a made-up room with several places."""
    home = furnished_room(1 if number < 2 else 3)
    return navigate(home, drive(home, number + 1, frames=40, turns=1.0), seed=number + 1, name=DRIVES[number])


MAP = build_map(made_up_navigation(0))


def variant(number: int) -> PlaceMap:
    """The map with a number in its name, in its cloud and in its pictures: a mixture would show."""
    landmarks = replace(MAP.navigation.landmarks, p_world=MAP.navigation.landmarks.p_world + number)
    keyframes = MAP.navigation.keyframes
    ok, picture = cv2.imencode(".png", np.full((8, 8), number % 256, np.uint8))
    assert ok
    keyframes = replace(keyframes, encoded=(picture.tobytes(), *keyframes.encoded[1:]))
    navigation = replace(MAP.navigation, landmarks=landmarks, keyframes=keyframes)
    return replace(MAP, name=f"v{number}", navigation=navigation)


def number_of(place_map: PlaceMap) -> int:
    """The number of a variant. Raises AssertionError for a mixture of two."""
    number = int(place_map.name.removeprefix("v"))
    shift = place_map.navigation.landmarks.p_world[0, 0] - MAP.navigation.landmarks.p_world[0, 0]
    picture = cv2.imdecode(np.frombuffer(place_map.navigation.keyframes.encoded[0], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None, "a picture that no longer opens"
    assert round(float(shift)) == number and int(picture[0, 0]) == number % 256, "a mixture of two maps"
    return number


def address(folder: Path, author: str = "") -> StoreAddress:
    """Where the store of this folder is."""
    url = folder / DATABASE
    return StoreAddress(folder / "maps", url.read_text() if url.is_file() else "", author=author)


def opened(folder: Path) -> MapStore:
    """The store after the crash. Raises AssertionError when anything in it is not sound."""
    told: list[str] = []
    store = MapStore(address(folder), told.append)
    damages = verify(store)
    assert not damages, f"damaged: {damages[0].sentence}"
    assert not told, f"not sound: {told[0]}"
    return store


def read_all(folder: Path, promises: list[object]) -> None:
    """Every map can be read, also where nothing can be written."""
    store = MapStore(address(folder), lambda _: None)
    for summary in store.list():
        assert not summary.damaged, summary.damaged
        store.load(summary.id)
    damages = verify(store)
    assert not damages, f"damaged: {damages[0].sentence}"
    assert not promises or store.list() or store.deleted(), "what was promised cannot be seen"
    store.close()


def read_prepared(folder: Path, promises: list[object]) -> None:
    """As read_all, of a store in which there were maps from the beginning."""
    read_all(folder, ["prepared", *promises])


def read_migrating(folder: Path, promises: list[object]) -> None:
    """As read_all: all three maps, however far the migration came."""
    read_all(folder, promises)
    store = MapStore(address(folder), lambda _: None)
    assert {summary.id: number_of(store.load(summary.id)) for summary in store.list()} == MIGRATED
    store.close()


def write_again(folder: Path) -> None:
    """Once the disk takes writes again, maps are changed as ever and nothing is left to be repaired."""
    store = MapStore(address(folder))
    if not store.list():
        store.save(variant(0))
    place_map = store.load(store.list()[0].id)
    renamed = rename_place(store, place_map.id, place_map.places[0].id, "named again")
    assert renamed.places[0].name == "named again" and not store.is_copy
    again = opened(folder)
    assert again.load(place_map.id).places[0].name == "named again"


# Saving


def save_first(folder: Path) -> None:
    MapStore(address(folder)).save(variant(0))


def save_on(folder: Path, child: Child) -> None:
    store = MapStore(address(folder))
    for number in range(1, 10_000):
        child.do(functools.partial(store.save, variant(number)))
        child.promise(number)


def look_at_saves(folder: Path, promises: list[object]) -> str:
    store = opened(folder)
    last = max([0, *(int(str(p)) for p in promises)])
    there = number_of(store.load(MAP.id))
    assert there in (last, last + 1), f"version {last} was promised, {there} is there"
    return f"{len(promises)} saved"


def look_at_first_saves(folder: Path, promises: list[object]) -> str:
    if not promises:
        opened(folder)
        return "0 saved"
    return look_at_saves(folder, promises)


# Renaming


def rename_on(folder: Path, child: Child) -> None:
    store = MapStore(address(folder))
    for number in range(1, 10_000):
        place = MAP.places[number % 2]
        rename = functools.partial(rename_place, store, MAP.id, place.id, f"name {number}")
        child.do(rename)
        child.promise(number)


def look_at_names(folder: Path, promises: list[object]) -> str:
    store = opened(folder)
    place_map = store.load(MAP.id)
    assert number_of(place_map) == 0
    last = max([0, *(int(str(p)) for p in promises)])
    allowed = (names_after(last), names_after(last + 1))
    names = tuple(place.name for place in place_map.places[:2])
    assert names in allowed, f"{names} are the names, {allowed[0]} were promised"
    assert len(place_map.places) == len(MAP.places)
    return f"{len(promises)} renamed"


def names_after(count: int) -> tuple[str, str]:
    names = [place.name for place in MAP.places[:2]]
    for number in range(1, count + 1):
        names[number % 2] = f"name {number}"
    return names[0], names[1]


# Merging places, undoing, deleting


def merge_on(folder: Path, child: Child) -> None:
    """Two places become one, and that is undone, over and over; now and then the map is deleted and brought back."""
    store = MapStore(address(folder))
    places = [place.id for place in MAP.places[:2]]
    for number in range(10_000):
        child.do(lambda: store.edit(MAP.id, lambda m: with_places_merged(m, places), "merged"))
        child.promise("merged")
        child.do(lambda: store.undo(MAP.id))
        child.promise("undone")
        if number % 3 == 0:
            child.do(lambda: store.delete(MAP.id))
            child.promise("deleted")
            child.do(lambda: store.undo(MAP.id))
            child.promise("undone")


def look_at_merges(folder: Path, promises: list[object]) -> str:
    store = opened(folder)
    if not store.list():
        assert [summary.id for summary in store.deleted()] == [MAP.id], "the map is gone"
        store.undo(MAP.id)
    place_map = store.load(MAP.id)
    assert number_of(place_map) == 0
    after = {"merged": (-1, 0), "undone": (0, -1), "deleted": (0,)}[str(promises[-1]) if promises else "undone"]
    assert len(place_map.places) - len(MAP.places) in after, f"{len(place_map.places)} places after {promises[-1:]}"
    return f"{len(promises)} changes"


# Two stations


def station_on(folder: Path, child: Child, number: int) -> None:
    """One of two stations with one store: renames its own place, over and over."""
    author = STATIONS[number]
    store = MapStore(address(folder, author))
    for count in range(10_000):
        name = f"{author} {count}"
        child.do(functools.partial(rename_place, store, MAP.id, MAP.places[number].id, name))
        child.promise(name)


def look_at_stations(folder: Path, promised: list[list[object]]) -> str:
    """Every write of both is a version, none is there twice, and the newest holds the last name of each."""
    store = opened(folder)
    history = store.history(MAP.id)
    assert [record.number for record in history] == list(range(len(history), 0, -1)), "a version is missing"
    newest = store.load(MAP.id)
    for number, (author, names) in enumerate(zip(STATIONS, promised, strict=True)):
        edits = [record for record in reversed(history) if record.kind == "edited" and record.author == author]
        written = [next(p.name for p in record.places if p.id == MAP.places[number].id) for record in edits]
        assert written in (names, [*names, f"{author} {len(names)}"]), f"{author} was promised {names}"
        assert not written or newest.places[number].name == written[-1], f"the last name of {author} is not there"
    return f"{' and '.join(str(len(names)) for names in promised)} renamed"


# Building maps of one drive, and of several


# Every cluster: to what they are gathered by room hangs on what a person had named before, unlike in `built_once`.
GRAIN: PlaceGrain = "fine"


def prepare_navigations(folder: Path) -> None:
    """Three drives, and a map of the first in which a person named a place."""
    for number, name in enumerate(DRIVES):
        save_navigation(made_up_navigation(number), folder / name)
    store = MapStore(address(folder))
    store.save(MAP)
    rename_place(store, MAP.id, MAP.places[0].id, NAMED)


def build_on(kinds: tuple[tuple[int, ...], ...]) -> Callable[[Path, Child], None]:
    """Maps of these drives in turn, over and over, by the code of the station's job."""

    def work(folder: Path, child: Child) -> None:
        library = LibraryJobs(lambda _: None)
        for number in range(10_000):
            kind = number % len(kinds)
            folders = [folder / DRIVES[k] for k in kinds[kind]]
            child.do(functools.partial(library.build_map, folders, address(folder), f"v{number}", None, places=GRAIN))
            child.promise(number)

    return work


def look_at_built(kinds: tuple[tuple[int, ...], ...]) -> Callable[[Path, list[object]], str]:
    def look(folder: Path, promises: list[object]) -> str:
        store = opened(folder)
        there = {summary.id for summary in store.list()}
        assert MAP.id in there, "the first map is gone"
        expected = {MAP.id: built_once((0,)), **{built_once(kind).id: built_once(kind) for kind in kinds}}
        assert there <= set(expected), f"nobody built {there - set(expected)}"
        count = len(promises)
        for kind, drives in enumerate(kinds):
            wanted = built_once(drives)
            made = [number for number in range(count) if number % len(kinds) == kind]
            assert not made or wanted.id in there, f"the map of drives {drives} was promised and is gone"
        for map_id in there:
            place_map, wanted = store.load(map_id), expected[map_id]
            assert place_map.navigation.id == wanted.navigation.id, "a mixture of two maps"
            np.testing.assert_array_equal(place_map.navigation.landmarks.p_world, wanted.navigation.landmarks.p_world)
            drives = next((kind for kind in kinds if built_once(kind).id == map_id), (0,))
            # Where the first drive has a map already its places stay, and a further drive makes them grow.
            whole = (wanted, built_once(drives, after=drives[:1])) if len(drives) > 1 else (wanted,)
            assert any(same_places(place_map, other) for other in whole), "a mixture of two groupings"
            if place_map.navigation.id.startswith(DRIVES[0]):
                assert NAMED in {place.name for place in place_map.places}, "the name that a person gave is gone"
            allowed = {n for n in range(count + 1) if built_once(kinds[n % len(kinds)]).id == map_id}
            newest = max((n for n in allowed if n < count), default=None)
            names = {f"v{n}" for n in allowed if newest is None or n >= newest}
            if newest is None:
                names.add(MAP.name)
            assert place_map.name in names, f"{place_map.name} is there, one of {names} was promised"
        return f"{count} built"

    return look


def same_places(a: PlaceMap, b: PlaceMap) -> bool:
    """Whether both are of the same landmarks, whatever they are called."""
    return len(a.places) == len(b.places) and all(
        np.array_equal(place.landmark_index, other.landmark_index)
        for place, other in zip(a.places, b.places, strict=True)
    )


@functools.cache
def built_once(drives: tuple[int, ...], after: tuple[int, ...] = ()) -> PlaceMap:
    """What the job makes of these drives, where there is a map of those in `after` or none."""
    with tempfile.TemporaryDirectory(prefix="crash-built-") as scratch:
        folder = Path(scratch)
        for number in drives:
            save_navigation(made_up_navigation(number), folder / DRIVES[number])
        for kind in filter(None, (after, drives)):
            built = LibraryJobs(lambda _: None).build_map(
                [folder / DRIVES[number] for number in kind], StoreAddress(folder / "maps"), "v0", None, places=GRAIN
            )
        return MapStore(folder / "maps").load(built.map_id)


# Migrating

MIGRATED = {"map-a": 1, "map-b": 2, "map-c": 3}


def prepare_old(folder: Path) -> None:
    """A store of the first migration, and beside it two folders of the format before it."""
    store = MapStore(address(folder))
    (folder / "maps").mkdir(exist_ok=True)
    with store.contents.database.writing("migrations") as connection:
        upgrade(connection, "0001")
    newer = MapStore(folder / "newer")
    newer.save(replace(variant(1), id="map-a"))
    rename_place(newer, "map-a", MAP.places[0].id, NAMED)
    for part in ("blobs", "records"):
        shutil.copytree(folder / "newer" / part, folder / "maps" / part)
    with newer.reading() as connection:
        rows = [dict(row._mapping) for row in connection.execute(VERSIONS.select())]
    for row in rows:
        row.pop("author")
    with store.contents.database.writing("rows") as connection:
        columns = ", ".join(rows[0])
        values = ", ".join(f":{key}" for key in rows[0])
        connection.execute(text(f"INSERT INTO map_version ({columns}) VALUES ({values})"), rows)
    for number, map_id in ((2, "map-b"), (3, "map-c")):
        save_map_folder(replace(variant(number), id=map_id), folder / "maps" / f"{map_id}.000001")


def migrate_on(folder: Path, child: Child) -> None:
    def open_store() -> None:
        store = MapStore(address(folder))
        store.open(writes=True)
        damaged = [summary.damaged for summary in store.list() if summary.damaged]
        if damaged:  # a map of the old format that could not be taken in: its folder is still there
            raise DataError(damaged[0])

    child.do(open_store)
    child.promise("open")
    while True:  # kills are counted in processor time
        pass


def look_at_migrated(folder: Path, promises: list[object]) -> str:
    store = opened(folder)
    found = {summary.id: number_of(store.load(summary.id)) for summary in store.list()}
    assert found == MIGRATED, f"{found} are there"
    assert store.load("map-a").places[0].name == NAMED
    assert len(store.history("map-b")) == 1
    return f"{len(promises)} migrated"


ALONE: tuple[tuple[int, ...], ...] = ((0,), (2,))
TOGETHER: tuple[tuple[int, ...], ...] = ((0, 1),)
SCENARIOS = {
    "save": Scenario(save_first, save_on, look_at_saves, 0.6, read_prepared, write_again),
    "first save": Scenario(lambda _: None, save_on, look_at_first_saves, 0.4, read_all, write_again),
    "build": Scenario(prepare_navigations, build_on(ALONE), look_at_built(ALONE), 0.6, read_prepared, write_again),
    "build of two": Scenario(
        prepare_navigations, build_on(TOGETHER), look_at_built(TOGETHER), 3.0, read_prepared, write_again
    ),
    "rename": Scenario(save_first, rename_on, look_at_names, 0.4, read_prepared, write_again),
    "merge": Scenario(save_first, merge_on, look_at_merges, 0.5, read_prepared, write_again),
    "migrate": Scenario(prepare_old, migrate_on, look_at_migrated, 0.25, read_migrating, write_again),
}
