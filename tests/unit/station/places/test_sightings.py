"""What should be in view at a pose, by what the map's keyframes saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import IntArray, se3, yaw_rotation
from station.model.navigation import Keyframes
from station.model.place_map import PlaceMap
from station.places.space.space import Space
from station.places.tracking.sightings import MOST_ASKED, Sightings
from tests.support.places import R_BODY_CAM
from tests.support.rooms import CAMERA, mapped, room_with_a_door, walls


def sightings_of(place_map: PlaceMap) -> Sightings:
    return Sightings(place_map, 1.0, Space.of(place_map.navigation))


def test_in_a_room_driven_through_all_day_as_much_is_in_view_and_not_every_keyframe_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place_map = room_with_a_door()
    T = se3(yaw_rotation(np.pi), np.array([3.2, 2.0, 0.0])) @ se3(R_BODY_CAM, np.zeros(3))
    once = sightings_of(place_map).in_view(T, CAMERA)
    often = sightings_of(repeated(place_map, 20))
    asked = []
    seen_by = often._seen.by

    def by(keyframes: IntArray) -> tuple[IntArray, IntArray]:
        asked.append(len(keyframes))
        return seen_by(keyframes)

    monkeypatch.setattr(often._seen, "by", by)
    assert often.in_view(T, CAMERA) == pytest.approx(once, rel=0.1) and once > 100
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
    every = sightings_of(place_map).in_view(T, CAMERA)
    assert sightings_of(half).in_view(T, CAMERA) == pytest.approx(every / 2, rel=0.25)


def test_nothing_is_surely_in_view_through_a_wall_that_shows_nothing() -> None:
    """A camera before a cupboard, or behind a plain wall: others saw across the room from as near."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = 2.0 + 1.2 * np.column_stack([np.cos(angle), np.sin(angle)])
    p = walls()
    sightings = sightings_of(mapped(ring, 5 * angle, p[p[:, 0] > 0.1]))

    def looking_across(x: float) -> tuple[float, float]:
        T = se3(np.eye(3), np.array([x, 2.0, 0.0])) @ se3(R_BODY_CAM, np.zeros(3))
        return sightings.in_view(T, CAMERA), sightings.surely_in_view(T, CAMERA)

    inside, behind = looking_across(0.8), looking_across(-0.5)
    assert inside[1] == pytest.approx(inside[0], rel=0.1) and inside[0] > 100
    assert behind[0] > 50 and behind[1] == 0.0
