"""An HC-SR04 on the Mega as a depth sensor of one pixel: the nearest thing that sends its sound back."""

from __future__ import annotations

import math

import numpy as np

from robot.devices.pi.mega import Mega
from robot.devices.ports import CapturedDepth
from shared.calibration import DepthCalibration
from shared.errors import DeviceLost
from shared.geometry import se3
from shared.pictures import depth_png
from shared.serial_protocol import ConfigRange, Echo

PERIOD = ConfigRange(period_ms=100)  # its sheet asks for more than 60; stations get four a second
SOUND_M_S = 343.0  # at 20 degrees; ten more or less are 1.8 %
HALF_CONE_RAD = math.radians(15.0)  # beyond, its sheet's practical test heard nothing
R_BODY_AHEAD = np.array(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
)  # of a sensor that looks along the body's x


class HcSr04:
    def __init__(self, mega: Mega) -> None:
        self._mega = mega

    async def measure(self) -> CapturedDepth:
        reading = await self._mega.wait_range()
        if reading.echo not in (Echo.HEARD, Echo.NONE):
            raise DeviceLost("the HC-SR04 does not answer; check its four wires (5V, TRIG 49, ECHO 48, GND)")
        return CapturedDepth(reading.t_robot_ns, depth_png(np.array([[millimetres(reading.echo_us)]], dtype=np.uint16)))

    async def close(self) -> None:
        self._mega.close()


def millimetres(echo_us: int) -> int:
    """0: nothing was heard."""
    return max(1, round(0.5e-3 * SOUND_M_S * echo_us)) if echo_us else 0


def calibration_of(position_m: tuple[float, float, float]) -> DepthCalibration:
    """One pixel as wide as the sensor's cone, straight ahead. Raises ConfigError.

    Args:
        position_m: from the IMU, forward, left, up.
    """
    focal = 0.5 / math.tan(HALF_CONE_RAD)
    T_body_depth = tuple(se3(R_BODY_AHEAD, np.array(position_m)).ravel().tolist())
    return DepthCalibration(width=1, height=1, fx=focal, fy=focal, cx=0.0, cy=0.0, T_body_depth=T_body_depth)
