"""The current place, live: a Bayesian estimate over the places of the active maps, plus "unmapped".

The robot is in a map at a tracked pose (several hypotheses), somewhere in a map ("lost"), or where no map knows
("unmapped"). Every event predicts the belief up to its time; an image then weighs and prunes it (`filter.py`, with the
likelihoods of `image_evidence.py`); a report says which place that is (`report.py`). docs/localisation.md explains it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse, so3_log
from station.model.place_answer import Localization, PlaceAnswer
from station.model.place_map import PlaceMap
from station.motion.head import AHEAD, Aim
from station.places.localisation.tried_pictures import TriedPicture
from station.places.tracking.belief import Belief, Hypothesis
from station.places.tracking.config import BeliefConfig
from station.places.tracking.filter import (
    predict_blind,
    predict_hijack,
    predict_motion,
    predict_new_frame,
    predict_time,
    prior,
    prune,
    weigh,
)
from station.places.tracking.image_evidence import ImageEvidence, ImageLikelihood
from station.places.tracking.map_view import MapView
from station.places.tracking.own_pictures import judged, own_log_odds
from station.places.tracking.report import Past, PlaceProbabilities, Reporter
from station.places.tracking.servos import SureView
from station.places.tracking.views import RecentViews

HISTORY = 600  # odometry poses kept, so that an image localised late still meets its own moment: 20 s at 30 Hz
NO_IMAGE_BEFORE = 0.5  # that it failed is as good as that it did not
SURELY_RIGHT = 0.9  # probability of an image's pose, from which on servos are learned from it,
SURELY_NEAR = 9.0  # ... and its squared Mahalanobis distance from the expected one
ODOMETRY_GAP_S = 1.0  # after a longer silence, odometry is treated as absent


@dataclass(frozen=True, slots=True, eq=False)
class _OdometryPose:
    t_robot_ns: int
    T_nav_body: FloatArray


@dataclass(frozen=True, slots=True)
class Jump:
    """The robot is where it cannot have driven: somebody moved it, or it was somewhere else all the time."""

    distance_m: float
    is_other_map: bool
    moved: float  # probability that somebody moved it


class CurrentPlaceEstimator:
    """Fed with events in any order of arrival; answers for a time. No clock, no I/O."""

    def __init__(
        self,
        maps: Sequence[PlaceMap],
        calibration: Calibration | None = None,
        config: BeliefConfig | None = None,
        seed: int = 0,
        tried: Sequence[Sequence[TriedPicture]] | None = None,
    ) -> None:
        """An estimate of nothing yet.

        Args:
            calibration: of the robot that drives now; by default that of the first map's navigation.
            tried: each map's own pictures.
        """
        if calibration is None and maps:
            calibration = maps[0].navigation.calibration
        self._has_wheels = calibration is None or calibration.has_wheels
        has_imu = calibration is None or calibration.imu is not None
        self.config = (config or BeliefConfig()).for_rig(self._has_wheels, has_imu)
        self._maps = tuple(MapView.of(m) for m in maps)
        self._map_ids = {m.id for m in maps}
        odds = self.config.fitted
        own = [
            own_log_odds(judged(view, pictures), odds.right, odds.usual, odds.tried)
            for view, pictures in zip(self._maps, tried or [()] * len(maps), strict=True)
        ]
        self._evidence = ImageEvidence(self._maps, calibration, self.config, own)
        self._reporter = Reporter(self._maps, self.config, seed)
        self._belief = prior(self.config)
        self._odometry: deque[_OdometryPose] = deque(maxlen=HISTORY)
        self._segment = 0
        self._t_ns: int | None = None  # up to which time the belief is predicted
        self._views = RecentViews(self.config.memory_s)  # of the images that were weighed
        self._failed_before = NO_IMAGE_BEFORE
        self._numbers = count(1)
        self._believed: Hypothesis | None = None  # where the robot was known to be
        self._doubt = 1.0  # the least probability, while it was believed, that it is false
        self._believed_ns = 0  # when it was believed last
        self._hijack_reason = ""
        self.sure_view: SureView | None = None  # of the last image, where its pose was expected and is believed

    def regroup(self, maps: Sequence[PlaceMap]) -> None:
        """The same maps with other places or names. What is known of the robot's pose stays."""
        self._maps = tuple(view.regrouped(m) for view, m in zip(self._maps, maps, strict=True))
        self._reporter.regroup(self._maps)

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
            self._belief = predict_blind(self._belief, seconds, self.config)
        self._belief = predict_motion(self._belief, distance, turn, self.config)
        self._pass_time(t_robot_ns)

    def on_candidates(
        self, candidates: Sequence[Localization], t_robot_ns: int | None = None, aim: Aim = AHEAD
    ) -> Jump | None:
        """The verified poses of one image, the best first: of look-alikes at most one is true.

        `t_robot_ns`: its time in the odometry's clock, where that differs; `aim`: of the camera then. Returns the jump
        when the belief went over to where the robot cannot have driven.
        """
        self.sure_view = None
        ours = [z for z in candidates if z.map_id in self._map_ids]
        if not ours:
            return None
        t = ours[0].t_robot_ns if t_robot_ns is None else t_robot_ns
        self._predict(t)
        T_nav_body = self._nav_body_at(t)
        before = self._belief
        image = self._evidence.of_candidates(ours, before, T_nav_body, aim)
        self._weigh(image, T_nav_body)
        self._views.add(t, T_nav_body @ aim.T_body_head, is_failed=False)
        self._failed_before = 0.0
        jump = self._believe(t, T_nav_body)
        if self._believed is not None and self._believed_ns == t:
            self.sure_view = self._sure_view(self._believed, image, before, T_nav_body, aim)
        if not self._has_wheels:
            self._look_around(ours, t, T_nav_body)
        return jump

    def on_failure(self, t_robot_ns: int, num_features: int | None = None, aim: Aim = AHEAD) -> None:
        """An image that could not be localised. With few features (dark, covered, a white wall) it says nothing."""
        least = self.config.informative_features
        self._predict(t_robot_ns)
        if num_features is not None and num_features < least:
            return
        features = least if num_features is None else num_features
        T_nav_body = self._nav_body_at(t_robot_ns)
        T_nav_head = T_nav_body @ aim.T_body_head
        freshness = self._freshness(t_robot_ns, T_nav_head)
        image = self._evidence.of_failure(features, self._failed_before, self._belief, T_nav_body, freshness, aim)
        self._weigh(image, T_nav_body)
        self._views.add(t_robot_ns, T_nav_head, is_failed=True)
        self._failed_before = 1.0

    def on_hijack(self, t_robot_ns: int, reason: str, confidence: float = 0.98) -> None:
        """The robot was picked up: what was known of its position counts `1 - confidence`."""
        self._predict(t_robot_ns)
        self._belief = prune(predict_hijack(self._belief, confidence, self.config), self.config)
        self._views.clear()
        self._failed_before = NO_IMAGE_BEFORE
        self._believed = None
        self._hijack_reason = reason

    # -- answers --------------------------------------------------------------------------------------------------

    def place_probabilities(self) -> PlaceProbabilities:
        """How probable each place is at the time of the last event."""
        return self._reporter.probabilities(self._belief, self._nav_body_at(self._t_ns or 0))

    def answer(self, t_robot_ns: int) -> PlaceAnswer:
        """The current place at this time, or at the last event's where that is later; its `t_robot_ns` says which.

        An image takes a while to be recognised; odometry has come in meanwhile, and the robot has driven on.
        """
        self._predict(t_robot_ns)
        t_robot_ns = max(t_robot_ns, self._t_ns or t_robot_ns)
        past = Past(self._hijack_reason, was_recognised=self._believed is not None)
        return self._reporter.answer(self._belief, self._nav_body_at(t_robot_ns), t_robot_ns, past)

    # -- steps ----------------------------------------------------------------------------------------------------

    def _predict(self, t_robot_ns: int) -> None:
        """The belief up to a time: without odometry hypotheses blur. An event that comes late changes nothing."""
        blind_s = 0.0
        if self._t_ns is not None:
            silent_since = self._odometry[-1].t_robot_ns if self._odometry else self._t_ns
            before = max(0.0, (self._t_ns - silent_since) / 1e9 - ODOMETRY_GAP_S)
            after = max(0.0, (t_robot_ns - silent_since) / 1e9 - ODOMETRY_GAP_S)
            blind_s = after - before if self._odometry else (t_robot_ns - self._t_ns) / 1e9
        self._pass_time(t_robot_ns, blind_s)

    def _pass_time(self, t_robot_ns: int, blind_s: float = 0.0) -> None:
        if self._t_ns is not None and t_robot_ns > self._t_ns:
            self._belief = predict_time(self._belief, (t_robot_ns - self._t_ns) / 1e9, blind_s, self.config)
        self._t_ns = t_robot_ns if self._t_ns is None else max(t_robot_ns, self._t_ns)

    def _change_frame(self, t_robot_ns: int, previous: _OdometryPose | None, T_nav_body: FloatArray) -> None:
        """Odometry starts, or starts again, in another frame."""
        before = previous.T_nav_body if previous else np.eye(4)
        gap_s = max(0.0, (t_robot_ns - (previous.t_robot_ns if previous else (self._t_ns or t_robot_ns))) / 1e9)
        self._belief = predict_new_frame(self._belief, before, T_nav_body, gap_s, self.config)
        if self._believed is not None:
            self._believed = self._believed.moved_to(self._believed.pose(before), T_nav_body)
        last = self._odometry[-1]
        self._odometry.clear()
        self._odometry.append(last)
        self._views.clear()
        self._failed_before = NO_IMAGE_BEFORE
        self._pass_time(t_robot_ns)

    def _weigh(self, image: ImageLikelihood, T_nav_body: FloatArray) -> None:
        self._belief = prune(weigh(self._belief, image, T_nav_body, self._numbers, self.config), self.config)

    def _believe(self, t_robot_ns: int, T_nav_body: FloatArray) -> Jump | None:
        """Note the hypothesis that has nearly all weight; a jump when it is another one than before, and elsewhere.

        Then either somebody moved the robot and no sensor noticed, or what was believed before had been false.
        """
        c = self.config
        best = max(self._belief.hypotheses, key=lambda h: h.weight, default=None)
        if best is None or best.weight < c.known_from:
            return None
        before, self._believed = self._believed, best
        was_false, since_ns, self._believed_ns = self._doubt, self._believed_ns, t_robot_ns
        is_same = before is not None and before.number == best.number
        self._doubt = min(1 - best.weight, self._doubt) if is_same else 1 - best.weight
        self._hijack_reason = ""  # found again
        if before is None or is_same:
            return None
        unnoticed = -float(np.expm1(-c.unnoticed_move_per_s * max(0, t_robot_ns - since_ns) / 1e9))
        moved = unnoticed / max(unnoticed + was_false, 1e-9)
        if before.map_index != best.map_index:
            return Jump(0.0, True, moved)
        distance, turn = _motion(before.pose(T_nav_body), best.pose(T_nav_body))
        distance_m = distance / best.unit
        return Jump(distance_m, False, moved) if distance_m > c.jump_m or turn > c.jump_rad else None

    def _sure_view(
        self, best: Hypothesis, image: ImageLikelihood, before: Belief, T_nav_body: FloatArray, aim: Aim
    ) -> SureView | None:
        """Which way the head looks, by the candidate that the believed hypothesis expected; None without one.

        Only where the map's vertical is known, from which azimuths are told.
        """
        index = next((i for i, h in enumerate(before.hypotheses) if h.number == best.number), None)
        correction = None if index is None else image.corrects[index]
        if correction is None or correction.fit.slipped or self._maps[best.map_index].floor is None:
            return None
        if correction.probability < SURELY_RIGHT or correction.fit.squared > SURELY_NEAR:
            return None
        m = image.candidates[correction.candidate]
        R_map_head = m.T_map_body[:3, :3] @ aim.T_body_head[:3, :3]
        sigma_rad = float(np.sqrt(max(m.sigma_rad**2 - aim.sigma_rad**2, 0.0)))
        return SureView(R_map_head, sigma_rad, T_nav_body[:3, :3], (best.number, self._segment))

    def _look_around(self, localizations: Sequence[Localization], t_robot_ns: int, T_nav_body: FloatArray) -> None:
        """At a pose that is believed, but where the map does not know its way, what this image saw through is free.

        Not on wheels: a mapping drive has looked along where they go, and what is left is behind doors.
        """
        best = self._believed
        if best is None or self._believed_ns != t_robot_ns:
            return
        view = self._maps[best.map_index]
        if view.reach.knows(best.pose(T_nav_body)[None, :3, 3])[0]:
            return
        for z in localizations:
            if (z.map_id, z.keyframe_index) == (view.place_map.id, best.evidence_keyframe):
                wider = view.looking(z)
                if wider is not view:
                    self._maps = tuple(wider if m is view else m for m in self._maps)
                    self._reporter.regroup(self._maps)
                return

    def _freshness(self, t_robot_ns: int, T_nav_head: FloatArray) -> float:
        """0..1: how far the view is another than the last one and all that failed lately; 1 without odometry."""
        if not self._odometry:
            return 1.0
        return min(self._views.change(t_robot_ns, T_nav_head) / self.config.new_view_rad, 1.0)

    def _nav_body_at(self, t_robot_ns: int) -> FloatArray:
        """The odometry pose nearest in time; identity without odometry."""
        if not self._odometry:
            return np.eye(4)
        if t_robot_ns >= self._odometry[-1].t_robot_ns:
            return self._odometry[-1].T_nav_body
        times = np.array([o.t_robot_ns for o in self._odometry])
        return self._odometry[int(np.argmin(np.abs(times - t_robot_ns)))].T_nav_body


def _motion(T_before: FloatArray, T_after: FloatArray) -> tuple[float, float]:
    """Distance and turn between two poses."""
    T = inverse(T_before) @ T_after
    return float(np.linalg.norm(T[:3, 3])), float(np.linalg.norm(so3_log(T[:3, :3])))
