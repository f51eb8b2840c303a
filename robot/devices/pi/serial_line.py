"""The serial device of the Mega. The only file that imports pyserial."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import serial

from shared.errors import DeviceLost, DeviceUnavailable
from shared.serial_protocol import BAUD_RATE

READ_TIMEOUT_S = 0.05  # of one read


class SerialLine(Protocol):
    """A line of bytes. All methods raise DeviceLost when it is gone."""

    def read(self) -> bytes:
        """What has arrived; empty after READ_TIMEOUT_S of silence."""
        ...

    def write(self, data: bytes) -> None:
        """Never waits: what the line does not take at once is an error."""
        ...

    def close(self) -> None: ...


class PySerialLine:
    """A tty. Opening it pulls DTR, which resets a Mega."""

    def __init__(self, path: str) -> None:
        try:
            self._tty = serial.Serial(path, BAUD_RATE, timeout=READ_TIMEOUT_S, write_timeout=0, exclusive=True)
        except (OSError, serial.SerialException) as exc:
            why = str(exc) if Path(path).exists() else "no such device"
            raise DeviceUnavailable(
                f"the Mega's serial port {path} cannot be opened ({why}); check the USB cable, `pi.serial_port` and"
                " that the user is in the group dialout"
            ) from exc

    def read(self) -> bytes:
        try:
            return bytes(self._tty.read(max(1, self._tty.in_waiting)))
        except (OSError, TypeError, serial.SerialException) as exc:
            raise DeviceLost(f"the Mega's serial line broke off ({exc})") from exc

    def write(self, data: bytes) -> None:
        try:
            written = self._tty.write(data)
        except (OSError, TypeError, serial.SerialException) as exc:
            raise DeviceLost(f"the Mega's serial line broke off ({exc})") from exc
        if written is not None and written < len(data):
            raise DeviceLost("the Mega takes no more bytes; is its firmware running?")

    def close(self) -> None:
        self._tty.close()
