"""The current place, live: a Bayesian estimate over the places of the active maps, plus "unmapped".

Hypotheses are: the robot moves in a map at a tracked pose (several of these), it is somewhere in a map ("lost"), or
where no map knows ("unmapped"). Verified images multiply their weights, failed attempts are evidence for "unmapped",
odometry carries poses between images, a hijack sends their weight to "lost" and "unmapped". The place is the one whose
centroid is nearest to the robot (thesis 4.4, step 7), averaged over the position's uncertainty.
docs/localisation.md explains the likelihoods.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, IntArray, inverse, so3_log
from station.model.place_answer import Localization, PlaceAnswer, PlaceCandidate
from station.model.place_map import Place, PlaceMap
from station.places.tracking.belief import BeliefConfig, Hypothesis, begun_anew, blurred, grown
from station.places.tracking.coverage import Coverage
from station.places.tracking.likelihoods import USUAL_SUPPORT, Shown, support
from station.places.tracking.map_view import MapView
from station.places.tracking.weighing import Measured, Weights, weighed, weighed_failure

HISTORY = 600  # odometry poses kept, so that an image localised late still meets its own moment: 20 s at 30 Hz
SAMPLES = 200  # positions drawn per hypothesis
TIE = 1.1  # centroids within 10 % of the nearest distance count as equally near
NO_IMAGE_BEFORE = 0.5  # that it failed is as good as that it did not
ODOMETRY_GAP_S = 1.0  # after a longer silence, odometry is treated as absent


@dataclass(frozen=True, slots=True, eq=False)
class _OdometryPose:
    t_robot_ns: int
    T_nav_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Everything the answer is made from; `place` and `unmapped` sum to one."""

    place: FloatArray  # (P,) over the places of all maps, in order
    tie: FloatArray  # (P,) that the place is nearest or within a tie of it
    unmapped: float
    beyond: float  # share of `unmapped` at poses that are known, but where the map does not reach
    lost: float  # share of `place` that is mere prior: somewhere in a map


@dataclass(frozen=True, slots=True)
class Jump:
    """The robot is where it cannot have driven: somebody moved it, or it was somewhere else all the time."""

    distance_m: float
    is_other_map: bool


class CurrentPlaceEstimator:
    """Fed with events in any order of arrival; answers for a time. No clock, no I/O."""

    def __init__(
        self,
        maps: PlaceMap | Sequence[PlaceMap],
        calibration: Calibration | None = None,
        config: BeliefConfig | None = None,
        seed: int = 0,
    ) -> None:
        """`calibration`: of the robot that drives now; by default that of the first map's navigation."""
        given = (maps,) if isinstance(maps, PlaceMap) else tuple(maps)
        self.config = config or BeliefConfig()
        self._maps = tuple(MapView.of(m) for m in given)
        self._index = {m.id: i for i, m in enumerate(given)}
        self._camera = (calibration or given[0].navigation.calibration).camera if given else None
        self._T_cam_body = self._camera.T_cam_body_matrix if self._camera else np.eye(4)
        self._draws = np.random.default_rng(seed).standard_normal((SAMPLES, 3))
        self._hypotheses: list[Hypothesis] = []
        self._lost, self._unmapped = self.config.prior_lost, self.config.prior_unmapped
        self._odometry: deque[_OdometryPose] = deque(maxlen=HISTORY)
        self._segment = 0
        self._t_ns: int | None = None  # up to which time the hypotheses were carried
        self._last_view: _OdometryPose | None = None  # of the last image that was evidence
        self._failed_before = NO_IMAGE_BEFORE
        self._numbers = count(1)
        self._believed: Hypothesis | None = None  # where the robot was known to be
        self._hijack_reason = ""

    def regroup(self, maps: PlaceMap | Sequence[PlaceMap]) -> None:
        """The same maps with other places or names. What is known of the robot's pose stays."""
        given = (maps,) if isinstance(maps, PlaceMap) else tuple(maps)
        self._maps = tuple(view.regrouped(m) for view, m in zip(self._maps, given, strict=True))

    # -- events ---------------------------------------------------------------------------------------------------

    def on_odometry(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int = 0) -> None:
        """A pose of the running navigation. A new `segment` means tracking was lost in between: a new frame."""
        if self._odometry and t_robot_ns <= self._odometry[-1].t_robot_ns:
            return
        previous = self._odometry[-1] if self._odometry else None
        self._odometry.append(_OdometryPose(t_robot_ns, T_nav_body))
        if previous is None or segment != self._segment:
            self._segment = segment
            self._change_frame(t_robot_ns, previous, T_nav_body)
            return
        seconds = (t_robot_ns - previous.t_robot_ns) / 1e9
        distance, turn = _motion(previous.T_nav_body, T_nav_body)
        if seconds > ODOMETRY_GAP_S:
            self._hypotheses = [blurred(h, seconds, self.config) for h in self._hypotheses]
        self._hypotheses = [grown(h, distance, turn, seconds, self.config) for h in self._hypotheses]
        self._wander(distance)
        self._carry(t_robot_ns)

    def on_localization(self, localization: Localization, t_robot_ns: int | None = None) -> Jump | None:
        """A verified pose of an image; `t_robot_ns`: its time in the odometry's clock, where that differs."""
        return self.on_candidates((localization,), t_robot_ns)

    def on_candidates(self, candidates: Sequence[Localization], t_robot_ns: int | None = None) -> Jump | None:
        """The verified poses of one image, the best first: of look-alikes at most one is true.

        Returns the jump when the belief went over to where the robot cannot have driven.
        """
        ours = [z for z in candidates if z.map_id in self._index]
        if not ours:
            return None
        t = ours[0].t_robot_ns if t_robot_ns is None else t_robot_ns
        self._advance(t)
        T_nav_body = self._nav_body_at(t)
        freshness = self._freshness(t, T_nav_body, at_least=self.config.same_view)
        before = Weights(self._hypotheses, self._lost, self._unmapped)
        after = weighed([self._measured(z) for z in ours], before, T_nav_body, freshness, self._numbers, self.config)
        self._hypotheses, self._lost, self._unmapped = after.hypotheses, after.lost, after.unmapped
        self._normalise()
        self._last_view = _OdometryPose(t, T_nav_body)
        self._failed_before = 0.0
        return self._believe(T_nav_body)

    def on_failure(self, t_robot_ns: int, num_features: int | None = None) -> None:
        """An image that could not be localised. With few features (dark, covered, a white wall) it says nothing."""
        c = self.config
        self._advance(t_robot_ns)
        if num_features is not None and num_features < c.informative_features:
            return
        features = c.informative_features if num_features is None else num_features
        T_nav_body = self._nav_body_at(t_robot_ns)
        freshness = self._freshness(t_robot_ns, T_nav_body, at_least=0.0)  # not found again in the same view: no news
        before = Weights(self._hypotheses, self._lost, self._unmapped)
        in_view = [self._in_view(h, T_nav_body) for h in self._hypotheses]
        after = weighed_failure(before, in_view, features, self._failed_before, freshness, c)
        self._hypotheses, self._lost, self._unmapped = after.hypotheses, after.lost, after.unmapped
        self._normalise()
        self._last_view = _OdometryPose(t_robot_ns, T_nav_body)
        self._failed_before = 1.0

    def on_hijack(self, t_robot_ns: int, reason: str, confidence: float = 0.98) -> None:
        """The robot was picked up: what was known of its position counts `1 - confidence`."""
        self._advance(t_robot_ns)
        c = self.config
        known = sum(h.weight for h in self._hypotheses) * confidence
        known += (self._lost + self._unmapped) * confidence
        self._hypotheses = [begun_anew(h, 1 - confidence) for h in self._hypotheses]
        self._lost = self._lost * (1 - confidence) + known * c.prior_lost
        self._unmapped = self._unmapped * (1 - confidence) + known * c.prior_unmapped
        self._normalise()
        self._last_view, self._failed_before = None, NO_IMAGE_BEFORE
        self._believed = None
        self._hijack_reason = reason

    # -- answers --------------------------------------------------------------------------------------------------

    def belief(self) -> Belief:
        """The probabilities now."""
        sizes = [len(m.centroids) for m in self._maps]
        first = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        place, tie = np.zeros(first[-1]), np.zeros(first[-1])
        unmapped, beyond = self._unmapped, 0.0
        T_nav_body = self._nav_body_at(self._t_ns or 0)
        for h in self._hypotheses:
            view = self._maps[h.map_index]
            nearest, tied, covered = self._spread(view, h.pose(T_nav_body)[:3, 3], h.sigma_m)
            if not len(nearest):
                unmapped += h.weight
                continue
            part = slice(first[h.map_index], first[h.map_index + 1])
            place[part] += h.weight * covered * nearest
            tie[part] += h.weight * covered * tied
            beyond += h.weight * (1 - covered)
        if len(place):
            place += self._lost / len(place)
            tie += self._lost / len(place)
        else:
            unmapped += self._lost
        return Belief(place, tie, float(unmapped + beyond), float(beyond), self._lost)

    def answer(self, t_robot_ns: int) -> PlaceAnswer:
        """The current place at this time, or at the last event's where that is later; its `t_robot_ns` says which.

        An image takes a while to be recognised; odometry has come in meanwhile, and the robot has driven on.
        """
        self._advance(t_robot_ns)
        t_robot_ns = max(t_robot_ns, self._t_ns or t_robot_ns)
        belief = self.belief()
        order = largest(belief.place, 4)
        candidates = [self._candidate(int(i), float(belief.tie[i])) for i in order]
        # In a map of one place a robot that is lost in it is there, too: but nobody recognised it.
        is_recognised = sum(h.weight for h in self._hypotheses) > 0.5
        is_known = is_recognised and bool(len(order)) and belief.tie[order[0]] >= self.config.known_from
        known_in = self._located(int(order[0]))[0] if is_known else None
        # Where the place is known, its distance is to a position in its own map.
        among = [h for h in self._hypotheses if known_in is None or h.map_index == known_in]
        best = max(among, key=lambda h: h.weight, default=None)
        p_body = None if best is None else best.pose(self._nav_body_at(t_robot_ns))[:3, 3]
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
            )
        is_localized = best is not None and best.weight > 0.5
        is_unknown = (
            not len(order)
            or belief.unmapped >= self.config.unknown_from
            or (is_localized and self._doubts_only_the_map(belief))
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
            reason=self._reason(is_unknown, belief, best),
            map_id=map_id,
        )

    def _place(self, number: int) -> Place:
        """By its number in a `Belief`."""
        map_index, place_index = self._located(number)
        return self._maps[map_index].place_map.places[place_index]

    def _located(self, number: int) -> tuple[int, int]:
        """Map and place of a number in a `Belief`: over the places of all maps, in order."""
        for map_index, view in enumerate(self._maps):
            if number < len(view.place_map.places):
                return map_index, number
            number -= len(view.place_map.places)
        raise IndexError(number)

    def _candidate(self, number: int, probability: float) -> PlaceCandidate:
        place = self._place(number)
        return PlaceCandidate(place.id, place.name, probability)

    def _doubts_only_the_map(self, belief: Belief) -> bool:
        """Were the position surely in the map, so was the place: what is open is where the map ends."""
        clearest = float(belief.tie.max())
        return clearest >= self.config.known_from * (1 - belief.unmapped) and 2 * belief.beyond >= 1 - clearest

    def _reason(self, is_unknown: bool, belief: Belief, best: Hypothesis | None) -> str:
        if not len(belief.place):
            return "the active maps hold no places"
        if is_unknown:
            if best is not None and best.weight > 0.5:
                return "the robot is farther from where the mapping drive went than the map is sure to reach"
            return f"images match nothing in the map ({belief.unmapped:.0%} that this place is not in it)"
        if best is not None and best.weight > 0.5 and belief.tie.max() < self.config.known_from * best.weight:
            return "the robot is between places, or its position has become too uncertain"
        if self._hijack_reason:
            return f"hijacked ({self._hijack_reason}) and not recognised again yet"
        if sum(h.weight for h in self._hypotheses) > 0.5:
            return "images fit several parts of the map that look alike"
        if self._believed is not None:
            return "images do not agree with where the robot was last recognised"
        return "no image has been recognised yet"

    # -- numbers --------------------------------------------------------------------------------------------------

    def _spread(self, view: MapView, p_body: FloatArray, sigma_m: float) -> tuple[FloatArray, FloatArray, float]:
        """Shares (P,) of drawn positions nearest to each place, those within a tie, and the share that is mapped."""
        c = self.config
        if not len(view.centroids):
            return np.zeros(0), np.zeros(0), 0.0
        spread = self._draws * np.array([1.0, 1.0, 0.2]) * min(sigma_m, 20.0) * view.unit
        p = p_body + spread
        share, tied = view.nearest(p, TIE)
        covered = float(view.covered(p, c).mean())
        return share, tied, covered

    def _believe(self, T_nav_body: FloatArray) -> Jump | None:
        """Note the hypothesis that has nearly all weight; a jump when it is another one than before, and elsewhere."""
        c = self.config
        best = max(self._hypotheses, key=lambda h: h.weight, default=None)
        if best is None or best.weight < c.believed_from:
            return None
        before, self._believed = self._believed, best
        self._hijack_reason = ""  # found again
        if before is None or before.number == best.number:
            return None
        if before.map_index != best.map_index:
            return Jump(0.0, is_other_map=True)
        distance, turn = _motion(before.pose(T_nav_body), best.pose(T_nav_body))
        distance_m = distance / best.unit
        return Jump(distance_m, is_other_map=False) if distance_m > c.jump_m or turn > c.jump_rad else None

    def _measured(self, z: Localization) -> Measured:
        index = self._index[z.map_id]
        view = self._maps[index]
        sigma_m = float(np.hypot(z.sigma_position / view.unit, self.config.pose_floor_m))
        shown = Shown(z.extent / view.unit, z.num_inliers, self._support(z, view.coverage), z.num_features)
        return Measured(z, index, view, z.T_map_cam @ self._T_cam_body, sigma_m, shown)

    def _support(self, z: Localization, coverage: Coverage) -> float:
        """The share of the landmarks that should be in view at a measured pose that were recognised there."""
        if self._camera is None or not coverage.knows_views:
            return USUAL_SUPPORT
        return support(coverage.in_usual_views(len(z.landmarks)), coverage.in_view(z.T_map_cam, self._camera))

    def _in_view(self, h: Hypothesis, T_nav_body: FloatArray) -> float | None:
        """How many landmarks should be in view, were a hypothesis true (`Coverage.in_view`); None: nobody knows."""
        c = self.config
        if self._camera is None or h.sigma_m > c.uncertain_m or h.sigma_rad > c.uncertain_rad:
            return None
        T_map_cam = h.pose(T_nav_body) @ self._camera.T_body_cam_matrix
        return self._maps[h.map_index].coverage.in_view(T_map_cam, self._camera)

    def _freshness(self, t_robot_ns: int, T_nav_body: FloatArray, at_least: float) -> float:
        """Weight 0..1 of an image as evidence: `at_least` while it shows what the last one showed."""
        c = self.config
        if self._last_view is None:
            return 1.0
        distance, turn = _motion(self._last_view.T_nav_body, T_nav_body)
        moved = distance / c.new_view_m + turn / c.new_view_rad
        if not self._odometry:
            moved = c.same_view_per_s * max(0.0, (t_robot_ns - self._last_view.t_robot_ns) / 1e9)
        return float(np.clip(moved, at_least, 1.0))

    def _advance(self, t_robot_ns: int) -> None:
        """Carry the hypotheses to a time: without odometry they blur."""
        if self._t_ns is not None and t_robot_ns > self._t_ns:
            silent_since = self._odometry[-1].t_robot_ns if self._odometry else self._t_ns
            before = max(0.0, (self._t_ns - silent_since) / 1e9 - ODOMETRY_GAP_S)
            after = max(0.0, (t_robot_ns - silent_since) / 1e9 - ODOMETRY_GAP_S)
            if not self._odometry:
                before, after = 0.0, (t_robot_ns - self._t_ns) / 1e9
            if after > before:
                self._hypotheses = [blurred(h, after - before, self.config) for h in self._hypotheses]
        self._carry(t_robot_ns)

    def _wander(self, distance_m: float) -> None:
        """A robot of which nobody knows where it is may drive out of the map, or into it."""
        c = self.config
        left = 1 - float(np.exp(-c.other_room_per_m * distance_m))
        in_either = self._lost + self._unmapped
        self._lost += left * (c.prior_lost * in_either - self._lost)
        self._unmapped += left * (c.prior_unmapped * in_either - self._unmapped)

    def _carry(self, t_robot_ns: int) -> None:
        """Let time pass for the weights: the robot may have been moved without anyone noticing."""
        if self._t_ns is None:
            self._t_ns = t_robot_ns
            return
        seconds = (t_robot_ns - self._t_ns) / 1e9
        if seconds <= 0:
            return
        self._t_ns = t_robot_ns
        c = self.config
        stay = float(np.exp(-c.unnoticed_move_per_s * seconds))
        moved = sum(h.weight for h in self._hypotheses) * (1 - stay)
        self._hypotheses = [replace(h, weight=h.weight * stay) for h in self._hypotheses]
        self._lost += moved * c.prior_lost
        self._unmapped += moved * c.prior_unmapped

    def _change_frame(self, t_robot_ns: int, previous: _OdometryPose | None, T_nav_body: FloatArray) -> None:
        """Odometry starts, or starts again, in another frame: poses stay where they were, blurred by the gap."""
        before = previous.T_nav_body if previous else np.eye(4)
        gap_s = max(0.0, (t_robot_ns - (previous.t_robot_ns if previous else (self._t_ns or t_robot_ns))) / 1e9)
        self._hypotheses = [
            blurred(h.moved_to(h.pose(before), T_nav_body), gap_s, self.config) for h in self._hypotheses
        ]
        if self._believed is not None:
            self._believed = self._believed.moved_to(self._believed.pose(before), T_nav_body)
        last = self._odometry[-1]
        self._odometry.clear()
        self._odometry.append(last)
        self._last_view, self._failed_before = None, NO_IMAGE_BEFORE
        self._carry(t_robot_ns)

    def _nav_body_at(self, t_robot_ns: int) -> FloatArray:
        """The odometry pose nearest in time; identity without odometry."""
        if not self._odometry:
            return np.eye(4)
        if t_robot_ns >= self._odometry[-1].t_robot_ns:
            return self._odometry[-1].T_nav_body
        times = np.array([o.t_robot_ns for o in self._odometry])
        return self._odometry[int(np.argmin(np.abs(times - t_robot_ns)))].T_nav_body

    def _normalise(self) -> None:
        total = self._lost + self._unmapped + sum(h.weight for h in self._hypotheses)
        if total <= 0:  # every explanation was ruled out at once: start over
            self._hypotheses = []
            self._lost, self._unmapped = self.config.prior_lost, self.config.prior_unmapped
            return
        kept = sorted(self._hypotheses, key=lambda h: -h.weight)[: self.config.max_hypotheses]
        kept = [h for h in kept if h.weight > 1e-9 * total]
        total = self._lost + self._unmapped + sum(h.weight for h in kept)
        self._hypotheses = [replace(h, weight=h.weight / total) for h in kept]
        self._lost, self._unmapped = self._lost / total, self._unmapped / total


def largest(values: FloatArray, how_many: int) -> IntArray:
    """Numbers of the largest values, largest first, of equals the first one. Sorting all costs a large map 1 ms."""
    left = values.copy()
    found: list[int] = []
    while len(found) < min(how_many, len(values)):
        found.append(int(np.argmax(left)))
        left[found[-1]] = -np.inf
    return np.array(found, dtype=np.int64)


def _motion(T_before: FloatArray, T_after: FloatArray) -> tuple[float, float]:
    """Distance and turn between two poses."""
    T = inverse(T_before) @ T_after
    return float(np.linalg.norm(T[:3, 3])), float(np.linalg.norm(so3_log(T[:3, :3])))
