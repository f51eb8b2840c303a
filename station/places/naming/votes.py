"""What many views say a place and its room is, and how sure one may be of that.

Each view votes for what it shows, with the share of its landmarks that lie in a place. A place's vote is the mean of
its views', a room's the mean of its places': the views of one spot are alike, so many of them say no more than a few.

Such a mean does not mean what it says: by averaging it is too timid, by the model's mistakes too bold. How a model's
votes are to be read is therefore learned from rooms that a person named (temperature scaling: Guo et al., ICML 2017;
for pooled votes Ranjan and Gneiting, JRSS B 72, 2010). Few rooms are named, so temperatures are weighed and none is
chosen. Of a model that nobody knows it is as likely as not that its votes mean nothing (an infinite temperature).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.naming.looks import softmax
from station.places.naming.room_words import RoomWords

TEMPERATURES = np.array([0.25, 0.5, 1.0, 2.0, 4.0, np.inf])  # much sharper, as voted, much flatter; votes for nothing
PRIOR = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.5])
UNTRIED = "Nobody knows yet how good it is: name a room or two and run it again"
LEAST_VOTE = 1e-6  # for any word: a view rules none out


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """What a model says of some of a map's pictures."""

    keyframe_index: IntArray  # (V,)
    p: FloatArray  # (V, W + 1) for each word, and last for none of them; rows sum to 1

    def of_places(self, place_map: PlaceMap) -> tuple[FloatArray, FloatArray]:
        """(P, V) the share of each view that shows each place, and (P, W + 1) the places' votes; zero without views."""
        share = _shown(place_map, self.keyframe_index)
        total = share.sum(axis=1, keepdims=True)
        return share, np.divide(share @ self.p, total, out=np.zeros((len(share), self.p.shape[1])), where=total > 0)


def suggestions_by_votes(
    place_map: PlaceMap, plan: FloorPlan, votes: Votes, words: RoomWords, model: str
) -> tuple[NameSuggestion, ...]:
    """The likeliest name of each room that no person named, unless its views show nothing that speaks for a room.

    All that are equally likely: the thing that speaks for one may speak for the other, as a toilet does. `words` are
    those that were voted for: a room that a person called otherwise says nothing of the model. `model`: what a person
    calls it.
    """
    share, of_places = votes.of_places(place_map)
    if not plan.rooms:
        return ()
    rooms_places = [
        [
            n
            for n, place in enumerate(place_map.places)
            if plan.room_of_place.get(place.id) == room.id and share[n].any()
        ]
        for room in plan.rooms
    ]
    of_rooms = np.array([of_places[rows].mean(axis=0) if rows else np.zeros(votes.p.shape[1]) for rows in rooms_places])
    named = {n: number for n, number in _named_rooms(place_map, plan, words) if rooms_places[n]}
    weights = temperature_weights(of_rooms[list(named)], np.array(list(named.values()), dtype=np.int64))
    says = {n: _likeliest(of_rooms[n]) for n in named}
    right = sum((number in says[n]) / len(says[n]) for n, number in named.items())  # one of two counts half
    record = f"Of the rooms named here it knows {round(right, 1):g} of {len(named)}" if named else UNTRIED
    found = []
    for room, rows, vote in zip(plan.rooms, rooms_places, of_rooms, strict=True):
        if not rows or room.id in place_map.plan_edits.names:
            continue
        p = read_votes(vote, weights)
        likeliest = _likeliest(p)
        if len(words.rooms) in likeliest or words.number_of(room.name) in likeliest:
            continue
        shown = share[rows].sum(axis=0)
        found += [
            NameSuggestion(
                room=room.id,
                name=(name := words.rooms[word].name),
                source="model",
                confidence=float(p[word]) * room.certainty,
                reason=f"{model} gives {vote[word]:.0%} of the votes of {_count(int((shown > 0).sum()), 'picture')} "
                f"of {_count(len(rows), 'place')} to {name}. {record}.",
                keyframe_index=int(votes.keyframe_index[(shown * votes.p[:, word]).argmax()]),
            )
            for word in likeliest
        ]
    return tuple(found)


def temperature_weights(votes: FloatArray, truth: IntArray) -> FloatArray:
    """(T,) how probable each of TEMPERATURES is, by votes (R, W + 1) for rooms and the numbers (R,) of their names."""
    log_likelihood = [np.log(_tempered(votes, T)[np.arange(len(votes)), truth]).sum() for T in TEMPERATURES]
    return softmax(np.log(PRIOR) + np.array(log_likelihood))


def read_votes(votes: FloatArray, weights: FloatArray) -> FloatArray:
    """(…, W + 1) probabilities of votes (…, W + 1), over the weighed temperatures."""
    return np.asarray(sum(w * _tempered(votes, T) for w, T in zip(weights, TEMPERATURES, strict=True)))


def _tempered(votes: FloatArray, temperature: float) -> FloatArray:
    return softmax(np.log(np.maximum(votes, LEAST_VOTE)) / temperature)


def _likeliest(p: FloatArray) -> list[int]:
    """Which of p (W + 1,) are the largest: several where they differ by no more than rounding."""
    return [int(n) for n in np.flatnonzero(np.isclose(p, p.max()))]


def _named_rooms(place_map: PlaceMap, plan: FloorPlan, words: RoomWords) -> list[tuple[int, int]]:
    """(number of the room, number of its word) of the rooms that a person called by one of the words."""
    by_person = place_map.plan_edits.names
    numbers = [(n, words.number_of(room.name)) for n, room in enumerate(plan.rooms) if room.id in by_person]
    return [(n, number) for n, number in numbers if number is not None]


def _shown(place_map: PlaceMap, keyframe_index: IntArray) -> FloatArray:
    """(P, V) how much of what each view shows lies in each place, of the landmarks that it observed."""
    landmarks, places = place_map.navigation.landmarks, place_map.places
    place_of = np.full(len(landmarks), len(places))
    for n, place in enumerate(places):
        place_of[place.landmark_index] = n
    view_of = np.full(len(place_map.navigation.keyframes), -1)
    view_of[keyframe_index] = np.arange(len(keyframe_index))
    view = view_of[landmarks.observed_keyframe]
    rows = np.flatnonzero(view >= 0)
    counts = np.zeros((len(places) + 1, len(keyframe_index)))
    np.add.at(counts, (place_of[landmarks.observed_landmark[rows]], view[rows]), 1.0)
    return np.asarray(counts[:-1] / np.maximum(counts.sum(axis=0), 1.0))


def _count(number: int, word: str) -> str:
    return f"{number} {word}" + ("" if number == 1 else "s")
