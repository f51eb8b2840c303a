"""A robot that was built with other numbers than the calibration says which it sends."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from robot.simulation.config import BuildErrors, SimulationConfig


@dataclass(frozen=True, slots=True)
class Misfit:
    """How far the truth is from what is told, as a calibration by hand would leave it.

    The focal length is wrong by `percent`, longer with even seeds and shorter with odd ones; the wheels go and turn so
    much less or more on a command. With 2 % go 1 degree in pitch and in yaw, 1 cm and 5 ms, with others in proportion.
    """

    percent: float = 0.0
    seed: int = 0

    @property
    def name(self) -> str:
        """For a file's name."""
        return f"focal{self._signed_percent:+g}" if self.percent else "exact"

    @property
    def _signed_percent(self) -> float:
        return self.percent if self.seed % 2 == 0 else -self.percent

    def built(self, config: SimulationConfig) -> SimulationConfig:
        """The simulated robot as it is."""
        rng = np.random.default_rng([self.seed, 41])
        degrees, cm, ms = (part * self.percent / 2 for part in (1.0, 1.0, 5.0))
        pitch, yaw = rng.choice([-degrees, degrees], 2)
        side = rng.normal(size=3)
        forward_cm, left_cm, up_cm = cm * side / np.linalg.norm(side)
        errors = BuildErrors(
            focal_percent=self._signed_percent,
            pitch_deg=float(pitch),
            yaw_deg=float(yaw),
            forward_cm=float(forward_cm),
            left_cm=float(left_cm),
            up_cm=float(up_cm),
            time_shift_ms=ms,
        )
        wheels = 1 - self._signed_percent / 100
        body = msgspec.structs.replace(
            config.body,
            linear_efficiency=wheels * config.body.linear_efficiency,
            yaw_efficiency=wheels * config.body.yaw_efficiency,
        )
        return msgspec.structs.replace(config, build=errors, body=body)


def wrong_percent(name: str) -> float:
    """By a misfit's name: how wrong the told focal length is, either way."""
    return abs(float(name.removeprefix("focal"))) if name.startswith("focal") else 0.0
