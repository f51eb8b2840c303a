"""What is believed of where the robot is: hypotheses with weights, and how motion and measurements change one of them.

`filter.py` has the steps over all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse, median_radius, se3, slerp
from station.model.place_answer import Localization
from station.places.tracking.alike import UNRIVALLED, Alike
from station.places.tracking.config import BeliefConfig

SAME_POSE = 36.0  # squared Mahalanobis distance: 6 sigma; tails are long
FREEDOM = 3.0  # of Student's t: errors of right poses have longer tails than a normal density


@dataclass(frozen=True, slots=True, eq=False)
class Recognised:
    """Landmarks of one map that were recognised lately.

    A piece of furniture that looks like another one deceives every image of it, also when it comes into view bit by
    bit. So images do not count one by one: what counts is how large all is that they recognised together.
    """

    seen: Mapping[int, int]  # landmark -> robot time, ns, when it was recognised last

    def lately(self, t_robot_ns: int, memory_s: float) -> Recognised:
        """Those recognised less than `memory_s` before this time."""
        forgotten = t_robot_ns - round(memory_s * 1e9)
        return Recognised({landmark: t for landmark, t in self.seen.items() if t > forgotten})

    def and_then(self, landmarks: IntArray, t_robot_ns: int) -> Recognised:
        """With these (n,) too; images may come late."""
        return self | Recognised(dict.fromkeys(landmarks.tolist(), t_robot_ns))

    def __or__(self, other: Recognised) -> Recognised:
        both = {**self.seen, **other.seen}
        return Recognised({k: max(t, self.seen.get(k, t)) for k, t in both.items()})

    def share_of_new(self, landmarks: IntArray) -> float:
        """Share of landmarks (n,) that are not among these; 1 if there are none."""
        return sum(k not in self.seen for k in landmarks.tolist()) / len(landmarks) if len(landmarks) else 1.0

    def extent(self, p_map: FloatArray, cell: float) -> float:
        """Median distance of the landmarks from their middle, or of one per cell, in the units of `p_map` (L, 3).

        The larger one. Of all of them it is the size of what has most corners: after a chest of drawers, whatever
        stands beside it would count for nothing. Of one per cell it is that of what takes most room: so would what
        stands between two prints.
        """
        if not self.seen:
            return 0.0
        p = p_map[np.fromiter(self.seen, np.int64, len(self.seen))]
        _, first_of_each = np.unique(np.floor(p / cell), axis=0, return_index=True)
        return max(median_radius(p), median_radius(p[first_of_each]))


NOTHING = Recognised({})


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """A verified pose of an image, in the terms of the filter."""

    localization: Localization
    map_index: int
    unit: float  # map units per metre
    T_map_body: FloatArray  # (4, 4) map units
    sigma_m: float
    sigma_rad: float  # heading


@dataclass(frozen=True, slots=True)
class Agreement:
    """How a measured pose fits a hypothesis."""

    squared: float  # Mahalanobis, 4 degrees of freedom (position, heading)
    density: float  # against a uniform one over the map
    slipped: bool = False  # it fits better, should the wheels have slipped

    @property
    def doubt(self) -> float:
        """How many times larger the measurement's variance is taken for: 1 for one that fits."""
        return max(1.0, (FREEDOM + self.squared) / (FREEDOM + 3.0))


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """The robot moves in this map, and its navigation's frame lies there by this transform."""

    map_index: int
    T_map_nav: FloatArray  # (4, 4) rigid, map units
    unit: float  # map units per metre: odometry is in metres
    sigma_m: float  # position, per axis
    sigma_rad: float  # heading
    weight: float
    evidence_t_robot_ns: int  # of the last image that was recognised here, and the map's keyframe most like it
    evidence_keyframe: int
    inliers: int
    number: int = 0  # stays when the hypothesis is moved: by it one is known from another
    recognised: Recognised = NOTHING
    counted_log_odds: float = 0.0  # how much was counted already for what is recognised
    way_m: float = 0.0  # of odometry since then: should the wheels have slipped, the pose is wrong by as much
    look_alike: float = 1.0  # probability, were the robot elsewhere, that a look-alike gave this pose
    alike: Alike = UNRIVALLED

    @classmethod
    def started(
        cls, m: PoseMeasurement, T_nav_body: FloatArray, weight: float, counted: float, number: int
    ) -> Hypothesis:
        """A new hypothesis: the robot is where this measurement has it."""
        z = m.localization
        return cls(
            map_index=m.map_index,
            T_map_nav=_nav_in_map(m.T_map_body, T_nav_body, m.unit),
            unit=m.unit,
            sigma_m=m.sigma_m,
            sigma_rad=m.sigma_rad,
            weight=weight,
            evidence_t_robot_ns=z.t_robot_ns,
            evidence_keyframe=z.keyframe_index,
            inliers=z.num_inliers,
            number=number,
            recognised=NOTHING.and_then(z.landmarks, z.t_robot_ns),
            counted_log_odds=counted,
        )

    def pose(self, T_nav_body: FloatArray) -> FloatArray:
        """T_map_body (4, 4) for an odometry pose in metres."""
        return self.T_map_nav @ _in_units(T_nav_body, self.unit)

    def moved_to(self, T_map_body: FloatArray, T_nav_body: FloatArray) -> Hypothesis:
        """The hypothesis whose pose is T_map_body while odometry says T_nav_body."""
        return replace(self, T_map_nav=_nav_in_map(T_map_body, T_nav_body, self.unit))

    def grown(self, distance_m: float, turn_rad: float, c: BeliefConfig) -> Hypothesis:
        """After odometry moved it: noise adds up in squares, wrong calibration and heading linearly."""
        walk_m = c.walk_m_per_root_m**2 * distance_m
        walk_rad = c.walk_rad_per_root_rad**2 * turn_rad
        sigma_m = float(np.sqrt(self.sigma_m**2 + walk_m)) + (c.drift + 0.5 * self.sigma_rad) * distance_m
        sigma_rad = float(np.sqrt(self.sigma_rad**2 + walk_rad)) + c.drift * turn_rad
        return replace(self, sigma_m=sigma_m, sigma_rad=min(sigma_rad, np.pi), way_m=self.way_m + distance_m)

    def blurred(self, seconds: float, c: BeliefConfig) -> Hypothesis:
        """After a time without odometry."""
        sigma_rad = min(self.sigma_rad + c.blind_turn_rad_s * seconds, np.pi)
        return replace(self, sigma_m=self.sigma_m + c.blind_speed_m_s * seconds, sigma_rad=sigma_rad)

    def begun_anew(self, share: float) -> Hypothesis:
        """With this share of its weight, after the robot was picked up: put down here again, it is recognised anew.

        What deceived before deceives at the same pose again only if nobody carried the robot.
        """
        return replace(
            self,
            weight=self.weight * share,
            recognised=NOTHING,
            counted_log_odds=0.0,
            look_alike=self.look_alike * share,
            alike=UNRIVALLED,
        )

    @property
    def slipped_sigma_m(self) -> float:
        """Its position's uncertainty, should the wheels have slipped since it was corrected last."""
        return float(np.hypot(self.sigma_m, self.way_m))

    def corrected(
        self, m: PoseMeasurement, fit: Agreement, T_nav_body: FloatArray, counted: float, c: BeliefConfig
    ) -> Hypothesis:
        """After a measurement that it expected: a Kalman update. `counted`: log odds of its image."""
        sigma_m, doubt = (self.slipped_sigma_m if fit.slipped else self.sigma_m), fit.doubt
        gain = sigma_m**2 / (sigma_m**2 + doubt * m.sigma_m**2)
        gain_heading = self.sigma_rad**2 / (self.sigma_rad**2 + doubt * m.sigma_rad**2)
        z = m.localization
        before = self.recognised.lately(z.t_robot_ns, c.memory_s)
        recognised = before.and_then(z.landmarks, z.t_robot_ns)
        T_map_body = _between(self.pose(T_nav_body), m.T_map_body, gain, gain_heading)
        return replace(
            self.moved_to(T_map_body, T_nav_body),
            # Errors of the map are the same in every image: no number of images averages them away.
            sigma_m=max(float(np.sqrt(1 - gain)) * sigma_m, c.pose_floor_m),
            sigma_rad=max(float(np.sqrt(1 - gain_heading)) * self.sigma_rad, c.pose_floor_rad),
            evidence_t_robot_ns=z.t_robot_ns,
            evidence_keyframe=z.keyframe_index,
            inliers=z.num_inliers,
            recognised=recognised,
            counted_log_odds=(self.counted_log_odds if before.seen else 0.0) + counted,
            look_alike=1.0,
            way_m=0.0,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Where the robot may be; all weights together sum to one."""

    hypotheses: tuple[Hypothesis, ...]  # at a tracked pose, one of these
    lost: float  # somewhere in a map
    unmapped: float  # where no map knows

    @property
    def localised(self) -> float:
        """Weight of all hypotheses."""
        return sum(h.weight for h in self.hypotheses)


def _nav_in_map(T_map_body: FloatArray, T_nav_body: FloatArray, unit: float) -> FloatArray:
    """T_map_nav (4, 4) of a robot at T_map_body (map units) while odometry says T_nav_body (metres)."""
    T_nav_body_units = _in_units(T_nav_body, unit)
    return T_map_body @ inverse(T_nav_body_units)


def _in_units(T: FloatArray, unit: float) -> FloatArray:
    """A motion in metres as one in map units."""
    out = T.copy()
    out[:3, 3] *= unit
    return out


def _between(T_expected: FloatArray, T_measured: FloatArray, gain_position: float, gain_heading: float) -> FloatArray:
    """Between the expected and the measured pose, by Kalman gains 0..1."""
    R = slerp(T_expected[:3, :3], T_measured[:3, :3], gain_heading)
    t = T_expected[:3, 3] + gain_position * (T_measured[:3, 3] - T_expected[:3, 3])
    return se3(R, t)
