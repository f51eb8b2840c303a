"""Clusters become a named, connected map; hopeless clouds become an empty one."""

import itertools

import numpy as np
import pytest

from shared.errors import ConfigError, DataError
from station.model.navigation import Navigation
from station.places.making.build import build_map, carry_names
from station.places.making.clusters import NOISE, cluster_landmarks
from station.places.making.config import PlacesConfig, ThesisConfig
from station.places.making.graph import shortest_route, to_graphml, to_json_dict
from tests.support.synthetic_home import drive, furnished_room, navigate, with_points


@pytest.fixture(scope="module")
def navigation() -> Navigation:
    home = furnished_room(3)
    return navigate(home, drive(home, 3), seed=3)


def test_a_furnished_room_has_a_handful_of_places(navigation: Navigation) -> None:
    place_map = build_map(navigation)
    assert 4 <= len(place_map.places) <= 14
    assert [place.name for place in place_map.places] == [f"Place {k + 1}" for k in range(len(place_map.places))]
    assert all(place.radius < 1.0 for place in place_map.places)


def test_the_same_navigation_gives_the_same_map(navigation: Navigation) -> None:
    a, b = build_map(navigation), build_map(navigation)
    assert a.id == b.id
    assert [p.id for p in a.places] == [p.id for p in b.places]
    assert a.edges == b.edges


def test_thesis_mode_is_dbscan_with_the_given_parameters(navigation: Navigation) -> None:
    blob = np.random.default_rng(0).normal(0, 0.05, (30, 3))
    p = np.concatenate([blob, blob + np.array([5, 0, 0]), [[20.0, 0, 0]]])
    config = PlacesConfig(mode="thesis", thesis=ThesisConfig(eps=0.3, min_pts=11))
    clusters = cluster_landmarks(with_points(navigation, p), config)
    assert clusters.label.tolist() == [0] * 30 + [1] * 30 + [NOISE]


def test_thesis_mode_normalises_clouds_of_arbitrary_scale(navigation: Navigation) -> None:
    home = furnished_room(3)
    config = PlacesConfig(mode="thesis", thesis=ThesisConfig(eps=0.08, min_pts=8))
    T = np.diag([7.0, 7.0, 7.0, 1.0])
    small = navigate(home, drive(home, 3), seed=3, metric=False)
    large = navigate(home, drive(home, 3), seed=3, metric=False, T_nav_world=T)
    assert np.array_equal(cluster_landmarks(small, config).label, cluster_landmarks(large, config).label)


def test_default_clusters_do_not_depend_on_unit_origin_or_heading() -> None:
    home = furnished_room(4)
    T = np.array([[0.0, -7.0, 0.0, 30.0], [7.0, 0.0, 0.0, -5.0], [0.0, 0.0, 7.0, 2.0], [0.0, 0.0, 0.0, 1.0]])
    here = cluster_landmarks(navigate(home, drive(home, 4), seed=4), PlacesConfig())
    there = cluster_landmarks(navigate(home, drive(home, 4), seed=4, metric=False, T_nav_world=T), PlacesConfig())
    assert abs(here.count - there.count) <= 1


@pytest.mark.parametrize("mode", ["thesis", "default"])
@pytest.mark.parametrize(
    "p",
    [np.zeros((0, 3)), np.zeros((1, 3)), np.full((50, 3), np.nan), np.zeros((50, 3))],
    ids=["empty", "one point", "all NaN", "all at one spot"],
)
def test_a_hopeless_cloud_gives_a_map_without_or_with_one_place(navigation: Navigation, mode: str, p: object) -> None:
    place_map = build_map(with_points(navigation, np.asarray(p)), PlacesConfig(mode=mode).mode)  # type: ignore[arg-type]
    assert len(place_map.places) <= 1
    assert place_map.edges == ()
    assert to_json_dict(place_map)["edges"] == []


def test_a_flat_cloud_still_has_places(navigation: Navigation) -> None:
    rng = np.random.default_rng(1)
    spots = rng.uniform(0, 6, (6, 2))
    p = np.concatenate([np.c_[rng.normal(spot, 0.1, (40, 2)), np.zeros(40)] for spot in spots])
    assert len(build_map(with_points(navigation, p)).places) >= 3


def test_points_that_are_not_finite_are_noise(navigation: Navigation) -> None:
    p = navigation.landmarks.p_world.copy()
    p[::10] = np.nan
    place_map = build_map(with_points(navigation, p))
    assert place_map.places
    assert all(np.isfinite(place.centroid_map).all() for place in place_map.places)


def test_graph_is_connected_and_routes_lead_from_name_to_name(navigation: Navigation) -> None:
    place_map = build_map(navigation)
    names = [place.name for place in place_map.places]
    for goal in names[1:]:
        route = shortest_route(place_map, names[0], goal)
        assert route is not None and route.names[0] == names[0] and route.names[-1] == goal
    straight = np.linalg.norm(place_map.places[0].centroid_map - place_map.places[-1].centroid_map)
    route = shortest_route(place_map, names[0], names[-1])
    assert route is not None and route.length >= straight - 1e-9
    assert "<graphml" in to_graphml(place_map)


def test_bearings_point_from_a_to_b(navigation: Navigation) -> None:
    place_map = build_map(navigation)
    centroid = {place.id: place.centroid_map for place in place_map.places}
    for edge in place_map.edges:
        dx, dy, _ = centroid[edge.b] - centroid[edge.a]
        assert np.hypot(dx, dy) * np.cos(edge.bearing_rad) == pytest.approx(dx)
        assert np.hypot(dx, dy) * np.sin(edge.bearing_rad) == pytest.approx(dy)


def test_the_legs_of_a_route_lead_from_place_to_place_in_the_direction_of_travel(navigation: Navigation) -> None:
    place_map = build_map(navigation)
    centroid = {place.id: place.centroid_map for place in place_map.places}
    for start, goal in itertools.permutations(centroid, 2):
        route = shortest_route(place_map, start, goal)
        assert route is not None and (route.place_ids[0], route.place_ids[-1]) == (start, goal)
        assert [(leg.a, leg.b) for leg in route.legs] == list(itertools.pairwise(route.place_ids))
        assert sum(leg.distance for leg in route.legs) == pytest.approx(route.length)
        for leg in route.legs:
            dx, dy, _ = centroid[leg.b] - centroid[leg.a]
            assert np.hypot(dx, dy) * np.cos(leg.bearing_rad) == pytest.approx(dx)
            assert np.hypot(dx, dy) * np.sin(leg.bearing_rad) == pytest.approx(dy)
    assert (stay := shortest_route(place_map, start, start)) is not None and stay.legs == () and stay.length == 0


def test_unknown_place_name_is_answered_with_the_names_there_are(navigation: Navigation) -> None:
    with pytest.raises(DataError, match=r"no place \"Kitchen\".*Place 1"):
        shortest_route(build_map(navigation), "Place 1", "Kitchen")


def test_names_survive_clustering_again_with_other_sizes(navigation: Navigation) -> None:
    old = build_map(navigation)
    new = carry_names(old, build_map(navigation, config=PlacesConfig(size_factor=1.15)))
    kept = {p.id: p for p in old.places}
    carried = [p for p in new.places if p.id in kept]
    assert len(carried) >= 0.6 * len(old.places)
    for place in carried:
        assert place.name == kept[place.id].name
        assert np.linalg.norm(place.centroid_map - kept[place.id].centroid_map) <= 1.0
    names = [p.name for p in new.places]
    assert len(set(names)) == len(names)
    fresh = {p.name for p in new.places} - {p.name for p in old.places}
    assert all(int(name.removeprefix("Place ")) > len(old.places) for name in fresh)
    ids = {p.id for p in new.places}
    assert all(edge.a in ids and edge.b in ids for edge in new.edges)


def test_names_follow_a_map_that_was_moved_and_scaled(navigation: Navigation) -> None:
    home = furnished_room(3)
    T = np.array([[0.0, -2.0, 0.0, 3.0], [2.0, 0.0, 0.0, 1.0], [0.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    moved = navigate(home, drive(home, 3), seed=3, T_nav_world=T, metric=False, name="again")
    old = build_map(navigation)
    new = carry_names(old, build_map(moved), T)
    assert len({p.name for p in new.places} & {p.name for p in old.places}) >= 0.8 * len(old.places)


def test_wrong_parameters_are_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"eps is -1, must be above 0"):
        ThesisConfig(eps=-1)
    with pytest.raises(ConfigError, match='mode is "best"'):
        PlacesConfig(mode="best")  # type: ignore[arg-type]
