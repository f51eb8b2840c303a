"""What else is known of the velocity: standing still, wheels, the commanded speed (docs/slam.md, sec. 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.slam.ukf import lie
from station.slam.ukf.state import PHI, XI_V, ErrorKind, FilterState
from station.slam.ukf.update import Measurements


@dataclass(frozen=True, slots=True, eq=False)
class BodyVelocity:
    """The body moves with v_body, each component known to sigma; infinite where it is not."""

    v_body: FloatArray  # (3,) m/s
    sigma: FloatArray  # (3,) m/s
    gate: float = np.inf  # standard deviations; a component further off is left out (wheels that slip)

    def rows(self, state: FilterState, kind: ErrorKind) -> Measurements:
        """Whitened rows; the velocity in the body frame is R^T v."""
        v_now = state.R.T @ state.v
        if kind is ErrorKind.RIGHT:
            by_state = state.R.T @ state.S[XI_V]
        elif kind is ErrorKind.LEFT:
            by_state = state.S[XI_V] + lie.skew(v_now) @ state.S[PHI]
        else:
            by_state = state.R.T @ (state.S[XI_V] + lie.skew(state.v) @ state.S[PHI])
        known = np.isfinite(self.sigma)
        r = (self.v_body - v_now)[known] / self.sigma[known]
        A = by_state[known] / self.sigma[known, None]
        spread = np.sqrt(1.0 + np.einsum("ik,ik->i", A, A))
        fits = np.abs(r) < self.gate * spread
        return Measurements(r[fits], A[fits])


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """Soft knowledge about a wheeled robot; each can be switched off."""

    use_zero_velocity: bool = True
    use_non_holonomic: bool = True
    use_commanded_speed: bool = True
    sigma_still_m_s: float = 0.01
    sigma_lateral_m_s: float = 0.03  # plus what the unknown turning centre makes of a turn:
    lateral_per_turn_m: float = 0.05
    sigma_vertical_m_s: float = 0.02
    speed_efficiency: float = 0.97  # wheels slip a little
    sigma_speed_share: float = 0.08
    sigma_speed_m_s: float = 0.02
    settle_s: float = 0.35  # the motors follow a new command that late


def wheel_velocity(
    config: WheelConfig, turn_rate: float, command_m_s: float | None, since_change_s: float
) -> BodyVelocity | None:
    """What wheels say of the body's velocity now; None when nothing is switched on.

    Args:
        turn_rate: rad/s about the body's vertical axis, from the gyroscope.
        command_m_s: commanded forward speed, None where no command is known.
        since_change_s: since the command changed.
    """
    sigma = np.full(3, np.inf)
    v = np.zeros(3)
    if config.use_non_holonomic:
        sigma[1] = config.sigma_lateral_m_s + config.lateral_per_turn_m * abs(turn_rate)
        sigma[2] = config.sigma_vertical_m_s
    if config.use_commanded_speed and command_m_s is not None and since_change_s > config.settle_s:
        v[0] = config.speed_efficiency * command_m_s
        sigma[0] = config.sigma_speed_m_s + config.sigma_speed_share * abs(command_m_s)
    return BodyVelocity(v, sigma, gate=4.0) if np.isfinite(sigma).any() else None
