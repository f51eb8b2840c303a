"""Images of a painted wall are found in a map of it, and others are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from shared.calibration import Calibration
from shared.geometry import FloatArray, se3, so3_exp
from station.maps.store import MapStore
from station.model.frames import ImageFrame
from station.model.map_store import StoreAddress
from station.model.navigation import Keyframes, Navigation
from station.model.place_answer import HijackNotice, MapReading, PlaceReport
from station.model.place_map import PlaceMap
from station.places.localisation.localizer import Attempt, Localizer
from station.places.localisation.make_index import make_index
from station.places.making.build import build_map
from station.vision.appearance import AppearanceIndex
from station.vision.features import FeatureExtractor
from station.workers.places import PlaceFinder
from tests.support.motion import imu, lift, seconds
from tests.support.walls import CALIBRATION, CAMERA, camera_at, frame, make_map, picture

pytestmark = pytest.mark.computing


@pytest.fixture(scope="module")
def localizer() -> Localizer:
    return Localizer([make_map("first", 1), make_map("second", 2)])


def test_evidence_carries_the_pictures_own_time_whatever_the_cameras_shift(tmp_path: Path) -> None:
    """The station keeps the picture under this time: any other one, and nobody could look at it."""
    place_map = build_map(make_map("wall", 1).navigation, name="wall")
    MapStore(tmp_path).save(place_map)
    told: list[object] = []
    finder = PlaceFinder(told.append)
    finder.load(StoreAddress(tmp_path), (place_map.id,))
    progress = [event.fraction for event in told if isinstance(event, MapReading)]
    assert progress == sorted(progress) and 0.0 <= progress[0] < 1.0  # who waits is told how far it is
    camera = msgspec.structs.replace(CAMERA, time_shift_s=0.03)
    finder.calibrate(Calibration(camera=camera, imu=None))
    for n in range(3):
        view = ImageFrame(n, n * 500_000_000, 0, picture(1, camera_at(0.3, 0.1, -0.2, 0.1)))
        report = finder.answer(view)
        assert report.t_evidence_ns == view.t_robot_ns, report.attempt
        assert report.answer.evidence_t_robot_ns == view.t_robot_ns
    broken = finder.answer(ImageFrame(3, 1_500_000_000, 0, b"no picture"))
    assert "not a readable JPEG" in broken.attempt and broken.t_evidence_ns is None
    assert broken.answer.t_robot_ns == 1_500_000_000
    after = finder.answer(ImageFrame(4, 2_000_000_000, 0, picture(1, camera_at(0.3))))
    assert after.t_evidence_ns == 2_000_000_000


def test_a_lift_ends_what_was_known_at_once_and_no_picture_from_before_brings_it_back(tmp_path: Path) -> None:
    place_map = build_map(make_map("wall", 1).navigation, name="wall")
    told: list[object] = []
    finder = PlaceFinder(told.append)
    finder.use([place_map])
    finder.calibrate(msgspec.structs.replace(CALIBRATION, rig="wheels"))

    def feel(rotation: FloatArray, acceleration: FloatArray, start_s: float) -> None:
        for batch in imu(rotation, acceleration, start_s):
            finder.add_imu(batch.t_robot_ns.tolist(), batch.gyro_imu.tolist(), batch.accel_imu.tolist())

    def look(t_s: float) -> PlaceReport:
        views = [camera_at(0.3), camera_at(0.35, 0.1, -0.2, 0.1)]
        return finder.answer(ImageFrame(0, round(t_s * 1e9), 0, picture(1, views[round(10 * t_s) % 2])))

    feel(seconds(3), seconds(3), 0.0)
    assert [look(t_s) for t_s in (2.5, 2.6, 2.7, 2.8, 2.9)][-1].answer.state == "known"
    feel(seconds(0.8), lift(), 3.0)
    [notice] = [one for one in told if isinstance(one, HijackNotice)]
    assert notice.event.cue == "imu" and notice.report.answer.state == "lost" and notice.report.num_hijacks == 1
    feel(seconds(2), seconds(2), 3.8)  # put down, and still
    late = look(2.95)  # a slow camera, or a machine that has no time
    assert late.answer.state == "lost" and late.T_map_cam is None and late.num_hijacks == 1
    found = look(6.0).T_map_cam
    assert found is not None and np.linalg.norm(found[:3, 3] - camera_at(0.3)[:3, 3]) < 0.03


@pytest.mark.parametrize(("seed", "map_id"), [(1, "first"), (2, "second")])
def test_a_view_between_keyframes_is_found_in_the_right_map(localizer: Localizer, seed: int, map_id: str) -> None:
    T_true = camera_at(0.3, 0.1, -0.2, 0.1)
    found = localizer.localize(frame(picture(seed, T_true)), CALIBRATION)
    assert found is not None
    assert found.map_id == map_id and found.t_robot_ns == 7
    assert np.linalg.norm(found.T_map_cam[:3, 3] - T_true[:3, 3]) < 0.03
    assert np.allclose(found.T_map_cam[:3, :3], T_true[:3, :3], atol=0.01)
    assert found.num_inliers > 50 and 0 < found.sigma_position < 0.05
    assert found.keyframe_index in (3, 4)


def test_another_wall_is_not_found(localizer: Localizer) -> None:
    attempt = localizer.attempt(frame(picture(3, camera_at(0.0))), CALIBRATION)
    assert attempt.localization is None and attempt.reason


def test_a_map_by_wheels_and_one_by_hand_are_both_asked_as_their_pictures_were_described() -> None:
    T_body_cam = se3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
    camera = msgspec.structs.replace(CAMERA, T_body_cam=tuple(T_body_cam.ravel()))
    on_wheels = Calibration(camera=camera, imu=None, rig="wheels")
    first, second = make_map("wheels", 1), make_map("hand", 2)
    first = replace(first, navigation=replace(first.navigation, calibration=on_wheels))
    both = Localizer([first, second])
    upside_down = so3_exp(np.array([0.0, 0.0, np.pi]))
    for calibration in (on_wheels, CALIBRATION):
        for seed, expected in ((1, first.id), (2, second.id)):
            found = both.localize(frame(picture(seed, camera_at(0.3))), calibration)
            assert found is not None and found.map_id == expected
            assert np.linalg.norm(found.T_map_cam[:3, 3] - [0.3, 0.0, 0.0]) < 0.05
            turned = both.localize(frame(picture(seed, camera_at(0.3) @ se3(upside_down, np.zeros(3)))), calibration)
            # On wheels nothing is seen upside down.
            assert (turned is None) == (expected == first.id)


def test_own_pictures_are_looked_for_without_the_keyframes_near_them(monkeypatch: pytest.MonkeyPatch) -> None:
    place_map = make_map("wall", 1)
    poses = place_map.navigation.keyframes.T_world_cam
    attempt, left_out = Localizer.attempt_features, []

    def noted(*args: Any, **more: Any) -> Attempt:
        left_out.append(more["left_out"])
        return attempt(*args, **more)

    monkeypatch.setattr(Localizer, "attempt_features", noted)
    tried = make_index(place_map).tried
    for k, near in enumerate(left_out):
        away_m = np.linalg.norm(poses[:, :3, 3] - poses[k, :3, 3], axis=1)
        assert near == set(np.flatnonzero(away_m < 1.75).tolist())  # 35 degrees at three metres
    assert tried
    for one in tried:
        assert np.linalg.norm(one.candidates[0].T_map_cam[:3, 3] - one.T_map_cam[:3, 3]) < 0.05


def test_a_dark_image_is_refused_by_name(localizer: Localizer) -> None:
    black = cv2.imencode(".png", np.zeros((480, 640), np.uint8))[1].tobytes()
    attempt = localizer.attempt(frame(black), CALIBRATION)
    assert attempt.localization is None and "features" in attempt.reason


def test_a_map_without_readable_images_answers_no() -> None:
    good = make_map("broken", 1)
    keyframes = good.navigation.keyframes
    broken = Keyframes(
        keyframes.frame_index,
        keyframes.t_robot_ns,
        keyframes.T_world_cam,
        (b"",) * len(keyframes),
        keyframes.segment,
    )
    navigation = Navigation(
        good.navigation.id,
        CALIBRATION,
        good.navigation.trajectory,
        broken,
        good.navigation.landmarks,
        good.navigation.report,
    )
    empty = Localizer([PlaceMap("broken", "broken", navigation, (), (), {})])
    assert empty.localize(frame(picture(1, camera_at(0.0))), CALIBRATION) is None


def test_the_index_proposes_the_image_itself_first_and_grows_its_words_with_the_map() -> None:
    extractor = FeatureExtractor(300)
    views = [(seed, x) for seed in (1, 2, 3, 4) for x in (-1.0, 1.0)]
    images = [extractor.extract(frame(picture(seed, camera_at(x))).grey()).descriptors for seed, x in views]
    index = AppearanceIndex(images)
    for k, descriptors in enumerate(images):
        proposed, similarity = index.query(descriptors, 3)
        assert proposed[0] == k
        assert (np.diff(similarity) <= 0).all()
    assert AppearanceIndex(images[:2]).num_words < index.num_words
    nothing, _ = AppearanceIndex([]).query(images[0], 5)
    assert len(nothing) == 0
