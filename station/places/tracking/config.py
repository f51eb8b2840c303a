"""The numbers of the current place that are chosen; what was fitted lies in `fitted.json`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from station.places.tracking.fitted import FittedOdds, read_fitted


@dataclass(frozen=True, slots=True)
class BeliefConfig:
    """Probabilities are per independent view, distances in metres."""

    fitted: FittedOdds = field(default_factory=read_fitted)
    known_from: float = 0.80  # probability of the answer being right, ties within 10 % of distance included
    unknown_from: float = 0.5
    prior_unmapped: float = 0.4  # of a robot that was just put down somewhere
    other_room_per_m: float = 0.25  # rooms are some 4 m wide
    carried_per_s: float = 1e-4  # by somebody, elsewhere: once in three hours
    unfelt: float = 0.01  # of the times that a robot on wheels is: no sensor feels it
    false_localization_floor: float = 0.02
    deceived_again: float = 0.5  # of the wrong images: deceived by what deceived an earlier one, at a pose that fits it
    memory_s: float = 15.0  # landmarks and views that come again within this time are nothing new
    same_landmarks: float = 0.02  # weight of an image that recognises nothing new
    informative_features: int = 60  # an image with fewer says nothing about where it was taken
    new_view_rad: float = 0.2  # a view that changed by this much fails independently of the last one
    # Odometry's error is a random walk, and beside it there is what wheels and gyro are wrongly calibrated by.
    walk_m_per_root_m: float = 0.04
    walk_rad_per_root_rad: float = 0.006
    drift: float = 0.01  # share of the way and of the turn
    slip: float = 0.05  # probability that the wheels did not roll, or not on: blocked, on a cable, pushed
    blind_speed_m_s: float = 0.3  # how fast a robot on wheels may go while nothing measures it
    blind_turn_rad_s: float = 0.5
    carried: float = 4.0  # times as fast without wheels, in somebody's hands
    pose_floor_m: float = 0.04  # map errors that no image's covariance knows
    pose_floor_rad: float = 0.03
    max_hypotheses: int = 8
    jump_m: float = 1.0  # two believed positions this far apart are a jump
    jump_rad: float = 0.7

    @property
    def prior_lost(self) -> float:
        """Of a robot that was just put down somewhere: in a map."""
        return 1.0 - self.prior_unmapped

    @property
    def unnoticed_move_per_s(self) -> float:
        return self.unfelt * self.carried_per_s

    def for_rig(self, has_wheels: bool, has_imu: bool) -> BeliefConfig:
        """For what carries the sensors. What moves in somebody's hands all the time feels nothing special."""
        if has_wheels:
            return self if has_imu else replace(self, unfelt=1.0)
        return replace(
            self,
            unfelt=1.0,
            blind_speed_m_s=self.carried * self.blind_speed_m_s,
            blind_turn_rad_s=self.carried * self.blind_turn_rad_s,
        )
