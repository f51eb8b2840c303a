"""The serial device of the Mega. The only file that imports pyserial."""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from pathlib import Path
from typing import Protocol

import serial

from shared.errors import DeviceLost, DeviceUnavailable
from shared.serial_protocol import BAUD_RATE

READ_TIMEOUT_S = 0.05  # of one read
# termios.error is no OSError; pyserial lets it through when the device vanishes under it.
_FAILURES = (OSError, TypeError, ValueError, termios.error, serial.SerialException)


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
    """A tty, ours alone (flock). Opening it pulls DTR, which resets a Mega."""

    def __init__(self, path: str) -> None:
        try:
            self._tty = serial.Serial(path, BAUD_RATE, timeout=READ_TIMEOUT_S, exclusive=True)
            self._fd = self._tty.fileno()
            os.set_blocking(self._fd, False)
        except _FAILURES as exc:
            if getattr(exc, "errno", None) in (errno.EAGAIN, errno.EBUSY):  # of flock, of a port opened exclusively
                raise DeviceUnavailable(
                    f"the Mega's serial port {path} is in use by another program (robot-server, or the flashing of the"
                    " Mega); end it first: sudo systemctl stop sentinel-robot"
                ) from exc
            why = str(exc) if Path(path).exists() else "no such device"
            raise DeviceUnavailable(
                f"the Mega's serial port {path} cannot be opened ({why}); check the USB cable, `pi.serial_port` and"
                " that the user is in the group dialout"
            ) from exc

    def read(self) -> bytes:
        try:
            return bytes(self._tty.read(max(1, self._tty.in_waiting)))
        except _FAILURES as exc:
            raise DeviceLost(f"the Mega's serial line broke off ({exc})") from exc

    def write(self, data: bytes) -> None:
        # Not pyserial's write: it tries again for ever when the line is full, whatever its time-out.
        try:
            written = os.write(self._fd, data) if self._tty.is_open else 0
        except BlockingIOError:
            written = 0
        except _FAILURES as exc:
            raise DeviceLost(f"the Mega's serial line broke off ({exc})") from exc
        if written < len(data):
            raise DeviceLost("the Mega takes no more bytes; is its firmware running?")

    def close(self) -> None:
        """Does not wait: what the line has not taken is thrown away, or Linux would hold us up for it."""
        with contextlib.suppress(*_FAILURES):
            termios.tcflush(self._fd, termios.TCOFLUSH)
        with contextlib.suppress(*_FAILURES):
            self._tty.close()
