"""What a map reaches: a room that was driven through, a neighbour seen through its door, a corridor driven one way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.calibration import Calibration, CameraCalibration
from shared.geometry import FloatArray, IntArray, se3, yaw_rotation
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap
from station.places.tracking.config import BeliefConfig
from station.places.tracking.coverage import MOST_ASKED, Coverage
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.map_view import MapView
from tests.places_support import R_BODY_CAM, make_map, seen

WALL_X, DOOR = 4.0, (1.6, 2.4)  # between the room (x 0..4, y 0..4) and its neighbour (x 4..8)
HALF_VIEW = np.arctan(320 / 1080)  # as narrow as the robot's camera
CAMERA = CameraCalibration(
    width=640, height=480, fx=1080, fy=1080, cx=320, cy=240, T_body_cam=tuple(se3(R_BODY_CAM, np.zeros(3)).ravel())
)


def mapped(xy: FloatArray, yaw: FloatArray, p: FloatArray, *, upright: bool = True) -> PlaceMap:
    """A map of keyframes at xy (F, 2) that look along yaw (F,) and saw what of p (M, 3) the wall does not hide."""
    T = np.stack([se3(yaw_rotation(a), np.array([*q, 0.0])) for q, a in zip(xy, yaw, strict=True)])
    observed = [(m, k) for k in range(len(xy)) for m in np.flatnonzero(_in_view(xy[k], yaw[k], p))]
    landmark, keyframe = np.array(observed, dtype=np.int64).reshape(-1, 2).T
    count, t = len(p), np.arange(len(xy)) * 10**9
    T_cam, zeros, uv_px = (
        T @ se3(R_BODY_CAM, np.zeros(3)),
        np.zeros(len(xy), dtype=np.int64),
        np.zeros((len(landmark), 2)),
    )
    navigation = Navigation(
        id="nav",
        calibration=Calibration(camera=CAMERA, imu=None),
        trajectory=Trajectory(t, T),
        keyframes=Keyframes(np.arange(len(t)), t, T_cam, (b"",) * len(t), zeros),
        landmarks=Landmarks(p, np.zeros((count, 3), np.uint8), np.zeros((count, 3, 3)), landmark, keyframe, uv_px),
        report=NavigationReport("test", len(t), 1, 1, 1, 1, count, 0, "metric", upright, 0, {}, {}),
    )
    return replace(make_map(places=1), navigation=navigation)


def _in_view(xy: FloatArray, yaw: float, p: FloatArray) -> np.ndarray:
    d = p[:, :2] - xy
    ahead = np.abs((np.arctan2(d[:, 1], d[:, 0]) - yaw + np.pi) % (2 * np.pi) - np.pi) < HALF_VIEW
    beyond = p[:, 0] > WALL_X
    y = xy[1] + d[:, 1] * (WALL_X - xy[0]) / np.where(beyond, d[:, 0], 1.0)  # where the ray crosses the wall
    return ahead & (~beyond | ((y > DOOR[0]) & (y < DOOR[1])))


def walls() -> FloatArray:
    """Landmarks (M, 3) on all walls of both rooms, every 5 cm, at three heights; none in the door."""
    along = np.arange(0.0, 4.0, 0.025)
    lines = []
    for x0, sides in ((0.0, (0.0, 3.98)), (4.02, (4.02, 8.0))):
        lines += [np.column_stack([x0 + along, np.full_like(along, y)]) for y in (0.0, 4.0)]
        lines += [np.column_stack([np.full_like(along, x), along]) for x in sides]
    xy = np.concatenate(lines)
    in_door = (np.abs(xy[:, 0] - WALL_X) < 0.1) & (xy[:, 1] > DOOR[0]) & (xy[:, 1] < DOOR[1])
    xy = xy[~in_door]
    return np.concatenate([np.column_stack([xy, np.full(len(xy), z)]) for z in (-0.2, 0.2, 0.6)])


def room_with_a_door(*, upright: bool = True) -> PlaceMap:
    """A ring through the room, looking everywhere, and up to its door."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = 2.0 + 1.2 * np.column_stack([np.cos(angle), np.sin(angle)])
    to_door = np.column_stack([np.linspace(3.2, 3.9, 4), np.full(4, 2.0)])
    return mapped(np.concatenate([ring, to_door]), np.concatenate([5 * angle, np.zeros(4)]), walls(), upright=upright)


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
