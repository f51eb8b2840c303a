"""The serial line to a Mega as tests write it, and a real one that nobody reads."""

import contextlib
import os
import pty
import queue
import select
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec

from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaMotors
from robot.devices.pi.serial_line import PySerialLine
from shared import serial_protocol as sp
from shared.errors import DeviceLost, DeviceUnavailable

WAIT_S = 90.0
UNHEARD = -1
UNTIL_NS = 250_000_000
UNKNOWN_TYPE = 3
SETTINGS = {sp.encode(sp.ConfigImu()): sp.Type.CONFIG_IMU, sp.encode(sp.ConfigMotors()): sp.Type.CONFIG_MOTORS}
STATUS = sp.Status(100, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 7400, 0, 0, 100, 6000)


def hello(boot_id: int, version: int = sp.PROTOCOL_VERSION) -> sp.Hello:
    return sp.Hello(version, 1, 0, 1, 0x69, 0xEA, 1, 1, 3, 3, 4, boot_id)


def imu(sequence: int) -> sp.ImuPacket:
    return sp.ImuPacket(sequence, 1000 + 4444 * sequence, 0x11, bytes(23))


class FakeLine:
    """Gives what tests put in. Says hello at its start and when asked, and confirms its settings."""

    def __init__(
        self,
        boot_id: int | None,
        *,
        results: tuple[int, ...] = (),
        is_mute: bool = False,
        unknown: tuple[sp.Command, ...] = (),
    ) -> None:
        """`unknown`: commands that this firmware is too old for."""
        self._unknown = [sp.encode(command) for command in unknown]
        self.boot_id = boot_id  # None: nobody there
        self.incoming: queue.Queue[bytes | Exception] = queue.Queue()
        self.written: list[bytes] = []
        self.is_gone = False
        self._results = list(results)  # of the first settings; None is no answer
        if boot_id is not None and not is_mute:
            self.say(hello(boot_id), STATUS)

    def say(self, *messages: sp.FirmwareMessage) -> None:
        for message in messages:
            self.incoming.put(sp.encode_frame(sp.pack(message)))

    def read(self) -> bytes:
        try:
            data = self.incoming.get(timeout=0.005)
        except queue.Empty:
            return b""
        if isinstance(data, Exception):
            raise data
        return data

    def write(self, data: bytes) -> None:
        if self.is_gone:
            raise DeviceLost("gone")
        self.written.append(data)
        if data == sp.encode(sp.AskHello()) and self.boot_id is not None:
            self.say(hello(self.boot_id), STATUS)
        if data in self._unknown:
            asked = sp.cobs_decode(data[:-1])
            assert asked is not None
            self.say(sp.Ack(asked[0], UNKNOWN_TYPE))
        elif data in SETTINGS:
            result = self._results.pop(0) if self._results else 0
            if result != UNHEARD:
                self.say(sp.Ack(SETTINGS[data], result))

    def close(self) -> None: ...


@contextmanager
def opened(
    *lines: FakeLine, now_ns: Callable[[], int] = time.monotonic_ns, range_sensor: sp.ConfigRange | None = None
) -> Iterator[Mega]:
    waiting = list(lines)

    def open_line() -> FakeLine:
        if not waiting:
            raise DeviceUnavailable("no such device")
        return waiting.pop(0)

    mega = Mega(open_line, sp.ConfigImu(), sp.ConfigMotors(), now_ns, range_sensor=range_sensor)
    try:
        yield mega
    finally:
        mega.close()


def reports(line: FakeLine, count: int) -> None:
    """What a Mega says of itself in so many tenths of a second."""
    line.say(*(msgspec.structs.replace(STATUS, uptime_ms=STATUS.uptime_ms + 100 * k) for k in range(1, count + 1)))


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "the awaited condition did not come true"
        time.sleep(0.002)


def told_drives(line: FakeLine) -> list[sp.Drive]:
    """All drive commands that the line was given."""
    payloads = [sp.cobs_decode(frame[:-1]) for frame in line.written]
    bodies = [payload[1:11] for payload in payloads if payload is not None and payload[0] == sp.Type.DRIVE]
    return [sp.Drive(*struct.unpack("<hhIH", body)) for body in bodies]


def can_drive(mega: Mega) -> bool:
    try:
        MegaMotors(mega, DriveGeometry()).drive(0.2, 0.0, UNTIL_NS)
    except DeviceLost:
        return False
    return True


class FullLine:
    """A real tty whose other end has stopped reading."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._greetings: list[threading.Thread] = []
        self._is_closed = False

    def greet(self) -> None:
        os.write(self._master, sp.encode_frame(sp.pack(hello(1))))
        thread = threading.Thread(target=self._confirm, daemon=True)
        self._greetings.append(thread)
        thread.start()

    def _confirm(self) -> None:
        heard = b""
        while not all(setting in heard for setting in SETTINGS):
            readable, _, _ = select.select([self._master], [], [], 0.02)
            heard += os.read(self._master, 100) if readable else b""
            if self._is_closed:
                return
        told: list[sp.FirmwareMessage] = [STATUS, *(sp.Ack(kind, 0) for kind in SETTINGS.values())]
        os.write(self._master, b"".join(sp.encode_frame(sp.pack(m)) for m in told))

    def fill(self) -> None:
        fd = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        try:
            for size in (256, 1, 1):
                with contextlib.suppress(BlockingIOError):
                    while True:
                        os.write(fd, bytes(size))
        finally:
            os.close(fd)

    def close(self) -> None:
        self._is_closed = True
        for thread in self._greetings:
            thread.join()
        os.close(self._master)
        os.close(self._slave)


def open_full(full_line: FullLine) -> tuple[Mega, MegaMotors]:
    def open_line() -> PySerialLine:
        line = PySerialLine(full_line.path)
        full_line.greet()  # after the opening, which throws away what waited
        return line

    mega = Mega(open_line, sp.ConfigImu(), sp.ConfigMotors(), now_ns=lambda: 0)
    return mega, MegaMotors(mega, DriveGeometry())
