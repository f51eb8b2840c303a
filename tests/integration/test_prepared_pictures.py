"""Keyframes are described while SLAM has nothing else to do; the map's job indexes them, localisation only reads."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from shared.calibration import Calibration
from station.files.navigation_folder import PICTURES
from station.maps.store import MapStore
from station.model.frames import ImageFrame
from station.model.map_store import StoreAddress
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.localisation import index_file
from station.places.localisation.described_pictures import DescribedPictures
from station.places.localisation.index_path import FOLDER, SUFFIX
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.vision.features import Features
from station.workers.library_jobs import LibraryJobs
from station.workers.place_interface import PlaceEvent
from station.workers.places import PlaceFinder
from station.workers.slam import NavigationSlam
from tests.support.made_up_workers import StraightSlam
from tests.support.walls import CALIBRATION, camera_at, frame, make_map, picture

VIEWS = [picture(1, camera_at(x, 0.1, -0.2, 0.1)) for x in (-0.7, 0.3, 0.9)]
BACKEND = "tests.integration.test_prepared_pictures:WallSlam"


@cache
def wall() -> PlaceMap:
    return make_map("wall", 1)


class WallSlam(StraightSlam):
    """Makes a keyframe of each frame, and leaves every other one out again when it has more than five."""

    def keyframe_pictures(self) -> list[bytes]:
        pictures = [item.encoded for item in self.frames]
        return pictures if len(pictures) <= 5 else pictures[::2]

    def finish(self) -> Navigation:
        return wall().navigation


class DescribingSlam(WallSlam):
    """Has described each of its keyframes itself."""

    def keyframe_features(self, number: int) -> Features:
        return Features(np.array([[float(number), 1.0]]), np.full((1, 128), number, dtype=np.uint8))


def follow(folder: Path, frames: int, backend: str = BACKEND) -> None:
    """Drive along the wall, with time to spare after each frame; the last one is held until the drive ends."""
    slam = NavigationSlam(lambda update: None)
    slam.begin(backend, Calibration(camera=CALIBRATION.camera, imu=None), 0)
    for number, encoded in enumerate(wall().navigation.keyframes.encoded[:frames]):
        slam.add_frame(ImageFrame(number, number * 1_000_000_000, 0, encoded))
        while slam.catch_up():
            pass
    slam.finish("drive", folder)


def test_the_file_of_a_drive_has_the_keyframes_there_was_time_for(tmp_path: Path) -> None:
    follow(tmp_path / "navigation", 4)
    pictures = DescribedPictures()
    assert pictures.add(tmp_path / "navigation" / PICTURES)
    assert [pictures.knows(encoded) for encoded in wall().navigation.keyframes.encoded] == [True] * 3 + [False] * 4


def test_a_thinned_drive_is_described_to_its_end(tmp_path: Path) -> None:
    follow(tmp_path / "navigation", 7)
    pictures = DescribedPictures()
    assert pictures.add(tmp_path / "navigation" / PICTURES)
    assert {0, 2, 4} <= {k for k, e in enumerate(wall().navigation.keyframes.encoded) if pictures.knows(e)}


def test_what_the_backend_has_described_is_not_described_again(tmp_path: Path) -> None:
    follow(tmp_path / "navigation", 5, "tests.integration.test_prepared_pictures:DescribingSlam")
    pictures = DescribedPictures()
    assert pictures.add(tmp_path / "navigation" / PICTURES)
    assert len(pictures) == 5  # the last one, too, which came when the drive ended
    for number, encoded in enumerate(wall().navigation.keyframes.encoded[:5]):
        assert pictures.describe(encoded).uv_px.tolist() == [[float(number), 1.0]]


def test_what_was_described_ahead_gives_the_same_index_bit_for_bit() -> None:
    pictures = DescribedPictures()
    for encoded in wall().navigation.keyframes.encoded[:4]:
        pictures.describe(encoded)
    direct, prepared = make_index(wall()).arrays(), make_index(wall(), pictures=pictures).arrays()
    assert direct.keys() == prepared.keys()
    assert all(np.array_equal(direct[name], prepared[name]) for name in direct)


@pytest.mark.parametrize("is_prepared", [False, True])
def test_localisation_describes_nothing_after_such_a_drive_and_answers_the_same(
    tmp_path: Path, is_prepared: bool
) -> None:
    folder, address = tmp_path / "drive" / "navigation", StoreAddress(tmp_path / "maps")
    follow(folder, 5)
    job = LibraryJobs(lambda told: None)
    built = job.build_map([folder], address, "wall", None)
    beside = LibraryJobs(lambda told: None)
    if is_prepared:
        beside.prepare_index([folder])
    beside.index_map([folder], address, built.map_id)
    assert (address.root / FOLDER / f"{built.map_id}{SUFFIX}").exists()
    told: list[PlaceEvent] = []
    finder = PlaceFinder(told.append)
    finder.load(address, (built.map_id,))
    assert told == []
    finder.calibrate(CALIBRATION)
    alone = Localizer([MapStore(address).load(built.map_id)])
    for number, view in enumerate(VIEWS):
        report = finder.answer(replace(frame(view), t_robot_ns=number * 500_000_000))
        direct = alone.attempt(frame(view), CALIBRATION).localization
        assert report.T_map_cam is not None and direct is not None
        assert report.T_map_cam.tobytes() == direct.T_map_cam.tobytes()


def test_an_index_is_prepared_while_the_map_is_built_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, address = tmp_path / "drive" / "navigation", StoreAddress(tmp_path / "maps")
    follow(folder, 5)
    built = LibraryJobs(lambda told: None).build_map([folder], address, "wall", None)
    path = address.root / FOLDER / f"{built.map_id}{SUFFIX}"
    LibraryJobs(lambda told: None).index_map([folder], address, built.map_id)
    afterwards = path.read_bytes()
    path.unlink()
    beside = LibraryJobs(lambda told: None)
    beside.prepare_index([folder])
    monkeypatch.setattr(index_file, "make_index", None)  # nothing is left to do
    beside.index_map([folder], address, built.map_id)
    assert path.read_bytes() == afterwards


@pytest.mark.parametrize(("frames", "is_damaged"), [(5, True), (4, False)])  # four: of seven pictures three are known
def test_where_little_was_described_ahead_the_map_does_not_wait_for_it(
    tmp_path: Path, frames: int, is_damaged: bool
) -> None:
    folder, address = tmp_path / "drive" / "navigation", StoreAddress(tmp_path / "maps")
    follow(folder, frames)
    if is_damaged:
        (folder / PICTURES).write_bytes(b"damaged")
    job = LibraryJobs(lambda told: None)
    built = job.build_map([folder], address, "wall", None)
    beside = LibraryJobs(lambda told: None)
    beside.prepare_index([folder])
    beside.index_map([folder], address, built.map_id)
    assert not (address.root / FOLDER / f"{built.map_id}{SUFFIX}").exists()
