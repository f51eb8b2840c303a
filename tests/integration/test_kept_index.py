"""The localisation index of a map is made once, shared by all workers, and made again when it is not sound."""

from __future__ import annotations

import fcntl
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.config import MAX_ACTIVE_MAPS
from station.model.place_map import PlaceMap
from station.places.localisation import index_file
from station.places.localisation.index_file import KEPT, LOCK, index_of
from station.places.localisation.index_path import FOLDER, SUFFIX, forget_index
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.localisation.map_index import fingerprint
from tests.support.link import until
from tests.support.walls import CALIBRATION, camera_at, frame, make_map, picture

pytestmark = pytest.mark.computing

VIEWS = [picture(1, camera_at(x, 0.1, -0.2, 0.1)) for x in (-0.7, 0.3, 0.9)]


@pytest.fixture(scope="module")
def wall() -> PlaceMap:
    return make_map("wall", 1)


def nothing() -> None:
    """Nobody is told."""


def look(root: Path, place_map: PlaceMap) -> tuple[Localizer, int]:
    """A localiser as a worker makes it, and how many pictures it had to describe for that."""
    described: list[int] = []
    index = index_of(root, place_map, lambda: described.append(1), nothing)
    return Localizer([place_map], index=[index]), len(described)


def answers(localizer: Localizer) -> list[bytes]:
    """Every bit of what it says."""
    attempts = [localizer.attempt(frame(view), CALIBRATION) for view in VIEWS]
    assert all(attempt.localization is not None for attempt in attempts)
    return [a.localization.T_map_cam.tobytes() + a.reason.encode() for a in attempts if a.localization]


def path_of(root: Path, place_map: PlaceMap) -> Path:
    return root / FOLDER / f"{place_map.id}{SUFFIX}"


def test_the_second_worker_describes_nothing_and_answers_the_same_bits(tmp_path: Path, wall: PlaceMap) -> None:
    alone = answers(Localizer([wall]))
    first, described = look(tmp_path, wall)
    assert described == len(wall.navigation.keyframes)
    second, described = look(tmp_path, wall)
    assert described == 0
    assert answers(first) == answers(second) == alone
    tried, again = first.tried[0], second.tried[0]
    assert tried and [len(one.candidates) for one in tried] == [len(one.candidates) for one in again]
    for one, other in zip(tried, again, strict=True):
        assert one.candidates[0].T_map_cam.tobytes() == other.candidates[0].T_map_cam.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        second.appearances[0].arrays()["word_idf"][:] = 0.0


@pytest.mark.parametrize("damage", ["bit", "cut", "empty", "text"])
def test_a_damaged_index_is_made_again(tmp_path: Path, wall: PlaceMap, damage: str) -> None:
    expected, _ = look(tmp_path, wall)
    path = path_of(tmp_path, wall)
    data = bytearray(path.read_bytes())
    if damage == "bit":
        data[len(data) // 2] ^= 1
    new = {"bit": bytes(data), "cut": bytes(data[: len(data) // 2]), "empty": b"", "text": b"SentinelIndex\n{}\n"}
    path.unlink()  # the localiser above still looks at it
    path.write_bytes(new[damage])
    again, described = look(tmp_path, wall)
    assert described == len(wall.navigation.keyframes)
    assert answers(again) == answers(expected)
    assert look(tmp_path, wall)[1] == 0


def test_another_drive_under_the_same_id_is_not_taken_for_it(tmp_path: Path, wall: PlaceMap) -> None:
    look(tmp_path, wall)
    keyframes = replace(wall.navigation.keyframes, encoded=(VIEWS[0], *wall.navigation.keyframes.encoded[1:]))
    other = replace(wall, navigation=replace(wall.navigation, keyframes=keyframes))
    assert fingerprint(other) != fingerprint(wall)
    assert look(tmp_path, other)[1] == len(wall.navigation.keyframes)
    renamed = replace(wall, name="The same with another name")
    assert fingerprint(renamed) == fingerprint(wall)


def test_indexes_of_few_maps_are_kept_and_none_of_a_purged_one(
    tmp_path: Path, wall: PlaceMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert KEPT == MAX_ACTIVE_MAPS  # else a set of them would be described anew at each start
    monkeypatch.setattr(index_file, "KEPT", 2)
    maps = [replace(wall, id=f"wall-{number}") for number in range(4)]
    for number, place_map in enumerate(maps):
        look(tmp_path, place_map)
        os.utime(path_of(tmp_path, place_map), (number, number))
    assert len(list((tmp_path / FOLDER).glob(f"*{SUFFIX}"))) == 2
    assert path_of(tmp_path, maps[-1]).exists() and not path_of(tmp_path, maps[0]).exists()
    forget_index(tmp_path, maps[-1].id)
    assert not path_of(tmp_path, maps[-1]).exists()


async def test_who_comes_while_it_is_made_waits_says_so_and_takes_what_was_made(tmp_path: Path, wall: PlaceMap) -> None:
    (tmp_path / FOLDER).mkdir()
    told: list[str] = []
    found: list[object] = []
    waiting = threading.Thread(
        target=lambda: found.append(index_of(tmp_path, wall, lambda: told.append("made"), lambda: told.append("waits")))
    )
    with (tmp_path / FOLDER / LOCK).open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        waiting.start()
        await until(lambda: told)
        assert told == ["waits"]
        store = tmp_path / "other"
        index_of(store, wall, nothing, nothing)
        path_of(store, wall).rename(path_of(tmp_path, wall))
    waiting.join(60)
    assert found and told == ["waits"]


@pytest.mark.parametrize("hinder", [lambda root: (root / FOLDER).write_text(""), lambda root: path_in_the_way(root)])
def test_where_nothing_can_be_kept_each_makes_its_own(
    tmp_path: Path, wall: PlaceMap, hinder: Callable[[Path], object]
) -> None:
    hinder(tmp_path)
    localizer, described = look(tmp_path, wall)
    assert described == len(wall.navigation.keyframes)
    assert answers(localizer) == answers(Localizer([wall]))


def path_in_the_way(root: Path) -> None:
    (root / FOLDER / f"wall{SUFFIX}.new").mkdir(parents=True)


def test_a_map_without_pictures_has_an_index_too(tmp_path: Path, wall: PlaceMap) -> None:
    keyframes = replace(wall.navigation.keyframes, encoded=(b"",) * len(wall.navigation.keyframes))
    empty = replace(wall, navigation=replace(wall.navigation, keyframes=keyframes))
    look(tmp_path, empty)
    localizer, described = look(tmp_path, empty)
    assert described == 0
    assert localizer.localize(frame(VIEWS[0]), CALIBRATION) is None
    assert np.array_equal(make_index(empty).arrays()["first"], np.zeros(len(keyframes) + 1))
