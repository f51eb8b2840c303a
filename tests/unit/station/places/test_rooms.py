"""The current room: known before the place, in two rooms at once in a doorway, never a guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.model.place_map import PlaceMap
from station.places.tracking.belief import Belief, Hypothesis
from station.places.tracking.config import BeliefConfig
from station.places.tracking.map_view import MapView
from station.places.tracking.report import Past, Reporter
from station.places.tracking.room_report import RoomReporter
from station.places.tracking.room_view import RoomView
from tests.support.places import SECOND, estimator_of, make_map, pose, seen
from tests.support.plans import two_rooms, with_two_rooms


def hypothesis(map_index: int, weight: float, y: float) -> Hypothesis:
    return Hypothesis(map_index, pose(3.0, y), 1.0, 0.1, 0.1, weight, 0, 0, 0)


def flat() -> PlaceMap:
    return with_two_rooms(make_map())


def test_the_room_is_the_one_that_the_robot_is_in() -> None:
    estimator = estimator_of(flat())
    estimator.on_candidates([seen(1.0, pose(5.0, 0.2))])
    answer = estimator.answer(SECOND)
    assert answer.room is not None and (answer.room.id, answer.room.name) == ("room-k", "Room 2")
    assert answer.room.probability > 0.9
    assert answer.doorway is None


def test_the_room_is_known_where_two_of_its_parts_look_alike() -> None:
    estimator = estimator_of(flat())
    estimator.on_candidates([seen(1.0, pose(0.0, 0.0)), seen(1.0, pose(2.0, 0.3))])
    answer = estimator.answer(SECOND)
    assert answer.state == "lost" and answer.place is None
    assert answer.room is not None and answer.room.id == "room-l"


def test_of_two_rooms_that_look_alike_none_is_guessed() -> None:
    estimator = estimator_of(flat())
    estimator.on_candidates([seen(1.0, pose(0.0, 0.0)), seen(1.0, pose(6.0, 0.0))])
    answer = estimator.answer(SECOND)
    assert answer.room is None
    assert {room.id for room in answer.room_alternatives} == {"room-l", "room-k"}
    assert [room.probability for room in answer.room_alternatives] == pytest.approx([0.5, 0.5], abs=0.1)
    assert {room.id for room in answer.one_of_two} == {"room-l", "room-k"}


@pytest.mark.parametrize(
    ("weights", "unmapped", "lost"),
    [
        (
            ((0.6, 3.0, 0.1),),
            0.4,
            0.0,
        ),  # one pose, in a doorway, where both are right
        (((0.55, 0.0, 0.0), (0.05, 5.0, 0.0)), 0.0, 0.4),  # of the second one hardly more than the prior speaks
        ((), 0.05, 0.95),
        (((0.79, 0.0, 0.0), (0.03, 5.0, 0.0)), 0.18, 0.0),
    ],
)
def test_it_is_one_of_two_rooms_only_where_both_were_recognised(
    weights: tuple[tuple[float, float, float], ...], unmapped: float, lost: float
) -> None:
    reporter = RoomReporter([MapView.of(flat())], BeliefConfig())
    hypotheses = tuple(Hypothesis(0, pose(x, y), 1.0, 0.1, 0.1, w, 0, 0, 0) for w, x, y in weights)
    drawn = [(h, np.repeat(h.T_map_nav[None, :3, 3], 5, axis=0)) for h in hypotheses]
    answer = reporter.answer(Belief(hypotheses, lost=lost, unmapped=unmapped), drawn)
    assert answer.room is None and answer.one_of_two == ()


@pytest.mark.parametrize(("other", "is_named"), [(0.15, False), (0.05, True)])
def test_a_room_and_a_place_are_named_where_no_other_room_was_recognised_to_speak_of(
    other: float, is_named: bool
) -> None:
    """A few pictures of twin rooms tell them apart by chance: 0.85 against 0.15 is no answer."""
    hypotheses = tuple(
        Hypothesis(0, pose(x, y), 1.0, 0.1, 0.1, w, 0, 0, 0) for w, x, y in ((1 - other, 0.0, 0.0), (other, 5.0, 0.2))
    )
    reporter = Reporter([MapView.of(flat())], BeliefConfig(), seed=0)
    answer = reporter.answer(Belief(hypotheses, lost=0.0, unmapped=0.0), np.eye(4), SECOND, Past("", True))
    assert answer.state == ("known" if is_named else "lost")
    assert is_named or "look alike" in answer.reason
    assert (answer.room is not None and answer.room.id == "room-l") is is_named
    assert {room.id for room in answer.one_of_two} == (set() if is_named else {"room-l", "room-k"})


@pytest.mark.parametrize(("third", "is_pair"), [(0.12, False), (0.06, True)])
def test_it_is_one_of_two_rooms_only_where_no_third_one_is_possible(third: float, is_pair: bool) -> None:
    maps = [MapView.of(one) for one in (flat(), replace(flat(), id="other"))]
    at = ((0, pose(0.0, 0.0), 0.85 - third), (0, pose(5.0, 0.2), 0.15), (1, pose(5.0, 0.2), third))
    hypotheses = tuple(Hypothesis(i, T, 1.0, 0.1, 0.1, weight, 0, 0, 0) for i, T, weight in at)
    answer = Reporter(maps, BeliefConfig(), seed=0).answer(
        Belief(hypotheses, lost=0.0, unmapped=0.0), np.eye(4), SECOND, Past("", True)
    )
    assert (answer.state, answer.room) == ("lost", None)
    assert bool(answer.one_of_two) is is_pair


def test_one_pose_beside_a_door_is_in_the_room_that_has_most_of_it() -> None:
    """It spreads through the door, but nothing looks alike."""
    hypothesis = Hypothesis(0, pose(2.6, 0.0), 1.0, 0.3, 0.1, 1.0, 0, 0, 0)
    reporter = Reporter([MapView.of(flat())], BeliefConfig(), seed=0)
    answer = reporter.answer(Belief((hypothesis,), lost=0.0, unmapped=0.0), np.eye(4), SECOND, Past("", True))
    assert answer.one_of_two == ()
    assert [room.id for room in (answer.room,) if room] == ["room-l"]


@pytest.mark.parametrize(("other", "is_named"), [(0.15, False), (0.05, True)])
def test_in_a_doorway_nothing_is_named_while_another_map_is_possible_too(other: float, is_named: bool) -> None:
    """Of one pose both rooms are likelier than the other map's: that one stands third."""
    maps = [MapView.of(one) for one in (flat(), replace(flat(), id="other"))]
    doorway, elsewhere = pose(2.95, 0.1), pose(0.0, 0.0)
    hypotheses = (
        Hypothesis(0, doorway, 1.0, 0.1, 0.1, 1 - other, 0, 0, 0),
        Hypothesis(1, elsewhere, 1.0, 0.1, 0.1, other, 0, 0, 0),
    )
    answer = Reporter(maps, BeliefConfig(), seed=0).answer(
        Belief(hypotheses, lost=0.0, unmapped=0.0), np.eye(4), SECOND, Past("", True)
    )
    assert (answer.room is not None) is is_named
    assert is_named or (answer.state, answer.place, answer.doorway, answer.one_of_two) == ("lost", None, None, ())


def test_in_a_doorway_both_rooms_are_right() -> None:
    estimator = estimator_of(flat())
    estimator.on_candidates([seen(1.0, pose(2.95, 0.1))])
    answer = estimator.answer(SECOND)
    assert answer.doorway == "door-lk"
    assert answer.room is not None
    assert {answer.room.id, answer.room_alternatives[0].id} == {"room-l", "room-k"}
    assert min(answer.room.probability, answer.room_alternatives[0].probability) > 0.9


def test_beyond_a_door_that_nobody_went_through_there_is_no_room() -> None:
    estimator = estimator_of(flat())
    estimator.on_candidates([seen(1.0, pose(7.6, 0.0))])
    assert estimator.answer(SECOND).room is None


def test_where_the_map_does_not_know_its_way_there_is_no_room_whatever_the_plan_says() -> None:
    """A plan goes on into what was looked into through a door that it did not find."""
    place_map = flat()
    estimator = estimator_of(place_map)
    estimator.on_candidates([seen(1.0, pose(5.0, 1.2))])
    answer = estimator.answer(SECOND)
    assert answer.state == "unknown" and answer.room is None
    view = RoomView.of(place_map.plan)
    assert view is not None and view.shares(np.array([[5.0, 1.2, 0.0]]))[0].max() == 1.0


def test_before_any_image_no_room_is_known_not_even_the_only_one() -> None:
    plan = two_rooms()
    only = replace(flat(), plan=replace(plan, rooms=plan.rooms[:1], room=np.minimum(plan.room, 0), doors=()))
    assert estimator_of(only).answer(0).room is None


def test_a_map_without_a_plan_has_no_rooms() -> None:
    estimator = estimator_of(make_map())
    estimator.on_candidates([seen(1.0, pose(2.8, 0.2))])
    answer = estimator.answer(SECOND)
    assert answer.state == "known" and answer.room is None and answer.room_alternatives == ()


def test_a_room_renamed_is_answered_by_its_new_name() -> None:
    place_map = flat()
    estimator = estimator_of(place_map)
    estimator.on_candidates([seen(1.0, pose(5.0, 0.2))])
    plan = two_rooms()
    rooms = (plan.rooms[0], replace(plan.rooms[1], name="Kitchen"))
    estimator.regroup([replace(place_map, plan=replace(plan, rooms=rooms))])
    answer = estimator.answer(SECOND)
    assert answer.room is not None and answer.room.name == "Kitchen"


def test_rooms_of_two_maps_are_kept_apart() -> None:
    first, second = flat(), with_two_rooms(make_map("other"))
    assert second.plan is not None
    renamed = tuple(replace(room, id=f"other-{room.id}") for room in second.plan.rooms)
    doors = tuple(replace(door, rooms=("other-room-l", "other-room-k")) for door in second.plan.doors[:1])
    second = replace(second, plan=replace(second.plan, rooms=renamed, doors=doors))
    estimator = estimator_of(first, second)
    estimator.on_candidates([seen(1.0, pose(5.0, 0.2), map_id="other")])
    answer = estimator.answer(SECOND)
    assert answer.room is not None and answer.room.id == "other-room-k"
    assert answer.map_id == "other"


@pytest.mark.parametrize("unit", [1.0, 7.0])
def test_a_position_drawn_into_a_wall_counts_to_the_room_beside_it(unit: float) -> None:
    view = RoomView.of(two_rooms(unit))
    assert view is not None
    in_wall, in_room, outside, far_off = [6.0, 1.55], [6.0, 1.0], [7.9, 0.0], [90.0, -90.0]
    p = np.array([[*xy, 0.0] for xy in (in_wall, in_room, outside, far_off)]) * unit
    inside, tied = view.shares(p)
    np.testing.assert_array_equal(inside, [0.0, 0.5])
    np.testing.assert_array_equal(tied, [0.0, 0.5])


def test_a_doorway_reaches_half_a_metre_into_both_rooms_and_not_round_the_corner() -> None:
    view = RoomView.of(two_rooms())
    assert view is not None
    for x, y, rooms in ((2.6, 0.0, 2), (3.4, 0.0, 2), (2.3, 0.0, 1), (2.8, 1.3, 1)):
        _, tied = view.shares(np.array([[x, y, 0.0]]))
        assert tied.sum() == rooms, (x, y)


def test_a_map_without_a_plan_keeps_its_part_of_what_is_lost() -> None:
    maps = [flat(), make_map("cellar")]
    views = [MapView.of(place_map) for place_map in maps]
    found = RoomReporter(views, BeliefConfig()).probabilities(Belief((), lost=0.8, unmapped=0.2), [])
    places = [len(place_map.places) for place_map in maps]
    assert found.inside.sum() == pytest.approx(0.8 * places[0] / sum(places))
    np.testing.assert_allclose(found.inside, found.inside[0])  # two rooms of the same size


def test_a_doorway_is_looked_for_where_the_room_is_and_not_in_another_map() -> None:
    """Two doors lead from one room to the other; what the belief's heaviest part means is a position elsewhere."""
    plan = two_rooms()
    second = replace(plan.doors[0], id="door-far", ends=np.array([[3.0, 0.25], [3.0, 0.35]]))
    maps = [replace(flat(), plan=replace(plan, doors=(plan.doors[0], second))), make_map("cellar")]
    views = [MapView.of(place_map) for place_map in maps]
    parts = [(0, 0.124, 0.3)] * 7 + [(1, 0.132, 0.0)]
    drawn = [(hypothesis(index, weight, y), np.array([[2.8, y, 0.0], [3.2, y, 0.0]])) for index, weight, y in parts]
    belief = Belief(tuple(h for h, _ in drawn), lost=0.0, unmapped=0.0)
    answer = RoomReporter(views, BeliefConfig()).answer(belief, drawn)
    assert answer.room is not None and answer.doorway == "door-far"
