"""The numbers of the current place: measured rates, thresholds, and how odometry errs."""

from __future__ import annotations

from dataclasses import dataclass, replace

# The values of its figures at which an image has the odds called `usual` below: what the coefficients are counted
# from, not what is most frequent. The median image there has 670 features.
USUAL_FEATURES = 400
USUAL_EXTENT_M = 0.1
USUAL_INLIERS = 50
USUAL_SUPPORT = 0.2


@dataclass(frozen=True, slots=True)
class RecognisedOdds:
    """Log odds by the figures of a verified pose, linear in their logarithms against the usual values."""

    usual: float
    extent: float
    inliers: float
    support: float
    features: float


@dataclass(frozen=True, slots=True)
class FailureOdds:
    """Log odds that an image is not recognised, linear in the logarithms of what it depends on."""

    usual: float  # after an image that was recognised
    features: float
    again: float  # the image before was not recognised
    in_view: float = 0.0


# Fitted by `python -m benchmarks.fit_place_likelihoods`; docs/studies/places_notes.md names the drives and the losses.
RIGHT = RecognisedOdds(-0.51, extent=2.86, inliers=0.49, support=1.78, features=-1.54)
UNMAPPED = RecognisedOdds(-1.71, extent=0.51, inliers=-1.43, support=0.17, features=2.03)
FAILS_AT_POSE = FailureOdds(-2.83, features=-0.84, again=1.68, in_view=-0.81)
FAILS_IN_MAP = FailureOdds(-1.67, features=-1.15, again=2.17)
FAILS_UNMAPPED = FailureOdds(-0.01, features=-1.62, again=2.48)


@dataclass(frozen=True, slots=True)
class BeliefConfig:
    """Rates and likelihoods. Probabilities are per independent view, distances in metres."""

    # Of the answer being right, ties within 10 % of distance included.
    known_from: float = 0.85
    unknown_from: float = 0.5
    prior_unmapped: float = 0.4  # of a robot that was just put down somewhere
    prior_lost: float = 0.6
    other_room_per_m: float = 0.25  # rooms are some 4 m wide
    unnoticed_move_per_s: float = 1e-4  # picked up without any sensor noticing: once in three hours
    # What separates a right pose from a look-alike's, and how much rarer an image with these figures is in a room that
    # no map knows.
    right: RecognisedOdds = RIGHT
    unmapped: RecognisedOdds = UNMAPPED
    false_localization_floor: float = 0.02
    deceived_again: float = 0.5  # of the wrong images: deceived by what deceived an earlier one, at a pose that fits it
    landmark_memory_s: float = 15.0  # landmarks that are recognised again within this time are nothing new
    fails_at_pose: FailureOdds = FAILS_AT_POSE
    fails_in_map: FailureOdds = FAILS_IN_MAP  # at a pose that nobody knows
    fails_unmapped: FailureOdds = FAILS_UNMAPPED
    uncertain_m: float = 1.0  # at a pose as uncertain as this, nobody knows what is in view
    uncertain_rad: float = 0.5  # ... turned by this, another view: without odometry after a second
    informative_features: int = 60  # an image with fewer says nothing about where it was taken
    new_view_rad: float = 0.2  # turning or driving this far makes an image independent of the last one
    new_view_m: float = 0.3
    same_view: float = 0.03  # weight of an image of an unchanged view
    same_landmarks: float = 0.02  # ... of an image that recognises nothing new
    same_view_per_s: float = 0.25  # without odometry: how fast views become independent
    # Odometry's error is a random walk, and beside it there is what wheels and gyro are wrongly calibrated by: that
    # adds up, and is a guess.
    walk_m_per_root_m: float = 0.04
    walk_m_per_root_rad: float = 0.015
    walk_rad_per_root_rad: float = 0.006
    walk_rad_per_root_m: float = 0.006
    drift_per_m: float = 0.01
    drift_rad_per_rad: float = 0.003
    drift_per_s: float = 0.001
    blind_speed_m_s: float = 0.3  # how fast a robot on wheels may go while nothing measures it
    blind_turn_rad_s: float = 0.5
    carried_speed_m_s: float = 1.2  # the same of a rig in somebody's hands, who walks
    carried_turn_rad_s: float = 1.5
    pose_floor_m: float = 0.04  # map errors that no image's covariance knows
    pose_floor_rad: float = 0.03
    max_hypotheses: int = 8
    believed_from: float = 0.9  # weight of a hypothesis that counts as where the robot is
    jump_m: float = 1.0  # two believed positions this far apart are a jump
    jump_rad: float = 0.7

    def for_rig(self, has_wheels: bool) -> BeliefConfig:
        """For what carries the sensors."""
        if has_wheels:
            return self
        return replace(self, blind_speed_m_s=self.carried_speed_m_s, blind_turn_rad_s=self.carried_turn_rad_s)
