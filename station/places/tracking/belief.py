"""Numbers behind the current place: one hypothesis of where the robot is, and how odometry and images change it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, inverse, se3, so3_exp, so3_log
from station.places.localisation.recognised import NOTHING, Recognised
from station.places.tracking.likelihoods import (
    FAILS_AT_POSE,
    FAILS_IN_MAP,
    FAILS_UNMAPPED,
    RIGHT,
    UNMAPPED,
    Failing,
    Recognising,
)


@dataclass(frozen=True, slots=True)
class BeliefConfig:
    """Rates and likelihoods. Probabilities are per independent view, distances in metres."""

    # Of the answer being right, ties within 10 % of distance included. On 62 development drives 43 of 43 answers
    # between 0.85 and 0.9 were right, 21 of 22 between 0.8 and 0.85 (docs/studies/current-place.md).
    known_from: float = 0.85
    unknown_from: float = 0.5
    prior_unmapped: float = 0.4  # of a robot that was just put down somewhere
    prior_lost: float = 0.6
    other_room_per_m: float = 0.25  # rooms are some 4 m wide
    unnoticed_move_per_s: float = 1e-4  # picked up without any sensor noticing: once in three hours
    # What tells a right pose from a look-alike, and how much rarer an image that shows this is in a room that no map
    # knows. Measured, as is how often nothing is recognised: docs/localisation.md, `likelihoods.py`.
    right: Recognising = RIGHT
    unmapped: Recognising = UNMAPPED
    false_localization_floor: float = 0.02
    deceived_again: float = 0.5  # of the wrong images: deceived by what deceived an earlier one, at a pose that fits it
    landmark_memory_s: float = 15.0  # landmarks seen again within this time are no new evidence
    fails_at_pose: Failing = FAILS_AT_POSE
    fails_in_map: Failing = FAILS_IN_MAP  # at a pose that nobody knows
    fails_unmapped: Failing = FAILS_UNMAPPED
    uncertain_m: float = 1.0  # at a pose as uncertain as this, nobody knows what is in view
    uncertain_rad: float = 0.5  # ... turned by this, another view: without odometry after a second
    informative_features: int = 60  # an image with fewer says nothing about where it was taken
    new_view_rad: float = 0.2  # turning or driving this far makes an image independent of the last one
    new_view_m: float = 0.3
    same_view: float = 0.03  # weight of the evidence of an unchanged view
    same_landmarks: float = 0.02  # ... of an image that recognises nothing new
    same_view_per_s: float = 0.25  # without odometry: how fast views become independent
    # What the map reaches: all within `surely_covered_m` of the mapping drive's path, and up to `covered_m` what has
    # nearly as many recognisable views as the path itself (`Coverage.views`). Along second drives through simulated
    # flats 101 and 102, 0.3 m and more off the path: 0.81 to 1 at 95 % of the positions in mapped rooms, and below
    # 0.67 at 95 % of those in unmapped rooms. Corners of mapped rooms where nobody drove are no better than doorways.
    covered_m: float = 1.0
    covered_softness_m: float = 0.15
    surely_covered_m: float = 0.4
    surely_covered_softness_m: float = 0.04
    covered_views: float = 0.72
    covered_views_softness: float = 0.02
    # Odometry's error is a random walk: reckoned by gyro and commanded speed, 46 drives (flats 101 to 112, 200, 203,
    # 204, 310 to 312) err per axis by 0.015 m over 0.15 m, 0.028 over 0.6, 0.054 over 2.2 and 0.058 over 4.4 m; turning
    # on the spot by 0.02 m; the heading by 0.005 to 0.013 rad. Beside it there is what wheels and gyro are wrongly
    # calibrated by: that adds up, and is a guess; with it and the heading's, a pose known exactly is taken to be
    # 0.04 m off after 0.6 m, 0.09 after 2.2 and 0.14 after 4.4: too much by half there, and twice and a half.
    walk_m_per_root_m: float = 0.04
    walk_m_per_root_rad: float = 0.015
    walk_rad_per_root_rad: float = 0.006
    walk_rad_per_root_m: float = 0.006
    drift_per_m: float = 0.01
    drift_rad_per_rad: float = 0.003
    drift_per_s: float = 0.001
    blind_speed_m_s: float = 0.3  # how fast the robot may go where nothing tells
    blind_turn_rad_s: float = 0.5
    pose_floor_m: float = 0.04  # map errors that no image's covariance knows
    pose_floor_rad: float = 0.03
    max_hypotheses: int = 8
    believed_from: float = 0.9  # weight of a hypothesis that counts as where the robot is
    jump_m: float = 1.0  # two believed positions this far apart are a jump
    jump_rad: float = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """The robot moves in this map, and its navigation's frame lies there by this transform."""

    map_index: int
    T_map_nav: FloatArray  # (4, 4) rigid, map units
    unit: float  # map units per metre: odometry is in metres
    sigma_m: float  # position, per axis
    sigma_rad: float  # heading
    weight: float
    evidence_t_robot_ns: int
    evidence_keyframe: int
    inliers: int
    number: int = 0  # stays when the hypothesis is moved, so that one can be told from another
    recognised: Recognised = NOTHING
    credited: float = 0.0  # log odds that were counted for what is recognised
    look_alike: float = 1.0  # were the robot elsewhere: probability that a look-alike, not the way here, told of it

    def pose(self, T_nav_body: FloatArray) -> FloatArray:
        """T_map_body (4, 4) for an odometry pose in metres."""
        return self.T_map_nav @ in_units(T_nav_body, self.unit)

    def moved_to(self, T_map_body: FloatArray, T_nav_body: FloatArray) -> Hypothesis:
        """The hypothesis whose pose is T_map_body while odometry says T_nav_body."""
        return replace(self, T_map_nav=T_map_body @ inverse(in_units(T_nav_body, self.unit)))


def in_units(T: FloatArray, unit: float) -> FloatArray:
    """A motion in metres as one in map units."""
    out = T.copy()
    out[:3, 3] *= unit
    return out


def grown(h: Hypothesis, distance_m: float, turn_rad: float, seconds: float, c: BeliefConfig) -> Hypothesis:
    """The hypothesis after odometry moved it: noise adds up in squares, wrong calibration and heading linearly."""
    walk_m = c.walk_m_per_root_m**2 * distance_m + c.walk_m_per_root_rad**2 * turn_rad
    walk_rad = c.walk_rad_per_root_m**2 * distance_m + c.walk_rad_per_root_rad**2 * turn_rad
    sigma_m = float(np.sqrt(h.sigma_m**2 + walk_m)) + (c.drift_per_m + 0.5 * h.sigma_rad) * distance_m
    sigma_m += c.drift_per_s * seconds
    sigma_rad = float(np.sqrt(h.sigma_rad**2 + walk_rad)) + c.drift_rad_per_rad * turn_rad
    return replace(h, sigma_m=sigma_m, sigma_rad=min(sigma_rad, np.pi))


def blurred(h: Hypothesis, seconds: float, c: BeliefConfig) -> Hypothesis:
    """The hypothesis after a time without odometry."""
    sigma_rad = min(h.sigma_rad + c.blind_turn_rad_s * seconds, np.pi)
    return replace(h, sigma_m=h.sigma_m + c.blind_speed_m_s * seconds, sigma_rad=sigma_rad)


def begun_anew(h: Hypothesis, share: float) -> Hypothesis:
    """The hypothesis with this share of its weight when the robot was picked up: put down again, it is recognised anew.

    Where the robot was, no look-alike deceived; that one did is as probable as that the robot was not here.
    """
    return replace(
        h, weight=h.weight * share, recognised=NOTHING, credited=0.0, look_alike=h.look_alike * (1 - h.weight)
    )


# Errors of right candidates have long tails: 5 to 19 % of those with fewer than 120 inliers lie beyond four standard
# deviations (689 images, docs/studies/current-place.md). So they are taken to follow Student's t.
FREEDOM = 3.0


@dataclass(frozen=True, slots=True)
class Agreement:
    """How a measured pose fits a hypothesis."""

    squared: float  # Mahalanobis, 4 degrees of freedom (position, heading)
    density: float  # against a uniform one over the map

    @property
    def doubt(self) -> float:
        """How many times larger the measurement's variance is taken for: 1 for one that fits."""
        return max(1.0, (FREEDOM + self.squared) / (FREEDOM + 3.0))


def agreement(
    T_expected: FloatArray,
    T_measured: FloatArray,
    sigma_m: float,
    sigma_rad: float,
    map_area_m2: float,
    unit: float,
) -> Agreement:
    """Compare poses. Height and tilt of a robot on a floor carry no choice, so the density counts x, y and heading."""
    gap = (T_measured[:3, 3] - T_expected[:3, 3]) / unit
    turn = float(np.linalg.norm(so3_log(T_expected[:3, :3].T @ T_measured[:3, :3])))
    squared = float(gap @ gap) / sigma_m**2 + turn**2 / sigma_rad**2
    uniform = 1.0 / (max(map_area_m2, 1.0) * 2 * np.pi)
    peak = 1.0 / ((2 * np.pi) ** 1.5 * sigma_m**2 * sigma_rad)
    return Agreement(squared, max(peak / uniform, 1.0) * (1.0 + squared / FREEDOM) ** (-0.5 * (FREEDOM + 3.0)))


def fused(T_expected: FloatArray, T_measured: FloatArray, gain_position: float, gain_heading: float) -> FloatArray:
    """Between the expected and the measured pose, by Kalman gains 0..1."""
    turn = so3_log(T_expected[:3, :3].T @ T_measured[:3, :3])
    R = T_expected[:3, :3] @ so3_exp(gain_heading * turn)
    t = T_expected[:3, 3] + gain_position * (T_measured[:3, 3] - T_expected[:3, 3])
    return se3(R, t)
