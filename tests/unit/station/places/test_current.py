"""The current place: what images, failures, odometry and hijacks do to the answer."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from shared.calibration import REFERENCE_HEAD, REFERENCE_IMU, ImuNoise, Rig
from shared.geometry import se3
from shared.head import turned
from station.motion.head import AHEAD, Aim
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.filter import predict_time
from station.places.tracking.map_view import MapView
from station.places.tracking.report import largest
from tests.support.places import CONFIG, R_BODY_CAM, SECOND, estimator_of, make_map, pose, seen


@pytest.mark.parametrize("scale", [None, 0.3])
@pytest.mark.parametrize("pan", [0.0, 0.9, -1.0])
def test_a_robot_whose_head_looks_aside_is_where_it_would_be_if_it_looked_ahead(
    pan: float, scale: float | None
) -> None:
    place_map = make_map(scale=scale)
    aim = Aim(turned(REFERENCE_HEAD, pan, 0.1), 0.05)
    answers = []
    for of in (AHEAD, aim):
        estimator = CurrentPlaceEstimator([place_map])
        T_map_cam = pose(2.8, 0.2, 0.4) @ of.T_body_head @ se3(R_BODY_CAM, np.zeros(3))
        T_map_cam[:3, 3] *= scale or 1.0
        for k in range(3):
            estimator.on_candidates([replace(seen(k, np.eye(4)), T_map_cam=T_map_cam)], aim=of)
        answers.append(estimator.answer(2 * SECOND))
    straight, turned_aside = answers
    assert straight.place is not None and turned_aside.place is not None
    assert turned_aside.place.id == straight.place.id
    known_to = 1e-9 if scale is None else 0.03  # the metre of a map without one is a guess, here half as long again
    np.testing.assert_allclose(turned_aside.position_map, straight.position_map, atol=known_to)
    np.testing.assert_allclose(turned_aside.forward_map, straight.forward_map, atol=known_to)


def test_before_any_image_the_robot_is_lost() -> None:
    answer = estimator_of(make_map()).answer(0)
    assert answer.state == "lost" and answer.place is None
    assert answer.reason


def test_a_verified_image_names_the_nearest_place() -> None:
    estimator = estimator_of(make_map())
    estimator.on_candidates([seen(1.0, pose(2.8, 0.2))])
    answer = estimator.answer(SECOND)
    assert answer.state == "known"
    assert answer.place is not None and answer.place.id == "map-1"
    assert answer.place.probability > 0.9
    assert answer.distance == pytest.approx(np.linalg.norm([0.2, 0.2, 0.3]))
    assert answer.evidence_keyframe == 4 and answer.inliers == 200


def test_odometry_carries_the_robot_to_the_next_place() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.1, 0.0, 0.0))])
    for k in range(1, 31):
        estimator.on_odometry(k * SECOND // 10, pose(0.1 * k, 0))
    answer = estimator.answer(3 * SECOND)
    assert answer.state == "known" and answer.place is not None
    assert answer.place.id == "map-1"
    assert answer.position_map is not None
    assert np.allclose(answer.position_map, [3.1, 0.0, 0.0], atol=0.05)


def test_an_image_localised_late_counts_for_its_own_moment() -> None:
    estimator = estimator_of(make_map())
    for k in range(31):
        estimator.on_odometry(k * SECOND // 10, pose(0.1 * k, 0))
    estimator.on_candidates([seen(1.0, pose(1.0, 0.0))])  # known 2 s later, when the robot is at x = 3
    answer = estimator.answer(3 * SECOND)
    assert answer.place is not None and answer.place.id == "map-1"
    assert answer.position_map is not None and answer.position_map[0] == pytest.approx(3.0, abs=0.05)


def test_a_piece_of_furniture_is_less_evidence_than_an_arrangement() -> None:
    for extent, state in ((0.07, "lost"), (0.5, "known")):
        estimator = estimator_of(make_map())
        estimator.on_candidates([seen(1.0, pose(2.8, 0.2), inliers=150, extent=extent)])
        assert estimator.answer(SECOND).state == state


def test_of_two_poses_the_one_that_explains_more_space_is_believed_not_the_one_with_more_landmarks() -> None:
    estimator = estimator_of(make_map())
    piece, arrangement = pose(0.2, 0.0), pose(5.9, 0.0)
    estimator.on_candidates(
        [seen(1.0, piece, inliers=300, extent=0.1), seen(1.0, arrangement, inliers=160, extent=0.6)]
    )
    answer = estimator.answer(SECOND)
    assert answer.place is not None and answer.place.id == "map-2"


def test_an_answer_about_the_past_says_that_it_is_about_now() -> None:
    estimator = estimator_of(make_map())
    for k in range(31):
        estimator.on_odometry(k * SECOND // 10, pose(0.1 * k, 0))
    estimator.on_candidates([seen(1.0, pose(1.0, 0.0))])
    answer = estimator.answer(SECOND)  # of the image, when the robot is two metres farther already
    assert answer.t_robot_ns == 3 * SECOND
    assert answer.place is not None and answer.place.id == "map-1"
    assert answer.position_map is not None and answer.position_map[0] == pytest.approx(3.0, abs=0.05)
    assert answer.evidence_t_robot_ns == SECOND


def test_after_a_hijack_the_old_place_is_forgotten_and_the_new_one_found() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    estimator.on_hijack(SECOND, "lifted")
    lost = estimator.answer(SECOND)
    assert lost.state == "lost" and "lifted" in lost.reason
    estimator.on_candidates([seen(2.0, pose(6.0, 0.0, 2.0))])
    found = estimator.answer(2 * SECOND)
    assert found.state == "known" and found.place is not None and found.place.id == "map-2"


@pytest.mark.parametrize(("inliers", "state"), [(30, "lost"), (200, "known")])
def test_a_first_image_of_few_landmarks_may_be_of_a_room_that_no_map_knows(inliers: int, state: str) -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0), inliers=inliers, extent=0.3)])
    assert estimator.answer(0).state == state


def test_what_was_lost_is_found_also_where_the_robot_was_before_the_hijack() -> None:
    def weight(before: bool) -> float:
        estimator = estimator_of(make_map())
        estimator.on_odometry(0, pose(0, 0))
        if before:
            estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
        estimator.on_hijack(SECOND, "lifted")
        estimator.on_candidates([seen(2.0, pose(0.0, 0.0), inliers=100, extent=0.2)])
        return float(estimator.place_probabilities().place[0])

    assert weight(before=False) > 0.5
    assert weight(before=True) > 0.95 * weight(before=False)


def test_a_pose_that_errs_by_more_than_it_should_is_still_the_tracked_robots() -> None:
    estimator = estimator_of(make_map())
    for k in range(4):
        estimator.on_odometry(k * SECOND, pose(0.05 * k, 0, 0.3 * k))
        estimator.on_candidates([seen(k, pose(0.05 * k, 0, 0.3 * k))])
    before = estimator.answer(3 * SECOND).position_map
    estimator.on_odometry(4 * SECOND, pose(0.2, 0, 1.2))
    estimator.on_candidates([seen(4.0, pose(0.2, 0.28, 1.2))])
    answer = estimator.answer(4 * SECOND)
    assert answer.state == "known" and answer.position_map is not None and before is not None
    assert 0.0 <= answer.position_map[1] - before[1] < 0.1  # and does not drag it along


def test_of_two_poses_in_one_image_the_larger_one_with_more_landmarks_is_believed_at_once() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    larger = seen(0.0, pose(0.0, 0.0), inliers=270, extent=0.47)
    estimator.on_candidates([larger, seen(0.0, pose(6.0, 0.0, 1.0), inliers=74, extent=0.2)])
    answer = estimator.answer(0)
    assert answer.state == "known" and answer.place is not None and answer.place.id == "map-0"


def test_a_robot_found_again_is_not_told_of_the_hijack_when_it_is_lost_later() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_hijack(0, "lifted")
    estimator.on_candidates([seen(1.0, pose(6.0, 0.0, 2.0))])
    assert estimator.answer(SECOND).state == "known"
    reasons = []
    for k in range(2, 12):
        estimator.on_odometry(k * SECOND, pose(0, 0, 0.3 * k))
        estimator.on_candidates([seen(k, pose(0.0, 0.0, 0.3 * k), inliers=30)])
        answer = estimator.answer(k * SECOND)
        if answer.state != "known":
            reasons.append(answer.reason)
    assert reasons and not any("hijack" in reason for reason in reasons), reasons


def test_one_weak_contradiction_does_not_move_a_tracked_robot() -> None:
    estimator = estimator_of(make_map())
    for k in range(10):
        estimator.on_odometry(k * SECOND, pose(0.05 * k, 0, 0.1 * k))
        estimator.on_candidates([seen(k, pose(0.05 * k, 0, 0.1 * k))])
    estimator.on_candidates([seen(9.5, pose(6.0, 0.0), inliers=16)])
    answer = estimator.answer(10 * SECOND)
    assert answer.place is not None and answer.place.id == "map-0"


def sure_at_the_first_place() -> CurrentPlaceEstimator:
    """After a second in which every image was recognised there."""
    estimator = estimator_of(make_map())
    for k in range(8):
        estimator.on_odometry(k * SECOND // 8, pose(0.0, 0.0))
        estimator.on_candidates([seen(k / 8, pose(0.0, 0.0))])
    return estimator


def drive_along(estimator: CurrentPlaceEstimator, x: tuple[float, float], steps: int = 30) -> int:
    """Odometry from one x to another, a step a tenth of a second; returns the robot's time afterwards."""
    t_ns = SECOND
    for at in np.linspace(*x, steps):
        t_ns += SECOND // 10
        estimator.on_odometry(t_ns, pose(float(at), 0.0))
    return t_ns


def test_a_look_alike_that_only_slipping_wheels_explain_does_not_take_a_sure_belief_with_it() -> None:
    estimator = sure_at_the_first_place()
    t_ns = drive_along(estimator, (0.0, 6.0))
    for _ in range(10):
        t_ns += SECOND // 10
        estimator.on_odometry(t_ns, pose(6.0, 0.0))
        estimator.on_candidates([seen(t_ns / SECOND, pose(0.4, 0.0), inliers=25, extent=0.12)])
    answer = estimator.answer(t_ns)
    assert answer.position_map is not None
    assert answer.position_map[0] == pytest.approx(6.0, abs=0.5)


def test_slipping_wheels_explain_no_look_alike_that_is_farther_than_they_turned() -> None:
    estimator = sure_at_the_first_place()
    t_ns = drive_along(estimator, (0.0, 0.6))
    estimator.on_candidates([seen(t_ns / SECOND, pose(3.4, 0.0))])
    answer = estimator.answer(t_ns)
    assert answer.state == "known" and answer.position_map is not None
    assert answer.position_map[0] == pytest.approx(0.6, abs=0.1)


def test_wheels_that_turned_on_the_spot_are_seen_by_what_stays_in_view() -> None:
    estimator = sure_at_the_first_place()
    t_ns = drive_along(estimator, (0.0, 3.0))  # the robot stands at a wall
    for _ in range(8):
        t_ns += SECOND // 2
        estimator.on_candidates([seen(t_ns / SECOND, pose(0.0, 0.0))])
    answer = estimator.answer(t_ns)
    assert answer.state == "known" and answer.place is not None and answer.place.id == "map-0"


def test_of_look_alikes_the_one_that_odometry_expects_is_believed() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    for k in range(1, 6):
        estimator.on_odometry(k * SECOND, pose(0.05 * k, 0, 0.3 * k))
        look_alike = seen(k, pose(6.0, 0.0, 2.0 + 0.3 * k), inliers=120)
        estimator.on_candidates([look_alike, seen(k, pose(0.05 * k, 0, 0.3 * k), inliers=100)])
    answer = estimator.answer(5 * SECOND)
    assert answer.state == "known" and answer.place is not None and answer.place.id == "map-0"


def test_after_a_hijack_look_alikes_leave_it_open_until_a_view_decides() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_hijack(0, "lifted")
    estimator.on_candidates([seen(1.0, pose(0.0, 0.0), inliers=120), seen(1.0, pose(6.0, 0.0, 1.0), inliers=110)])
    assert estimator.answer(SECOND).state == "lost"
    estimator.on_odometry(2 * SECOND, pose(0.0, 0.0, 0.5))
    estimator.on_candidates([seen(2.0, pose(6.0, 0.0, 1.5))])
    answer = estimator.answer(2 * SECOND)
    assert answer.state == "known" and answer.place is not None and answer.place.id == "map-2"


def test_going_over_to_another_position_is_a_jump_and_driving_there_is_none() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    for k in range(8):
        estimator.on_odometry(k * SECOND, pose(0.8 * k, 0))
        assert estimator.on_candidates([seen(k, pose(0.75 * k, 0))]) is None
    jumps = []
    for k in range(8, 15):
        estimator.on_odometry(k * SECOND, pose(5.6, 0, 0.4 * (k - 8)))
        jumps.append(estimator.on_candidates([seen(k, pose(0.5, 0, 0.4 * (k - 8)))]))
    told = [jump for jump in jumps if jump is not None]
    assert len(told) == 1 and told[0].distance_m == pytest.approx(4.75, abs=0.3)


@pytest.mark.parametrize(("rig", "imu"), [("wheels", REFERENCE_IMU), ("wheels", None), ("hand-held", REFERENCE_IMU)])
def test_a_robot_that_feels_being_carried_needs_more_to_be_elsewhere_than_one_that_does_not(
    rig: Rig, imu: ImuNoise | None
) -> None:
    place_map = make_map()
    calibration = msgspec.structs.replace(place_map.navigation.calibration, rig=rig, imu=imu)
    estimator = CurrentPlaceEstimator([place_map], calibration, CONFIG)
    for k in range(60):
        estimator.on_odometry(k * SECOND, pose(0.1 * k, 0.0))
        estimator.on_candidates([seen(k, pose(0.1 * k, 0.0))])
    for k in (60, 61):  # a look-alike, to and fro
        estimator.on_odometry(k * SECOND, pose(6.0, 0.0, 0.1 * k))
        estimator.on_candidates([seen(k, pose(1.0, 3.0, 0.1 * k), inliers=60, extent=0.5)])
    assert (estimator.answer(61 * SECOND).state == "known") == (rig == "wheels" and imu is not None)


def test_what_is_carried_while_nothing_is_heard_of_it_is_not_felt() -> None:
    before = sure_at_the_first_place()._belief
    felt, unheard = (predict_time(before, 60.0, blind_s, CONFIG) for blind_s in (0.0, 60.0))
    gained = (felt.lost - before.lost, unheard.lost - before.lost)
    assert gained[1] == pytest.approx(100 * gained[0], rel=0.02)


@pytest.mark.parametrize(("views_before", "is_moved"), [(1, False), (30, True)])
def test_who_was_never_sure_of_a_place_had_been_wrong_and_who_was_has_been_moved(
    views_before: int, is_moved: bool
) -> None:
    estimator = estimator_of(make_map())
    for k in range(views_before):
        estimator.on_odometry(k * SECOND, pose(0.2 * k, 0.0))
        estimator.on_candidates([seen(k, pose(0.2 * k, 0.0))])
    assert estimator.answer(views_before * SECOND).state == "known"
    jumps = []
    for k in range(views_before, views_before + 40):
        estimator.on_odometry(k * SECOND, pose(0.2 * views_before, 0.0, 0.3 * k))
        jumps.append(estimator.on_candidates([seen(k, pose(6.0, 3.0, 0.3 * k))]))
    [jump] = [jump for jump in jumps if jump is not None]
    assert (jump.moved > 0.5) == is_moved


def test_far_from_the_mapping_drive_the_place_is_unknown() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(6.0, 0.0))])
    for k in range(1, 60):
        estimator.on_odometry(k * SECOND // 10, pose(0.1 * k, 0))
    answer = estimator.answer(6 * SECOND)
    assert answer.state == "unknown" and "no free space" in answer.reason


def test_at_the_edge_of_the_map_the_place_is_unknown_and_the_robot_not_lost() -> None:
    estimator = estimator_of(make_map())
    for k in range(6):  # beside Place 1, where the space ends that the map knows
        estimator.on_candidates([seen(k, pose(3.0, 0.42))])
    answer = estimator.answer(6 * SECOND)
    assert answer.state == "unknown" and answer.position_map is not None
    assert answer.alternatives[0].name == "Place 1" and answer.alternatives[0].probability > 0.5


def test_halfway_between_two_places_both_count_as_right() -> None:
    estimator = estimator_of(make_map())
    estimator.on_candidates([seen(0.0, pose(1.5, 0.0))])
    answer = estimator.answer(0)
    assert answer.state == "known" and answer.place is not None
    assert {answer.place.id, answer.alternatives[0].id} == {"map-0", "map-1"}
    assert answer.place.probability > 0.9 and answer.alternatives[0].probability > 0.9  # of being right: both are


def test_a_map_without_places_never_answers_known() -> None:
    estimator = estimator_of(make_map(places=0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    answer = estimator.answer(0)
    assert answer.state == "unknown" and "no places" in answer.reason


def test_a_map_with_one_place_answers_it_within_and_unknown_beyond() -> None:
    estimator = estimator_of(make_map(places=1))
    estimator.on_candidates([seen(0.0, pose(0.5, 0.0))])
    answer = estimator.answer(0)
    assert answer.state == "known" and answer.place is not None and answer.place.id == "map-0"
    assert answer.alternatives == ()
    for k in range(1, 8):
        estimator.on_candidates([seen(k, pose(3.0, 5.0))])
    assert estimator.answer(8 * SECOND).state == "unknown"


def test_without_any_map_the_answer_is_unknown() -> None:
    answer = estimator_of().answer(0)
    assert answer.state == "unknown" and answer.place is None and answer.reason


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), places=st.integers(1, 40), tie=st.floats(1.0, 2.0))
def test_shares_of_the_nearest_place_are_those_of_all_distances(seed: int, places: int, tie: float) -> None:
    rng = np.random.default_rng(seed)
    view = replace(MapView.of(make_map(places=places)), centroids=rng.uniform(-5, 5, (places, 3)))
    view = replace(view, tree=cKDTree(view.centroids))
    p = rng.uniform(-6, 6, (50, 3))
    distance = np.linalg.norm(p[:, None] - view.centroids[None], axis=2)
    nearest, tied = view.nearest(p, tie)
    np.testing.assert_allclose(nearest, np.bincount(distance.argmin(axis=1), minlength=places) / 50)
    least = distance.min(axis=1, keepdims=True)
    assert (tied >= nearest).all()
    assert (tied >= (distance <= (tie - 1e-9) * least).mean(axis=0)).all()
    assert (tied <= (distance <= (tie + 1e-9) * least).mean(axis=0)).all()


@given(values=st.lists(st.sampled_from([0.0, 0.1, 0.2, 0.7, 1.0]), max_size=30), how_many=st.integers(1, 5))
def test_the_largest_of_many_are_those_a_sort_puts_first(values: list[float], how_many: int) -> None:
    expected = np.argsort(-np.array(values), kind="stable")[:how_many]
    assert largest(np.array(values), how_many).tolist() == expected.tolist()


def test_without_odometry_certainty_fades() -> None:
    estimator = estimator_of(make_map())
    estimator.on_candidates([seen(0.0, pose(1.0, 0.0))])
    assert estimator.answer(SECOND // 4).state == "known"
    assert estimator.answer(60 * SECOND).state != "known"


def test_the_right_one_of_two_active_maps_answers() -> None:
    estimator = estimator_of(make_map("a"), make_map("b"))
    estimator.on_candidates([seen(0.0, pose(3.0, 0.0), map_id="b")])
    answer = estimator.answer(0)
    assert answer.place is not None and answer.place.id == "b-1" and answer.map_id == "b"
    assert answer.distance == pytest.approx(np.linalg.norm([0.0, 0.0, 0.3]))  # to a position in the same map


def test_while_nothing_was_recognised_no_map_is_named() -> None:
    estimator = estimator_of(make_map("a"), make_map("b"))
    assert estimator.answer(0).map_id is None


def test_after_a_hijack_a_robot_is_found_in_the_other_map_and_going_over_without_one_is_a_jump_there() -> None:
    estimator = estimator_of(make_map("a"), make_map("b"))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0), map_id="a")])
    estimator.on_hijack(SECOND, "lifted", 0.99)
    assert estimator.answer(SECOND).state == "lost"
    assert estimator.on_candidates([seen(2.0, pose(6.0, 0.0), map_id="b")]) is None  # the hijack was told already
    found = estimator.answer(2 * SECOND)
    assert (found.state, found.map_id) == ("known", "b") and found.place is not None and found.place.id == "b-2"
    jumps = [estimator.on_candidates([seen(k, pose(0.3 * k, 0.0), map_id="a")]) for k in range(10, 30, 2)]
    assert [jump.is_other_map for jump in jumps if jump is not None] == [True]
    assert estimator.answer(30 * SECOND).map_id == "a"


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["loc", "fail", "odometry", "hijack", "wait"]),
        st.floats(0, 5),
        st.floats(-2, 8),
        st.floats(-3, 3),
    ),
    max_size=25,
)


@settings(max_examples=40, deadline=None)
@given(events=EVENTS)
def test_probabilities_always_sum_to_one(events: list[tuple[str, float, float, float]]) -> None:
    estimator = estimator_of(make_map())
    t = 0.0
    for kind, seconds, x, yaw in events:
        t += seconds
        if kind == "loc":
            estimator.on_candidates([seen(t, pose(x, 0.0, yaw))])
        elif kind == "fail":
            estimator.on_failure(int(t * SECOND))
        elif kind == "odometry":
            estimator.on_odometry(int(t * SECOND) + 1, pose(x, 0.0, yaw))
        elif kind == "hijack":
            estimator.on_hijack(int(t * SECOND), "test")
        belief = estimator.place_probabilities()
        assert belief.place.sum() + belief.unmapped == pytest.approx(1.0)
        assert (belief.place >= 0).all() and belief.unmapped >= 0
        answer = estimator.answer(int(t * SECOND))
        assert (answer.place is not None) == (answer.state == "known")
