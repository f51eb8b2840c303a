"""What a map reaches: a room that was driven through, a neighbour seen through its door, a corridor driven one way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import IntArray, se3, yaw_rotation
from station.model.navigation import Keyframes
from station.model.place_map import PlaceMap
from station.places.tracking.config import BeliefConfig
from station.places.tracking.coverage import MOST_ASKED, Coverage
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.map_view import MapView
from tests.support.places import R_BODY_CAM, make_map, seen
from tests.support.rooms import CAMERA, mapped, room_with_a_door, walls


def test_a_neighbour_seen_through_its_door_is_not_reached_though_it_is_near() -> None:
    view = MapView.of(room_with_a_door())
    beyond = np.array([[4.8, 2.1, 0.0], [4.6, 1.5, 0.0], [4.8, 2.6, 0.0]])
    assert (view.coverage.distance(beyond[:2]) < 0.95).all()
    assert (view.coverage.views(beyond) < 0.72).all()
    assert (view.coverage.covers(beyond, BeliefConfig()) < 0.2).all()


def test_off_the_path_but_in_the_room_it_is_reached() -> None:
    view = MapView.of(room_with_a_door())
    within = np.array([[2.5, 2.0, 0.0], [1.3, 2.0, 0.0], [2.0, 3.8, 0.0], [3.3, 3.0, 0.0]])
    assert view.coverage.distance(within).max() > 0.65
    assert (view.coverage.covers(within, BeliefConfig()) > 0.8).all()
    assert (view.coverage.covers(np.array([[2.0, 11.0, 0.0]]), BeliefConfig()) < 1e-3).all()


def test_on_the_path_the_map_reaches_whatever_it_sees_there() -> None:
    view = MapView.of(room_with_a_door())
    assert view.coverage.covers(np.array([[3.9, 2.0, 0.0], [4.1, 2.0, 0.0]]), BeliefConfig()).min() > 0.95


def test_a_corridor_driven_one_way_is_reached_beside_the_path() -> None:
    x = np.linspace(0.5, 3.5, 20)
    view = MapView.of(mapped(np.column_stack([x, np.full(20, 2.0)]), np.zeros(20), walls()))
    assert (view.coverage.covers(np.array([[1.0, 2.6, 0.0], [2.0, 1.3, 0.0]]), BeliefConfig()) > 0.8).all()


@pytest.mark.parametrize("place_map", [room_with_a_door(upright=False), make_map()], ids=["no up", "few landmarks"])
def test_where_views_cannot_be_told_distance_decides(place_map: PlaceMap) -> None:
    coverage = Coverage(place_map, 1.0)
    assert (coverage.views(np.array([[4.8, 2.1, 0.0], [50.0, 0.0, 0.0]])) == 1.0).all()


def test_in_a_room_driven_through_all_day_as_much_is_in_view_and_not_every_keyframe_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place_map = room_with_a_door()
    T = se3(yaw_rotation(np.pi), np.array([3.2, 2.0, 0.0])) @ se3(R_BODY_CAM, np.zeros(3))
    once = Coverage(place_map, 1.0).in_view(T, CAMERA)
    often = Coverage(repeated(place_map, 20), 1.0)
    asked = []
    seen_by = often._seen.by

    def by(keyframes: IntArray) -> tuple[IntArray, IntArray]:
        asked.append(len(keyframes))
        return seen_by(keyframes)

    monkeypatch.setattr(often._seen, "by", by)
    assert often.in_view(T, CAMERA) == pytest.approx(once, rel=0.1) and once > 0.5
    assert asked and max(asked) <= MOST_ASKED


def repeated(place_map: PlaceMap, times: int) -> PlaceMap:
    """The same, driven this many times: as many keyframes saw each landmark."""
    navigation = place_map.navigation
    keyframes, landmarks = navigation.keyframes, navigation.landmarks
    count = len(keyframes)
    again = np.tile(np.arange(count), times)
    drive = np.repeat(np.arange(times), len(landmarks.observed_landmark))
    return replace(
        place_map,
        navigation=replace(
            navigation,
            keyframes=Keyframes(
                np.arange(len(again)), again, keyframes.T_world_cam[again], (b"",) * len(again), np.zeros_like(again)
            ),
            landmarks=replace(
                landmarks,
                observed_landmark=np.tile(landmarks.observed_landmark, times),
                observed_keyframe=np.tile(landmarks.observed_keyframe, times) + count * drive,
                observed_uv_px=np.tile(landmarks.observed_uv_px, (times, 1)),
            ),
        ),
    )


def test_landmarks_that_are_nowhere_are_not_in_view() -> None:
    place_map = room_with_a_door()
    landmarks = place_map.navigation.landmarks
    p_world = landmarks.p_world.copy()
    p_world[::2] = np.nan
    half = replace(place_map, navigation=replace(place_map.navigation, landmarks=replace(landmarks, p_world=p_world)))
    T = se3(yaw_rotation(np.pi), np.array([3.2, 2.0, 0.0])) @ se3(R_BODY_CAM, np.zeros(3))
    every = Coverage(place_map, 1.0).in_view(T, CAMERA)
    assert Coverage(half, 1.0).in_view(T, CAMERA) == pytest.approx(every, rel=0.25)  # against what is somewhere


def test_a_robot_behind_the_door_is_told_that_it_is_not_in_the_map() -> None:
    estimator = CurrentPlaceEstimator([room_with_a_door()])
    many = tuple(range(400))
    for k in range(6):  # looks back through the door and knows exactly where it is
        estimator.on_candidates([seen(k, se3(yaw_rotation(np.pi), np.array([4.9, 2.0, 0.0])), landmarks=many)])
    answer = estimator.answer(6 * 10**9)
    assert answer.state == "unknown" and answer.position_map is not None
    assert "mapping drive" in answer.reason
    for k in range(6, 14):  # drives back in
        estimator.on_candidates([seen(k, se3(yaw_rotation(np.pi), np.array([3.0, 2.0, 0.0])), landmarks=many)])
    assert estimator.answer(14 * 10**9).state == "known"
