"""What is to be said where nobody measured the IMU's noise."""

from __future__ import annotations

from shared.calibration import ImuNoise
from shared.sensor_yaml import CONSUMER_IMU, NOISE_KEYS


def assumed_noise(noise: ImuNoise) -> list[str]:
    """A note where figures are those of a consumer-grade IMU, which the readers of files take for unknown ones."""
    assumed = [NOISE_KEYS[name] for name, figure in CONSUMER_IMU.items() if getattr(noise, name) == figure]
    if not assumed:
        return []
    return [
        f"the IMU's {', '.join(assumed)}: what is taken of an IMU that nobody measured;"
        " `station calibrate imu` measures it"
    ]
