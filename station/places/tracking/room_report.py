"""A belief's room: the one that holds most of it, also while it is open which of its places is the nearest.

Where two parts of one room look alike the place is not known and the room is; the same holds between two places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.place_answer import RoomCandidate
from station.places.tracking.belief import Belief, Hypothesis
from station.places.tracking.config import BeliefConfig
from station.places.tracking.map_view import MapView
from station.places.tracking.room_view import RoomView

MAX_CANDIDATES = 4
EITHER = 0.1  # of two rooms that it is surely one of, each is as probable at least
Drawn = tuple[Hypothesis, FloatArray]  # a hypothesis, and (n, 3) positions in its map that it may mean


@dataclass(frozen=True, slots=True, eq=False)
class RoomProbabilities:
    """Over the rooms of all maps, in order."""

    inside: FloatArray  # (R,)
    tie: FloatArray  # (R,) in it, or in a doorway of it
    recognised: FloatArray  # (R,) as `inside`, without what is mere prior: somewhere in a map
    apart: FloatArray  # (R,) weight of the hypotheses that lie mostly in it


@dataclass(frozen=True, slots=True)
class RoomAnswer:
    """What an answer says of the room."""

    map_index: int | None = None  # of `room`
    room: RoomCandidate | None = None
    alternatives: tuple[RoomCandidate, ...] = ()
    one_of_two: tuple[RoomCandidate, ...] = ()
    doorway: str | None = None  # id of the door
    is_rivalled: bool = False  # another pose, in another room, is possible, too: nothing is known


def _prior(maps: Sequence[MapView]) -> FloatArray:
    """(R,) how probable each room is for a robot that is lost in the maps: in a large one rather than in a small one.

    Maps share it as they do where places are reported, by the number of their places; one without rooms keeps its part.
    """
    places = sum(len(view.centroids) for view in maps)
    parts = [
        len(view.centroids) / max(places, 1) * view.rooms.area / max(view.rooms.area.sum(), 1e-9)
        for view in maps
        if view.rooms is not None
    ]
    return np.concatenate([np.zeros(0), *parts])


class RoomReporter:
    """Rooms of beliefs over the active maps."""

    def __init__(self, maps: Sequence[MapView], config: BeliefConfig) -> None:
        self._maps = maps
        self._views: list[RoomView | None] = [view.rooms for view in maps]
        sizes = [0 if view is None else len(view.area) for view in self._views]
        self._first = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self._prior = _prior(maps)
        self._config = config

    def probabilities(self, belief: Belief, drawn: Sequence[Drawn]) -> RoomProbabilities:
        """How probable each room is: as a place's, only where the map knows its way.

        A plan goes on into a room that was looked into through a door it did not find.
        """
        inside, tie, apart = np.zeros((3, self._first[-1]))
        for h, p_map in drawn:
            view = self._views[h.map_index]
            if view is not None:
                known = self._maps[h.map_index].reach.knows(p_map)
                if not known.any():
                    continue
                within, tied = known.mean() * np.array(view.shares(p_map[known]))
                part = slice(self._first[h.map_index], self._first[h.map_index + 1])
                inside[part] += h.weight * within
                tie[part] += h.weight * tied
                if within.any():
                    apart[self._first[h.map_index] + int(np.argmax(within))] += h.weight
        lost = belief.lost * self._prior
        return RoomProbabilities(inside + lost, tie + lost, inside, apart)

    def answer(self, belief: Belief, drawn: Sequence[Drawn]) -> RoomAnswer:
        """The room where one is probable enough, and what else it may be."""
        found = self.probabilities(belief, drawn)
        order = np.argsort(-found.inside, kind="stable")[:MAX_CANDIDATES]
        order = order[found.inside[order] > 0]
        candidates = tuple(self._candidate(int(i), float(found.tie[i])) for i in order)
        is_right = found.tie[order] >= self._config.known_from
        is_between = len(order) > 1 and bool(is_right[1])  # in a doorway both are right
        pair = self._surely_one_of(found.recognised)
        here = order[: 2 if is_between else 1]
        rivals = np.setdiff1d(np.flatnonzero(found.apart >= EITHER), here)
        is_rivalled = bool(len(pair)) and bool(len(rivals))
        is_third = bool(len(np.setdiff1d(rivals, pair)))  # another one is possible, too: of this map, or of another
        two = () if is_third else tuple(self._candidate(int(i), float(found.recognised[i])) for i in pair)
        # In a map of one room a robot that is lost in it is there, too: but nobody recognised it.
        if is_rivalled or belief.localised <= 0.5 or not len(order) or not is_right[0]:
            return RoomAnswer(alternatives=candidates, one_of_two=two, is_rivalled=is_rivalled)
        map_index, room = self._located(int(order[0]))
        doorway = None
        if is_between:
            other_map, other = self._located(int(order[1]))
            view, in_map = self._views[map_index], [one for one in drawn if one[0].map_index == map_index]
            if other_map == map_index and view is not None and in_map:
                _, p_map = max(in_map, key=lambda one: one[0].weight)
                doorway = view.door_between(room, other, p_map.mean(axis=0))
        return RoomAnswer(map_index, candidates[0], candidates[1:], doorway=doorway)

    def _surely_one_of(self, recognised: FloatArray) -> IntArray:
        """Numbers of the two rooms that are together as probable as one has to be; or none."""
        two = np.argsort(-recognised, kind="stable")[:2]
        if len(two) < 2 or recognised[two[1]] < EITHER or recognised[two].sum() < self._config.known_from:
            return two[:0]
        return two

    def _candidate(self, number: int, probability: float) -> RoomCandidate:
        map_index, index = self._located(number)
        view = self._views[map_index]
        assert view is not None
        room = view.plan.rooms[index]
        return RoomCandidate(room.id, room.name, min(1.0, probability))

    def _located(self, number: int) -> tuple[int, int]:
        """Map and room of a number in `RoomProbabilities`."""
        map_index = int(np.searchsorted(self._first, number, side="right")) - 1
        return map_index, number - int(self._first[map_index])
