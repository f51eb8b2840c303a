"""A robot that was built with other numbers than the calibration says which it sends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from robot.simulation.config import SimulationConfig
from shared.calibration import CameraCalibration
from shared.geometry import se3, so3_exp


@dataclass(frozen=True, slots=True)
class Misfit:
    """True numbers against told ones."""

    focal_percent: float = 0.0  # of the focal length
    mounting_deg: float = 0.0  # the camera is turned so far about an axis that the seed chooses,
    mounting_cm: float = 0.0  # ... and sits so far beside its told place
    delay_ms: float = 0.0  # of the images, beyond the told time shift
    wheels_percent: float = 0.0  # of the way and of the turns that a command makes
    seed: int = 0

    @property
    def name(self) -> str:
        """For a file's name: exact, or the focal length's error, which all others grow with."""
        return "exact" if self == Misfit(seed=self.seed) else f"focal{self.focal_percent:+g}"

    def built(self, told: CameraCalibration) -> CameraCalibration:
        """The camera as it is, of which `told` is what the robot says."""
        rng = np.random.default_rng([self.seed, 41])
        axis, side = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        turned = se3(so3_exp(math.radians(self.mounting_deg) * axis), 0.01 * self.mounting_cm * side)
        T = told.T_body_cam_matrix @ turned
        factor = 1 + self.focal_percent / 100
        return msgspec.structs.replace(
            told,
            fx=factor * told.fx,
            fy=factor * told.fy,
            T_body_cam=tuple(T.ravel().tolist()),
            time_shift_s=told.time_shift_s + 1e-3 * self.delay_ms,
        )

    def built_body(self, config: SimulationConfig) -> SimulationConfig:
        """The wheels as they are."""
        factor, body = 1 + self.wheels_percent / 100, config.body
        body = msgspec.structs.replace(
            body, linear_efficiency=factor * body.linear_efficiency, yaw_efficiency=factor * body.yaw_efficiency
        )
        return msgspec.structs.replace(config, body=body)


def graded(percent: float, seed: int) -> Misfit:
    """As wrong as a calibration by hand: with 2 %, 1 degree, 1 cm and 5 ms; the focal length's sign alternates."""
    sign = 1 if seed % 2 == 0 else -1
    part = percent / 2
    return Misfit(sign * percent, part, part, 5 * part, -sign * percent, seed)


def wrong_percent(name: str) -> float:
    """By a misfit's name: how wrong the told focal length is, either way."""
    return abs(float(name.removeprefix("focal"))) if name.startswith("focal") else 0.0
