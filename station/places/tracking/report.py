"""A belief reported: how probable each place is, and the answer with its reason.

The place is the one whose centroid is nearest to the robot (thesis 4.4, step 7), averaged over the position's
uncertainty. Its room is reported beside it (room_report.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.place_answer import PlaceAnswer, PlaceCandidate
from station.model.place_map import Place
from station.places.tracking.belief import Belief, Hypothesis
from station.places.tracking.config import BeliefConfig
from station.places.tracking.map_view import MapView
from station.places.tracking.room_report import Drawn, RoomReporter

SAMPLES = 200  # positions drawn per hypothesis
TIE = 1.1  # centroids within 10 % of the nearest distance count as equally near


@dataclass(frozen=True, slots=True, eq=False)
class PlaceProbabilities:
    """Everything the answer is made from; `place` and `unmapped` sum to one."""

    place: FloatArray  # (P,) over the places of all maps, in order
    tie: FloatArray  # (P,) that the place is nearest or within a tie of it
    unmapped: float
    beyond: float  # share of `unmapped` at poses that are known, but where the map does not reach
    lost: float  # share of `place` that is mere prior: somewhere in a map


@dataclass(frozen=True, slots=True)
class Past:
    """What a reason needs beside the belief."""

    hijack_reason: str  # of a hijack since which the robot was not recognised; else empty
    was_recognised: bool  # before now, and not picked up since


class Reporter:
    """Answers about beliefs over the active maps."""

    def __init__(self, maps: Sequence[MapView], config: BeliefConfig, seed: int = 0) -> None:
        self.config = config
        self._draws = np.random.default_rng(seed).standard_normal((SAMPLES, 3))
        self.regroup(maps)

    def regroup(self, maps: Sequence[MapView]) -> None:
        self._maps = maps
        self._rooms = RoomReporter(maps, self.config)

    def probabilities(self, belief: Belief, T_nav_body: FloatArray) -> PlaceProbabilities:
        """How probable each place is while odometry is at this pose."""
        return self._probabilities(belief, self._drawn(belief, T_nav_body))

    def _probabilities(self, belief: Belief, drawn: Sequence[Drawn]) -> PlaceProbabilities:
        sizes = [len(m.centroids) for m in self._maps]
        first = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        place, tie = np.zeros(first[-1]), np.zeros(first[-1])
        unmapped, beyond = belief.unmapped, 0.0
        for h, p_map in drawn:
            nearest, tied, covered = self._spread(self._maps[h.map_index], p_map)
            if not len(nearest):
                unmapped += h.weight
                continue
            part = slice(first[h.map_index], first[h.map_index + 1])
            place[part] += h.weight * covered * nearest
            tie[part] += h.weight * covered * tied
            beyond += h.weight * (1 - covered)
        if len(place):
            place += belief.lost / len(place)
            tie += belief.lost / len(place)
        else:
            unmapped += belief.lost
        return PlaceProbabilities(place, tie, float(unmapped + beyond), float(beyond), belief.lost)

    def answer(self, belief: Belief, T_nav_body: FloatArray, t_robot_ns: int, past: Past) -> PlaceAnswer:
        """The current place by this belief, at the odometry pose of this time."""
        poses = [h.pose(T_nav_body) for h in belief.hypotheses]
        is_recognised = belief.localised > 0.5
        drawn = self._drawn(belief, T_nav_body)
        found, room = self._probabilities(belief, drawn), self._rooms.answer(belief, drawn)
        order = largest(found.place, 4)
        candidates = [self._place_candidate(int(i), float(found.tie[i])) for i in order]
        # In a map of one place a robot that is lost in it is there, too: but nobody recognised it.
        is_known = is_recognised and bool(len(order)) and found.tie[order[0]] >= self.config.known_from
        is_known &= not room.is_rivalled  # a place is in one of two rooms
        known_in = self._located(int(order[0]))[0] if is_known else room.map_index
        # Where the place is known, its distance is to a position in its own map.
        among = [pair for pair in zip(belief.hypotheses, poses, strict=True) if known_in in (None, pair[0].map_index)]
        best, T_map_body = max(among, key=lambda pair: pair[0].weight, default=(None, None))
        p_body = None if T_map_body is None else T_map_body[:3, 3]
        map_id = None if best is None else self._maps[best.map_index].place_map.id
        if is_known and best is not None and p_body is not None:
            centroid = self._place(int(order[0])).centroid_map
            age_s = max(0.0, (t_robot_ns - best.evidence_t_robot_ns) / 1e9)
            return PlaceAnswer(
                state="known",
                place=candidates[0],
                distance=float(np.linalg.norm(p_body - centroid)),
                position_map=p_body,
                t_robot_ns=t_robot_ns,
                evidence_t_robot_ns=best.evidence_t_robot_ns,
                evidence_keyframe=best.evidence_keyframe,
                inliers=best.inliers,
                alternatives=tuple(candidates[1:]),
                reason=f"{best.inliers} landmarks of the map were recognised"
                + (f"; odometry over the {age_s:.0f} s since" if age_s >= 1.0 else ""),
                map_id=map_id,
                room=room.room,
                room_alternatives=room.alternatives,
                one_of_two=room.one_of_two,
                doorway=room.doorway,
                forward_map=_forward(T_map_body),
                sigma_position=self._sigma(best),
            )
        is_localized = best is not None and best.weight > 0.5
        is_unknown = not room.is_rivalled and (
            not len(order)
            or found.unmapped >= self.config.unknown_from
            or (is_localized and self._doubts_only_the_map(found))
        )
        return PlaceAnswer(
            state="unknown" if is_unknown else "lost",
            place=None,
            distance=None,
            position_map=p_body if is_localized else None,
            t_robot_ns=t_robot_ns,
            evidence_t_robot_ns=best.evidence_t_robot_ns if best else None,
            evidence_keyframe=best.evidence_keyframe if best else None,
            inliers=best.inliers if best else 0,
            alternatives=tuple(candidates),
            reason=self._reason(is_unknown, found, belief, best, past),
            map_id=map_id,
            room=room.room,
            room_alternatives=room.alternatives,
            one_of_two=room.one_of_two,
            doorway=room.doorway,
            forward_map=_forward(T_map_body) if is_localized else None,
            sigma_position=self._sigma(best) if is_localized else None,
        )

    def _drawn(self, belief: Belief, T_nav_body: FloatArray) -> list[Drawn]:
        """Positions that each hypothesis may mean, in its map."""
        return [(h, self._positions(h, h.pose(T_nav_body)[:3, 3])) for h in belief.hypotheses]

    def _positions(self, h: Hypothesis, p_body: FloatArray) -> FloatArray:
        """(SAMPLES, 3)"""
        return np.asarray(p_body + self._draws * np.array([1.0, 1.0, 0.2]) * self._sigma(h))

    def _sigma(self, h: Hypothesis | None) -> float:
        """Of its position, map units."""
        return 0.0 if h is None else min(h.sigma_m, 20.0) * self._maps[h.map_index].unit

    def _spread(self, view: MapView, p_map: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Shares (P,) of drawn positions nearest to each place, those within a tie, and the share that is mapped."""
        if not len(view.centroids):
            return np.zeros(0), np.zeros(0), 0.0
        share, tied = view.nearest(p_map, TIE)
        return share, tied, float(view.reach.knows(p_map).mean())

    def _place(self, number: int) -> Place:
        """By its number in `PlaceProbabilities`."""
        map_index, place_index = self._located(number)
        return self._maps[map_index].place_map.places[place_index]

    def _located(self, number: int) -> tuple[int, int]:
        """Map and place of a number in `PlaceProbabilities`: over the places of all maps, in order."""
        for map_index, view in enumerate(self._maps):
            if number < len(view.place_map.places):
                return map_index, number
            number -= len(view.place_map.places)
        raise IndexError(number)

    def _place_candidate(self, number: int, probability: float) -> PlaceCandidate:
        map_index, place_index = self._located(number)
        place_map = self._maps[map_index].place_map
        place = place_map.places[place_index]
        return PlaceCandidate(place.id, place.name, probability, place_map.room_of(place.id))

    def _doubts_only_the_map(self, found: PlaceProbabilities) -> bool:
        """Were the position surely in the map, so was the place: what is open is where the map ends."""
        clearest = float(found.tie.max())
        return clearest >= self.config.known_from * (1 - found.unmapped) and 2 * found.beyond >= 1 - clearest

    def _reason(
        self, is_unknown: bool, found: PlaceProbabilities, belief: Belief, best: Hypothesis | None, past: Past
    ) -> str:
        if not len(found.place):
            return "the active maps hold no places"
        if is_unknown:
            if best is not None and best.weight > 0.5:
                return "the robot is where the mapping navigation saw no free space, or beyond a door it did not pass"
            return f"images match nothing in the map ({found.unmapped:.0%} that this place is not in it)"
        if best is not None and best.weight > 0.5 and found.tie.max() < self.config.known_from * best.weight:
            return "the robot is between places, or its position has become too uncertain"
        if past.hijack_reason:
            return f"hijacked ({past.hijack_reason}) and not recognised again yet"
        if belief.localised > 0.5:
            return "images fit several parts of the map that look alike"
        if past.was_recognised:
            return "images do not agree with where the robot was last recognised"
        return "no image has been recognised yet"


def _forward(T_map_body: FloatArray | None) -> FloatArray | None:
    """(3,) unit vector along the body's front, whatever the map's scale."""
    return None if T_map_body is None else T_map_body[:3, 0] / np.linalg.norm(T_map_body[:3, 0])


def largest(values: FloatArray, how_many: int) -> IntArray:
    """Numbers of the largest values, largest first, of equals the first one. Sorting all costs a large map 1 ms."""
    left = values.copy()
    found: list[int] = []
    while len(found) < min(how_many, len(values)):
        found.append(int(np.argmax(left)))
        left[found[-1]] = -np.inf
    return np.array(found, dtype=np.int64)
