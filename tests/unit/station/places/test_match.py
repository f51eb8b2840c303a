"""A second drive through a known room finds its places again; another room does not."""

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import FloatArray, se3, transform, yaw_rotation
from station.datasets import Truth
from station.experiments.matches import judge_matches, true_landmarks
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.joining import match
from station.places.joining.align import align_navigation
from station.places.joining.match import match_navigation
from station.places.making.build import build_map
from station.places.making.clusters import Clusters
from station.places.making.config import PlacesConfig, ThesisConfig
from tests.support.synthetic_home import drive, furnished_room, navigate, with_points

PLANE = np.c_[np.mgrid[0:9, 0:9].reshape(2, -1).T, np.zeros(81)]
T_NAV_WORLD = se3(yaw_rotation(2.2), np.array([4.0, -1.0, 0.0]))


def truth_of(poses: FloatArray) -> Truth:
    return Truth(np.arange(len(poses), dtype=np.int64) * 100_000_000, poses)


@pytest.fixture(scope="module")
def first() -> tuple[PlaceMap, FloatArray]:
    home = furnished_room(3, density=300)
    poses = drive(home, 31)
    return build_map(navigate(home, poses, seed=31, images=False)), poses


@pytest.fixture(scope="module")
def second() -> tuple[Navigation, FloatArray]:
    home = furnished_room(3, density=300)
    poses = drive(home, 32, radius=0.6)
    return navigate(home, poses, seed=32, T_nav_world=T_NAV_WORLD, images=False), poses


def test_a_second_drive_finds_the_places_again(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray]
) -> None:
    place_map, poses = first
    navigation, true_poses = second
    result = match_navigation(place_map, navigation)
    assert result.registration.accepted, result.registration.reasons
    assert len({m.place_id for m in result.matches}) == len({m.location_id for m in result.matches})
    judgement = judge_matches(place_map, truth_of(poses), navigation, truth_of(true_poses), result)
    assert judgement.precision == 1.0
    assert judgement.recall is not None and judgement.recall >= 0.8
    assert judgement.registration_error is not None and judgement.registration_error < 0.05
    np.testing.assert_allclose(result.position_map, true_poses[:, :3, 3], atol=0.1)


def test_small_places_are_found_in_a_location_as_large_as_the_room(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    place_map, poses = first
    navigation, true_poses = second

    def one_cluster(navigation: Navigation, *_: object, **__: object) -> Clusters:
        return Clusters(np.zeros(len(navigation.landmarks), dtype=np.int64), np.ones(1), {})

    monkeypatch.setattr(match, "cluster_landmarks", one_cluster)
    result = match_navigation(place_map, navigation)
    judgement = judge_matches(place_map, truth_of(poses), navigation, truth_of(true_poses), result)
    assert len(place_map.places) > 5  # so that each is less than a fifth of the room
    assert judgement.precision == 1.0
    assert judgement.recall is not None and judgement.recall >= 0.8


@pytest.mark.parametrize(("factor", "accepted"), [(0.98, True), (0.96, False)])
def test_a_metric_drive_may_be_as_wrong_in_scale_as_slam_is_but_not_more(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray], factor: float, accepted: bool
) -> None:
    navigation, _ = second
    keyframes = navigation.keyframes
    T_world_cam = keyframes.T_world_cam.copy()
    T_world_cam[:, :3, 3] *= factor
    carried = replace(
        navigation,
        landmarks=replace(navigation.landmarks, p_world=factor * navigation.landmarks.p_world),
        keyframes=replace(keyframes, T_world_cam=T_world_cam),
    )
    found = align_navigation(first[0], carried, PlacesConfig())
    assert found.accepted is accepted, found.reasons
    if accepted:  # else an earlier check may have refused it
        assert found.measured["freed scale"] == pytest.approx(1 / factor, abs=0.006)


def test_another_room_gives_no_matches(first: tuple[PlaceMap, FloatArray]) -> None:
    home = furnished_room(77, density=300, size=(3.2, 6.0))
    result = match_navigation(first[0], navigate(home, drive(home, 5), seed=5, images=False))
    assert not result.registration.accepted
    assert result.matches == () and len(result.nearest_place) == 0
    assert result.registration.reasons


def test_thesis_mode_matches_when_the_frames_are_already_near(first: tuple[PlaceMap, FloatArray]) -> None:
    _, poses = first
    config = PlacesConfig(mode="thesis", thesis=ThesisConfig(eps=0.25, min_pts=11, inlier_ratio=0.75))
    home = furnished_room(3, density=300)
    place_map = build_map(navigate(home, poses, seed=31), config=config)
    T = se3(yaw_rotation(0.05), np.array([0.05, 0.02, 0.0]))
    navigation = navigate(home, drive(home, 32), seed=32, T_nav_world=T)
    result = match_navigation(place_map, navigation, config)
    carried = transform(result.registration.T_target_source, transform(T, home.p))  # type: ignore[arg-type]
    assert np.median(np.linalg.norm(carried - home.p, axis=1)) < 0.03
    assert result.matches


@pytest.mark.parametrize(
    "p",
    [np.zeros((0, 3)), np.ones((1, 3)), np.full((60, 3), np.nan), PLANE],
    ids=["empty", "one point", "all NaN", "a plane"],
)
@pytest.mark.parametrize("mode", ["thesis", "default"])
def test_a_hopeless_navigation_is_answered_without_matches(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray], p: FloatArray, mode: str
) -> None:
    config = PlacesConfig(mode="thesis" if mode == "thesis" else "default")
    result = match_navigation(first[0], with_points(second[0], p), config)
    assert result.matches == () and result.registration.reasons
    # Enough finite points are always accepted in the thesis mode: there a person judges by eye, and is told so.
    judged_by_eye = mode == "thesis" and np.isfinite(p).all() and len(p) >= 12
    assert result.registration.accepted == judged_by_eye
    assert ("judge by eye" in "; ".join(result.registration.reasons)) == judged_by_eye


def test_a_refusal_names_the_drive_without_a_cloud(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray]
) -> None:
    nothing = with_points(second[0], np.zeros((0, 3)))
    for place_map, navigation in ((first[0], nothing), (build_map(nothing), first[0].navigation)):
        [reason] = match_navigation(place_map, navigation).registration.reasons
        assert reason == f"{nothing.id} has no finite landmark (of 0) and cannot be registered"


def test_a_navigation_in_other_units_than_it_says_is_named_as_such(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray]
) -> None:
    millimetres = with_points(second[0], 1000 * second[0].landmarks.p_world)
    result = match_navigation(first[0], millimetres)
    assert result.matches == () and not result.registration.accepted
    assert "units" in result.registration.reasons[0]


def test_a_map_without_and_with_one_place(
    first: tuple[PlaceMap, FloatArray], second: tuple[Navigation, FloatArray]
) -> None:
    place_map, _ = first
    none = PlaceMap(place_map.id, "", place_map.navigation, (), (), place_map.config)
    assert match_navigation(none, second[0]).matches == ()
    one = PlaceMap(place_map.id, "", place_map.navigation, place_map.places[:1], (), place_map.config)
    result = match_navigation(one, second[0])
    assert len(result.matches) <= 1
    assert (result.nearest_place == 0).all() and len(result.nearest_place)


def test_true_landmarks_undo_the_navigations_frame_and_scale() -> None:
    home = furnished_room(2)
    poses = drive(home, 2)
    T = se3(yaw_rotation(1.0), np.array([3.0, 1.0, 0.5]))
    T[:3, :3] *= 4.0
    clean = navigate(home, poses, seed=2, noise_m=0.0, outlier_share=0.0)
    moved = navigate(home, poses, seed=2, noise_m=0.0, outlier_share=0.0, T_nav_world=T, metric=False)
    np.testing.assert_allclose(true_landmarks(moved, truth_of(poses)), clean.landmarks.p_world, atol=1e-6)
