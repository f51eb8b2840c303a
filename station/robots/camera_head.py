"""Where the camera head looks, as far as the station told it."""

from __future__ import annotations

TURN_NS = 1_000_000_000  # servos need half a second from one end to the other; the picture is a little late
AHEAD = (0.0, 0.0)  # pan, tilt: as the calibration has the camera


class CameraHead:
    """The last command to a pan-tilt head. Time is an argument."""

    def __init__(self) -> None:
        self._pan_tilt = AHEAD
        self._rests_ns = 0  # when it looks there

    @property
    def is_centred(self) -> bool:
        """Whether the head was told to look straight ahead."""
        return self._pan_tilt == AHEAD

    def looks_ahead(self, now_ns: int) -> bool:
        """Whether it has also had the time to get there: only then is the camera where the calibration says."""
        return self.is_centred and now_ns >= self._rests_ns

    def turn(self, pan: float, tilt: float, now_ns: int) -> None:
        """The head was told to look there (rad)."""
        if (pan, tilt) != self._pan_tilt:
            self._pan_tilt, self._rests_ns = (pan, tilt), now_ns + TURN_NS
