"""What `bench_crash.py` and the tests kill: recording, saving, renaming, merging, migrating; and what must hold after.

A child is forked, works, and says on a pipe what it has been promised; it is killed at a random moment. Then the parent
looks: everything promised is there, nothing is mixed, everything opens.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from sqlalchemy import text

from shared.calibration import REFERENCE_ROBOT
from shared.messages import CameraFrame, Capabilities, Hello, ImuBatch, ImuSample
from station.datasets import open_dataset
from station.maps.checking import verify
from station.maps.database import VERSIONS, upgrade
from station.maps.folder import save_map_folder
from station.maps.map import PlaceMap
from station.maps.store import MapStore
from station.places.build import build_map
from station.recorder import Recorder
from station.recovery import recover_recording
from tests.synthetic_home import drive, furnished_room, navigate

MAX_LOST_S = 5.0
IMU_HZ, FPS = 225, 20
Promise = Callable[[object], None]


@dataclass(frozen=True)
class Scenario:
    """One kind of work. `work` runs in the child until it is killed; `look` raises AssertionError on any loss."""

    prepare: Callable[[Path], None]
    work: Callable[[Path, Promise], None]
    look: Callable[[Path, list[object]], str]
    longest_s: float  # the kill comes before


def small_map() -> PlaceMap:
    """A map of a made-up room with several places."""
    home = furnished_room(1)
    return build_map(navigate(home, drive(home, 1, frames=40, turns=1.0), seed=1))


MAP = small_map()


def run_once(name: str, folder: Path, seed: int) -> str:
    """One kill. Returns what was seen, in words. Raises AssertionError, naming the loss."""
    scenario = SCENARIOS[name]
    rng = random.Random(seed)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    scenario.prepare(folder)
    promises = kill_while(lambda promise: scenario.work(folder, promise), rng.uniform(0.0, scenario.longest_s))
    return scenario.look(folder, promises)


def kill_while(work: Callable[[Promise], None], after_s: float) -> list[object]:
    """Fork, work, kill -9; what the child promised until then. The clock starts when it says it works."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            with os.fdopen(writing, "w") as pipe:

                def promise(what: object) -> None:
                    pipe.write(json.dumps(what) + "\n")
                    pipe.flush()

                promise("begun")
                work(promise)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)  # never back into the parent's code
    os.close(writing)
    with os.fdopen(reading) as pipe:
        assert pipe.readline(), "the child did not begin"
        time.sleep(after_s)
        os.kill(pid, signal.SIGKILL)
        lines = pipe.read().split("\n")
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status), "the child ended by itself"  # else nothing would have been tried
    return [json.loads(line) for line in lines[:-1]]  # the last one is empty, or half a line


# Maps


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
    assert round(float(shift)) == number and int(picture[0, 0]) == number % 256, "a mixture of two maps"
    return number


def opened(folder: Path) -> tuple[MapStore, list[str]]:
    told: list[str] = []
    store = MapStore(folder / "maps", told.append)
    damages = verify(store)
    assert not damages, f"damaged: {damages[0].sentence}"
    assert not told, f"not sound: {told[0]}"
    return store, told


def save_first(folder: Path) -> None:
    MapStore(folder / "maps").save(variant(0))


def save_on(folder: Path, promise: Promise) -> None:
    store = MapStore(folder / "maps")
    for number in range(1, 10_000):
        store.save(variant(number))
        promise(number)


def look_at_saves(folder: Path, promises: list[object]) -> str:
    store, _ = opened(folder)
    last = max([0, *(int(str(p)) for p in promises)])
    there = number_of(store.load(MAP.id))
    assert there in (last, last + 1), f"version {last} was promised, {there} is there"
    return f"{len(promises)} saved"


def rename_on(folder: Path, promise: Promise) -> None:
    store = MapStore(folder / "maps")
    for number in range(1, 10_000):
        place = MAP.places[number % 2]
        store.rename_place(MAP.id, place.id, f"name {number}")
        promise(number)


def look_at_names(folder: Path, promises: list[object]) -> str:
    store, _ = opened(folder)
    place_map = store.load(MAP.id)
    assert number_of(place_map) == 0
    last = max([0, *(int(str(p)) for p in promises)])
    allowed = [{0: names_after(last), 1: names_after(last + 1)}[k] for k in (0, 1)]
    names = tuple(place.name for place in place_map.places[:2])
    assert names in allowed, f"{names} are the names, {allowed[0]} were promised"
    assert len(place_map.places) == len(MAP.places)
    return f"{len(promises)} renamed"


def names_after(count: int) -> tuple[str, str]:
    names = [place.name for place in MAP.places[:2]]
    for number in range(1, count + 1):
        names[number % 2] = f"name {number}"
    return names[0], names[1]


def merge_on(folder: Path, promise: Promise) -> None:
    """Two places become one, and that is undone, over and over; now and then the map is deleted and brought back."""
    store = MapStore(folder / "maps")
    for number in range(10_000):
        store.edit(MAP.id, merged, "merged")
        promise("merged")
        store.undo(MAP.id)
        promise("undone")
        if number % 3 == 0:
            store.delete(MAP.id)
            promise("deleted")
            store.undo(MAP.id)
            promise("undone")


def merged(place_map: PlaceMap) -> PlaceMap:
    a, b, *rest = place_map.places
    members = np.union1d(a.landmark_index, b.landmark_index)
    gone = [edge for edge in place_map.edges if b.id not in (edge.a, edge.b)]
    return replace(place_map, places=(replace(a, landmark_index=members), *rest), edges=tuple(gone))


def look_at_merges(folder: Path, promises: list[object]) -> str:
    store, _ = opened(folder)
    if not store.list():
        assert [summary.id for summary in store.deleted()] == [MAP.id], "the map is gone"
        store.undo(MAP.id)
    place_map = store.load(MAP.id)
    assert number_of(place_map) == 0
    after = {"merged": (-1, 0), "undone": (0, -1), "deleted": (0,)}[str(promises[-1]) if promises else "undone"]
    assert len(place_map.places) - len(MAP.places) in after, f"{len(place_map.places)} places after {promises[-1:]}"
    return f"{len(promises)} changes"


def prepare_old(folder: Path) -> None:
    """A store of the first migration, and beside it two folders of the format before it."""
    store = MapStore(folder / "maps")
    with store.database.writing("migrations") as connection:
        (folder / "maps").mkdir(exist_ok=True)
        upgrade(connection, "0001")
    newer = MapStore(folder / "newer")
    newer.save(replace(variant(1), id="map-a"))
    newer.rename_place("map-a", MAP.places[0].id, "Sofa")
    for part in ("blobs", "records"):
        shutil.copytree(folder / "newer" / part, folder / "maps" / part)
    with newer.database.reading() as connection:
        rows = [dict(row._mapping) for row in connection.execute(VERSIONS.select())]
    for row in rows:
        row.pop("author")
    with store.database.writing("rows") as connection:
        columns = ", ".join(rows[0])
        values = ", ".join(f":{key}" for key in rows[0])
        connection.execute(text(f"INSERT INTO map_version ({columns}) VALUES ({values})"), rows)
    for number, map_id in ((2, "map-b"), (3, "map-c")):
        save_map_folder(replace(variant(number), id=map_id), folder / "maps" / f"{map_id}.000001")


def migrate_on(folder: Path, promise: Promise) -> None:
    store = MapStore(folder / "maps")
    store.open(writes=True)
    promise("open")
    while True:
        time.sleep(1)


def look_at_migrated(folder: Path, promises: list[object]) -> str:
    store, _ = opened(folder)
    found = {summary.id: number_of(store.load(summary.id)) for summary in store.list()}
    assert found == {"map-a": 1, "map-b": 2, "map-c": 3}, f"{found} are there"
    assert store.load("map-a").places[0].name == "Sofa"
    assert len(store.history("map-b")) == 1
    return "done before" if promises else "in between"


# Recordings

HELLO = Hello(
    protocol=1,
    robot_id="r",
    name="R",
    session_id="s",
    capabilities=Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False),
    calibration=REFERENCE_ROBOT,
)
PICTURE = np.random.default_rng(0).bytes(40_000)


def record_on(folder: Path, promise: Promise) -> None:
    """A robot of 20 frames and 225 samples a second, in real time; promised is the time of what was handed over."""
    recorder = Recorder(folder / "recording.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    begin_s = time.monotonic()
    samples = 0
    for number in range(100_000):
        t_ns = round(number * 1e9 / FPS)
        until = round((number + 1) * IMU_HZ / FPS)
        batch = tuple(
            ImuSample(round(n * 1e9 / IMU_HZ), (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)) for n in range(samples, until)
        )
        recorder.on_imu(ImuBatch(first_sequence=samples, samples=batch))
        samples = until
        jpeg = PICTURE + number.to_bytes(4, "big")
        frame = CameraFrame(seq=number, t_robot_ns=t_ns, exposure_ns=0, width=640, height=480, skipped=0, jpeg=jpeg)
        recorder.on_frame(frame, time.monotonic_ns())
        promise(t_ns)
        time.sleep(max(0.0, begin_s + (number + 1) / FPS - time.monotonic()))


def look_at_recording(folder: Path, promises: list[object]) -> str:
    path = folder / "recording.mcap"
    last_ns = int(str(promises[-1])) if promises else 0
    if not path.is_file() or (path.stat().st_size < 10_000 and last_ns < MAX_LOST_S * 1e9):
        return "killed before the first second was written"
    recover_recording(path)
    data = open_dataset(path)
    frames = [frame.encoded for frame in data.frames()]
    assert frames == [PICTURE + number.to_bytes(4, "big") for number in range(len(frames))], "a frame differs"
    imu = data.require_imu().t_robot_ns.tolist()
    assert imu == [round(n * 1e9 / IMU_HZ) for n in range(len(imu))], "a sample is missing in the middle"
    lost_s = (last_ns - int(data.frame_times_ns[-1])) * 1e-9
    assert lost_s <= MAX_LOST_S, f"{lost_s:.1f} s of the recording are lost"
    return f"{lost_s:.2f} s lost"


def nothing(folder: Path) -> None:
    """Nothing to prepare."""


SCENARIOS = {
    "record": Scenario(nothing, record_on, look_at_recording, 4.0),
    "save": Scenario(save_first, save_on, look_at_saves, 0.6),
    "first save": Scenario(nothing, save_on, lambda folder, p: look_at_saves(folder, p) if p else "nothing yet", 0.4),
    "rename": Scenario(save_first, rename_on, look_at_names, 0.4),
    "merge": Scenario(save_first, merge_on, look_at_merges, 0.5),
    "migrate": Scenario(prepare_old, migrate_on, look_at_migrated, 0.6),
}
