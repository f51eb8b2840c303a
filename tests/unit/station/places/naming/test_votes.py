"""What views, places and rooms vote for, and whether a probability made of votes means what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import FloatArray, IntArray
from station.model.floor_plan import PlanEdits
from station.model.place_map import PlaceMap
from station.places.naming.room_words import RoomWord, RoomWords
from station.places.naming.votes import Votes, read_votes, suggestions_by_votes, temperature_weights
from station.places.rooms.planning import with_plan, with_suggestions_of
from tests.support.coloured_rooms import GREY, coloured_rooms

WORDS = RoomWords((RoomWord("Kitchen"), RoomWord("Bedroom"), RoomWord("Living room", ("Lounge",))))
KITCHEN, BEDROOM, LIVING, NOTHING = np.eye(4) * 0.96 + 0.01


def seen(*votes: FloatArray) -> Votes:
    return Votes(np.arange(len(votes)), np.array(votes))


def named(place_map: PlaceMap, **names: str) -> PlaceMap:
    """With rooms (room_l, room_k) named by a person."""
    by_id = {id.replace("_", "-"): name for id, name in names.items()}
    assert place_map.plan is not None
    rooms = tuple(replace(room, name=by_id.get(room.id, room.name)) for room in place_map.plan.rooms)
    return replace(place_map, plan=replace(place_map.plan, rooms=rooms), plan_edits=PlanEdits(names=by_id))


def test_a_room_is_called_what_its_places_vote_for_however_often_one_was_looked_at() -> None:
    """One place was looked at ten times, the two others once each."""
    flat = coloured_rooms([[GREY]], [[GREY] * 10, [GREY], [GREY]])
    votes = seen(LIVING, *[BEDROOM] * 10, KITCHEN, KITCHEN)
    assert flat.plan is not None
    (found,) = suggestions_by_votes(flat, flat.plan, votes, WORDS, "colours.onnx")
    assert (found.room, found.name, found.source) == ("room-k", "Kitchen", "model")
    assert found.keyframe_index in (11, 12)
    assert "12 pictures of 3 places" in found.reason and "Nobody knows yet how good it is" in found.reason


def test_a_view_votes_for_a_place_with_the_share_of_it_that_it_shows() -> None:
    flat = coloured_rooms([[GREY]], [[GREY]])
    landmarks = flat.navigation.landmarks
    both = replace(  # the first view shows three of its own landmark's observations and one of the other place
        landmarks,
        observed_landmark=np.array([0, 0, 0, 1, 1]),
        observed_keyframe=np.array([0, 0, 0, 0, 1]),
        observed_uv_px=np.zeros((5, 2)),
    )
    flat = replace(flat, navigation=replace(flat.navigation, landmarks=both))
    share, of_places = seen(LIVING, KITCHEN).of_places(flat)
    np.testing.assert_allclose(share, [[0.75, 0.0], [0.25, 1.0]])
    np.testing.assert_allclose(of_places[1], (0.25 * LIVING + KITCHEN) / 1.25)


def test_a_model_that_nobody_knows_is_believed_by_half_and_more_once_it_was_right() -> None:
    flat = coloured_rooms([[GREY]], [[GREY]])
    assert flat.plan is not None
    votes = seen(LIVING, KITCHEN)
    (unknown,) = suggestions_by_votes(flat, flat.plan, votes, WORDS, "m")
    assert 0.3 < unknown.confidence < 0.65
    known = named(flat, room_l="Lounge")
    assert known.plan is not None
    (sure,) = suggestions_by_votes(known, known.plan, votes, WORDS, "m")
    assert sure.confidence > unknown.confidence + 0.1 and "1 of 1" in sure.reason
    wrong = named(flat, room_l="Bedroom")
    assert wrong.plan is not None
    (doubted,) = suggestions_by_votes(wrong, wrong.plan, votes, WORDS, "m")
    assert doubted.confidence < 0.35 and "0 of 1" in doubted.reason


def test_a_room_gets_the_name_that_its_places_vote_for_wherever_their_landmarks_lie() -> None:
    """One looks through the door: the place is one of the kitchen, what it shows lies in the living room."""
    flat = coloured_rooms([[GREY]], [[GREY]])
    landmarks = flat.navigation.landmarks
    through = replace(landmarks, p_world=np.array([[1.0, 0.0, 0.3], [1.0, 0.1, 0.3]]))
    flat = replace(flat, navigation=replace(flat.navigation, landmarks=through))
    assert flat.plan is not None
    found = suggestions_by_votes(flat, flat.plan, seen(NOTHING, KITCHEN), WORDS, "m")
    kept = with_suggestions_of(flat, "model", found).suggestions
    assert [(s.room, s.name) for s in kept] == [("room-k", "Kitchen")]


def test_what_speaks_for_two_names_alike_suggests_both_and_counts_half() -> None:
    flat = coloured_rooms([[GREY]], [[GREY]])
    assert flat.plan is not None
    either = (KITCHEN + BEDROOM) / 2
    both = suggestions_by_votes(flat, flat.plan, seen(NOTHING, either), WORDS, "m")
    assert [(s.room, s.name) for s in both] == [("room-k", "Kitchen"), ("room-k", "Bedroom")]
    assert both[0].confidence == pytest.approx(both[1].confidence) and both[0].confidence < 0.5
    known = named(flat, room_k="Bedroom")
    assert known.plan is not None
    (found,) = suggestions_by_votes(known, known.plan, seen(KITCHEN, either), WORDS, "m")
    assert "it knows 0.5 of 1" in found.reason
    undecided = (KITCHEN + NOTHING) / 2
    assert suggestions_by_votes(flat, flat.plan, seen(NOTHING, undecided), WORDS, "m") == ()


def test_many_rooms_that_a_model_does_not_know_leave_its_votes_worth_nothing() -> None:
    truth = np.tile([0, 1, 2], 200)  # 0.25 to the 600th is no number any more
    wrong = np.array([KITCHEN, BEDROOM, LIVING])[(truth + 1) % 3]
    weights = temperature_weights(wrong, truth)
    np.testing.assert_allclose(weights, [0, 0, 0, 0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(read_votes(KITCHEN, weights), 0.25, atol=1e-6)


def test_rooms_that_a_person_named_and_rooms_without_a_view_get_none() -> None:
    flat = named(coloured_rooms([[GREY]], [[GREY]]), room_k="Anna")
    assert flat.plan is not None
    assert suggestions_by_votes(flat, flat.plan, seen(LIVING, KITCHEN), WORDS, "m") == ()
    unseen = coloured_rooms([[GREY]], [])
    assert unseen.plan is not None
    (found,) = suggestions_by_votes(unseen, unseen.plan, seen(KITCHEN), WORDS, "m")
    assert found.room == "room-l"


def test_views_that_show_no_room_name_none() -> None:
    flat = coloured_rooms([[GREY]], [[GREY]])
    assert flat.plan is not None
    assert suggestions_by_votes(flat, flat.plan, seen(NOTHING, NOTHING), WORDS, "m") == ()


def test_a_suggestion_is_no_surer_than_the_plan_is_and_stays_beside_those_of_other_sources() -> None:
    flat = coloured_rooms([[GREY]], [[GREY]])
    assert flat.plan is not None
    doubtful = replace(flat.plan, rooms=tuple(replace(room, certainty=0.5) for room in flat.plan.rooms))
    votes = seen(LIVING, KITCHEN)
    (sure,) = suggestions_by_votes(flat, flat.plan, votes, WORDS, "m")
    (found,) = suggestions_by_votes(flat, doubtful, votes, WORDS, "m")
    assert found.confidence == pytest.approx(0.5 * sure.confidence)
    both = with_suggestions_of(with_plan(flat, flat.plan), "sticker", [replace(sure, source="sticker")])
    both = with_suggestions_of(both, "model", [sure])
    again = with_suggestions_of(both, "model", [replace(sure, confidence=0.2)])
    assert [(s.source, s.confidence) for s in again.suggestions] == [("model", 0.2), ("sticker", sure.confidence)]


def drawn(rng: np.random.Generator, rooms: int, temperature: float, unseen: float) -> tuple[FloatArray, IntArray]:
    """Votes (R, 5) for rooms of made-up truth (R,): each is there as often as the vote at this temperature says.

    Of a share of rooms the model has no word; their truth is 5, and they look like any other.
    """
    votes = np.concatenate([rng.dirichlet(np.full(4, 0.4), rooms), np.full((rooms, 1), 1e-3)], axis=1)
    votes /= votes.sum(axis=1, keepdims=True)
    odds = votes ** (1 / temperature)
    truth = np.array([rng.choice(5, p=p) for p in odds / odds.sum(axis=1, keepdims=True)])
    return votes, np.where(rng.random(rooms) < unseen, 5, truth)


@pytest.mark.parametrize(("unseen", "most"), [(0.0, 0.02), (0.1, 0.05)])
def test_what_is_said_to_be_probable_is_right_as_often_whether_the_model_is_good_or_worthless(
    unseen: float, most: float
) -> None:
    """Half of 2000 models are worthless, as the prior has it, the others too bold or too timid by up to eight times.

    That is more than the temperatures tried, and none of them. Eight rooms of each are named. What cannot be known
    from these: that a room is of a kind that the model has no word for.
    """
    rng = np.random.default_rng(20)
    said, right, as_voted = [], [], []
    for model in range(2000):
        votes, truth = drawn(rng, 40, np.inf if model % 2 else float(8 ** rng.uniform(-1, 1)), unseen)
        known = np.flatnonzero(truth[:8] < 5)
        p = read_votes(votes[8:], temperature_weights(votes[known], truth[known]))
        said.append(p.max(axis=1))
        as_voted.append(votes[8:].max(axis=1))
        right.append(p.argmax(axis=1) == truth[8:])
    p_said, is_right = np.concatenate(said), np.concatenate(right)
    bins = np.digitize(p_said, np.linspace(0, 1, 11))
    gaps = [(float((bins == b).mean()), abs(p_said[bins == b].mean() - is_right[bins == b].mean())) for b in set(bins)]
    assert sum(share * gap for share, gap in gaps) < most
    assert abs(np.concatenate(as_voted).mean() - is_right.mean()) > 0.15  # what it is like without
