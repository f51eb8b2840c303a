"""Speeds of a skid-steer body to duties of its two sides, and back. Pure."""

from __future__ import annotations

from dataclasses import dataclass

FULL = 1000  # permille


@dataclass(frozen=True, slots=True)
class DriveGeometry:
    """How this chassis turns duty into motion."""

    full_speed_m_s: float = 0.6  # one side at full duty on the floor
    # Skid-steering slips sideways: the turning circle is that of a robot wider than its wheels.
    track_m: float = 0.25
    deadband: float = 0.15  # share of full duty below which the gears do not move
    invert_left: bool = False
    invert_right: bool = False

    def duties(self, linear_m_s: float, angular_rad_s: float) -> tuple[int, int]:
        """Left and right duty, permille, positive forward. Beyond full speed both shrink alike: the curve stays."""
        half = 0.5 * self.track_m * angular_rad_s
        left, right = (linear_m_s - half) / self.full_speed_m_s, (linear_m_s + half) / self.full_speed_m_s
        scale = max(1.0, abs(left), abs(right))
        duty_left, duty_right = self._duty(left / scale), self._duty(right / scale)
        return (-duty_left if self.invert_left else duty_left, -duty_right if self.invert_right else duty_right)

    def velocity(self, duty_left: int, duty_right: int) -> tuple[float, float]:
        """Inverse of `duties` (m/s, rad/s), for emulated motors."""
        left = self._speed(-duty_left if self.invert_left else duty_left)
        right = self._speed(-duty_right if self.invert_right else duty_right)
        return 0.5 * (left + right), (right - left) / self.track_m

    def _duty(self, share: float) -> int:
        if abs(share) < 1e-3:
            return 0
        size = self.deadband + (1.0 - self.deadband) * abs(share)
        return round(FULL * size) if share > 0 else -round(FULL * size)

    def _speed(self, duty: int) -> float:
        share = max(0.0, (abs(duty) / FULL - self.deadband) / (1.0 - self.deadband))
        return (share if duty > 0 else -share) * self.full_speed_m_s
