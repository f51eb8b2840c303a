"""What else is known of the velocity: standing still, wheels, the commanded speed (docs/slam.md, sec. 9)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, homogeneous, orthonormal, skew, so3_exp, so3_log
from station.motion.drive_commands import SPEED_EFFICIENCY
from station.motion.error_coordinates import ErrorKind
from station.motion.preintegration import Preintegration, RolledWay
from station.slam.ukf.filter.state import PHI, XI_V, FilterState
from station.slam.ukf.filter.update import Measurements
from station.vision.klt import TrackedFrame


@dataclass(frozen=True, slots=True, eq=False)
class BodyVelocity:
    """The body moves with v_body, each component known to sigma; infinite where it is not."""

    v_body: FloatArray  # (3,) m/s
    sigma: FloatArray  # (3,) m/s
    by_wheels: FloatArray | None = None  # (3, 2) derivative of v_body by FilterState.wheels
    gate: float = np.inf  # standard deviations; a component further off is left out (wheels that slip)

    def rows(self, state: FilterState, kind: ErrorKind) -> Measurements:
        """Whitened rows; the velocity in the body frame is R^T v."""
        v_now = state.R.T @ state.v
        if kind is ErrorKind.RIGHT:
            by_state = state.R.T @ state.S[XI_V]
        elif kind is ErrorKind.LEFT:
            by_state = state.S[XI_V] + skew(v_now) @ state.S[PHI]
        else:
            by_state = state.R.T @ (state.S[XI_V] + skew(state.v) @ state.S[PHI])
        if self.by_wheels is not None:
            by_state = by_state - self.by_wheels @ state.S[state.wheel_rows]
        known = np.isfinite(self.sigma)
        r = (self.v_body - v_now)[known] / self.sigma[known]
        A = by_state[known] / self.sigma[known, None]
        spread = np.sqrt(1.0 + np.einsum("ik,ik->i", A, A))
        fits = np.abs(r) < self.gate * spread
        return Measurements(r[fits], A[fits])


@dataclass(frozen=True, slots=True, eq=False)
class SamePlace:
    """The head has not moved from one of the clones to the newest; how it turned meanwhile, the image measured."""

    clone_frame: int  # ImageFrame.index of that clone
    R_clone_now: FloatArray  # (3, 3) rotation since then, measured
    sigma_phi: float  # rad
    sigma_x: float  # m

    def rows(self, state: FilterState, kind: ErrorKind) -> Measurements:
        """Whitened rows for rotation and position; none when the clone has left the window."""
        found = np.flatnonzero(state.clone_frame == self.clone_frame)
        if not len(found):
            return Measurements.none(state)
        i = int(found[0])
        rows = state.S[state.clone_rows(i)]
        phi_clone, x_clone = rows[:3], rows[3:]
        now = state.S[state.clone_rows(state.num_clones - 1)]
        phi, x = now[:3], now[3:]
        R_now, x_now = state.clone_R[-1], state.clone_x[-1]
        R_then, x_then = state.clone_R[i], state.clone_x[i]
        turned = R_then.T @ R_now
        r_phi = so3_log(self.R_clone_now @ turned.T)
        if kind is ErrorKind.LEFT:
            by_phi = turned @ phi - phi_clone
            by_x = R_now @ x - R_then @ x_clone
        else:
            by_phi = R_then.T @ (phi - phi_clone)
            by_x = x - x_clone
            if kind is ErrorKind.RIGHT:  # x = exp(phi) x_mean + xi_x
                by_x = by_x - skew(x_now) @ phi + skew(x_then) @ phi_clone
        r = np.concatenate([r_phi / self.sigma_phi, (x_then - x_now) / self.sigma_x])
        return Measurements(r, np.vstack([by_phi / self.sigma_phi, by_x / self.sigma_x]))


def turn_between(xy_then: FloatArray, xy_now: FloatArray, R_body_cam: FloatArray) -> FloatArray | None:
    """Body rotation (3, 3) between two views from one place, by their rays (N, 2); None when they do not agree.

    Source: Kabsch, Acta Cryst. A32, 1976; twice, the second time without outliers.
    """
    if len(xy_then) < 8:
        return None
    then = homogeneous(xy_then)
    now = homogeneous(xy_now)
    then /= np.linalg.norm(then, axis=1, keepdims=True)
    now /= np.linalg.norm(now, axis=1, keepdims=True)
    keep = np.ones(len(then), dtype=bool)
    R = np.eye(3)
    for _ in range(2):
        R = orthonormal(then[keep].T @ now[keep])
        off = np.linalg.norm(then - now @ R.T, axis=1)
        keep = off < max(3.0 * float(np.median(off)), 1e-4)
        if keep.sum() < 8:
            return None
    return R_body_cam @ R @ R_body_cam.T


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """Soft knowledge about a wheeled robot; each can be switched off."""

    use_zero_velocity: bool = True
    use_non_holonomic: bool = True
    use_commanded_speed: bool = True
    sigma_still_m_s: float = 0.01
    sigma_still_rad: float = 5e-4
    sigma_still_m: float = 0.002
    sigma_lateral_m_s: float = 0.03  # plus what the unknown turning centre makes of a turn:
    lateral_per_turn_m: float = 0.05
    sigma_vertical_m_s: float = 0.02
    # The wheels' constants before the drive; the filter learns them along it (docs/slam.md, sec. 9).
    speed_efficiency: float = SPEED_EFFICIENCY
    sigma_efficiency: float = 0.02
    sigma_turning_centre_m: float = 0.05
    sigma_speed_share: float = 0.08
    sigma_speed_m_s: float = 0.02
    # Of what the motors have still to make of a change: a lag half as long again is no rarity among motors.
    sigma_lag_share: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class WheelsKnown:
    """What is known of the wheels' constants (FilterState.wheels) between two pieces of tracking."""

    mean: FloatArray  # (2,)
    sigma: FloatArray  # (2,)

    @classmethod
    def before_the_drive(cls, config: WheelConfig) -> WheelsKnown:
        return cls(
            np.array([config.speed_efficiency, 0.0]), np.array([config.sigma_efficiency, config.sigma_turning_centre_m])
        )

    @classmethod
    def learned(cls, state: FilterState) -> WheelsKnown:
        return cls(state.wheels, np.linalg.norm(state.S[state.wheel_rows], axis=1))

    @property
    def efficiency(self) -> float:
        """Speed over ground by commanded speed."""
        return float(self.mean[0])


@dataclass(frozen=True, slots=True)
class Rolled:
    """How fast the wheels roll now, as the commands say through the motors' lag; without slip."""

    speed_m_s: float
    missing_m_s: float  # of the command, that is still to come


def wheel_velocity(
    config: WheelConfig, wheels: FloatArray, turn_rate: float, rolled: Rolled | None
) -> BodyVelocity | None:
    """What wheels say of the body's velocity now; None when nothing is switched on.

    Args:
        wheels: (2,) FilterState.wheels.
        turn_rate: rad/s about the body's vertical axis, from the gyroscope.
        rolled: how fast the wheels roll; None where no command is known.
    """
    sigma = np.full(3, np.inf)
    by_wheels = np.zeros((3, 2))
    if config.use_non_holonomic:
        by_wheels[1, 1] = turn_rate
        sigma[1] = config.sigma_lateral_m_s + config.lateral_per_turn_m * abs(turn_rate)
        sigma[2] = config.sigma_vertical_m_s
    if config.use_commanded_speed and rolled is not None:
        by_wheels[0, 0] = rolled.speed_m_s
        sigma[0] = config.sigma_speed_m_s + config.sigma_speed_share * abs(rolled.speed_m_s)
        sigma[0] += config.sigma_lag_share * abs(rolled.missing_m_s)
    return BodyVelocity(by_wheels @ wheels, sigma, by_wheels, gate=4.0) if np.isfinite(sigma).any() else None


def with_way(
    link: Preintegration | None, way_m: float | None, wheels: BodyVelocity | None, max_speed_m_s: float
) -> Preintegration | None:
    """The link between two frames with what wheels say of the way between them: as sure as of the velocity at its end.

    Args:
        way_m: of the wheels, as if nothing slipped; None: they do not carry the robot.
        max_speed_m_s: where wheels say nothing.
    """
    if link is None or way_m is None or wheels is None:
        return link
    turn = so3_log(link.dR)
    R_middle = so3_exp(0.5 * turn)
    by_constants = np.zeros((3, 2))
    by_constants[0, 0], by_constants[1, 1] = way_m, turn[2]
    sigma_m = np.minimum(wheels.sigma, max_speed_m_s) * link.duration_s
    return replace(link, rolled=RolledWay(R_middle @ by_constants, R_middle @ np.diag(sigma_m**2) @ R_middle.T))


class Standstill:
    """Remembers the frame with which standing still began."""

    def __init__(self) -> None:
        self.since: int | None = None  # that frame's ImageFrame.index; None while the robot moves
        self._newest = -1

    def reset(self) -> None:
        self.since, self._newest = None, -1

    @property
    def began_with_previous(self) -> bool:
        """Whether the newest frame is the one that the following ones refer to, so that it must stay in the window."""
        return self.since == self._newest

    def update(self, frame_index: int, is_still: bool) -> None:
        if not is_still:
            self.since = None
        elif self.since is None:
            self.since = frame_index
        self._newest = frame_index

    def same_place(
        self,
        then: TrackedFrame | None,
        now: TrackedFrame,
        state: FilterState,
        R_body_cam: FloatArray,
        config: WheelConfig,
    ) -> SamePlace | None:
        """The pose of the frame with which standing still began, and the turn since then by the image.

        Args:
            then: what the frame `since` saw; None where it is known no more.
        """
        since = self.since
        if since is None or then is None or since not in state.clone_frame:
            self.since = None
            return None
        _, i, j = np.intersect1d(then.ids, now.ids, assume_unique=True, return_indices=True)
        turn = turn_between(then.xy[i], now.xy[j], R_body_cam)
        return None if turn is None else SamePlace(since, turn, config.sigma_still_rad, config.sigma_still_m)
