"""The Pi's side of the serial line, against a line that tests write: greeting, restarts, losses."""

import queue
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from robot.devices.pi import mega as mega_module
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaMotors
from shared import serial_protocol as sp
from shared.errors import DeviceLost, DeviceUnavailable

WAIT_S = 20.0
STATUS = sp.Status(100, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 7400, 0, 0, 100, 6000)


def hello(boot_id: int, version: int = sp.PROTOCOL_VERSION) -> sp.Hello:
    return sp.Hello(version, 1, 0, 1, 0x69, 0xEA, 1, 1, 3, 3, 4, boot_id)


def imu(sequence: int) -> sp.ImuPacket:
    return sp.ImuPacket(sequence, 1000 + 4444 * sequence, 0x11, bytes(23))


class FakeLine:
    """Gives what tests put in; answers a question for the hello."""

    def __init__(self, boot_id: int | None) -> None:
        self.boot_id = boot_id  # None: nobody there
        self.incoming: queue.Queue[bytes | Exception] = queue.Queue()
        self.written: list[bytes] = []
        self.is_gone = False

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

    def close(self) -> None: ...


@contextmanager
def opened(*lines: FakeLine, now_ns: Callable[[], int] = time.monotonic_ns) -> Iterator[Mega]:
    waiting = list(lines)

    def open_line() -> FakeLine:
        if not waiting:
            raise DeviceUnavailable("no such device")
        return waiting.pop(0)

    mega = Mega(open_line, sp.ConfigImu(), sp.ConfigMotors(), now_ns)
    try:
        yield mega
    finally:
        mega.close()


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "the awaited condition did not come true"
        time.sleep(0.002)


def test_nobody_at_the_other_end_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mega_module, "HELLO_TIMEOUT_S", 0.1)
    with pytest.raises(DeviceUnavailable, match="flash it"), opened(FakeLine(None)):
        pass


def test_a_firmware_of_another_protocol_is_refused() -> None:
    line = FakeLine(None)
    line.say(hello(1, version=9))
    with pytest.raises(DeviceUnavailable, match="protocol 9"), opened(line):
        pass


def test_a_greeted_firmware_is_configured() -> None:
    line = FakeLine(1)
    with opened(line):
        assert {sp.encode(sp.ConfigImu()), sp.encode(sp.ConfigMotors())} <= set(line.written)


def test_samples_keep_their_numbers_and_a_restart_shows_as_a_hole() -> None:
    line = FakeLine(1)
    with opened(line) as mega:
        line.say(imu(5), imu(6), imu(8))
        line.say(hello(2), imu(0), imu(1))
        got: list[int] = []
        until(lambda: got.extend(r.sequence for r in mega.take_readings()) or len(got) == 5)
        assert got == [0, 1, 3, 5, 6]
        assert mega.restarts == 1
        assert line.written.count(sp.encode(sp.ConfigMotors())) == 2


def test_a_lost_line_is_opened_again_and_nothing_drives_meanwhile() -> None:
    first, second = FakeLine(1), FakeLine(2)
    with opened(first, second, now_ns=lambda: 0) as mega:
        motors = MegaMotors(mega, DriveGeometry())
        motors.drive(0.2, 0.0)
        first.incoming.put(DeviceLost("pulled out"))
        until(lambda: mega.lost)
        with pytest.raises(DeviceLost, match="pulled out"):
            motors.drive(0.2, 0.0)
        motors.stop()  # does not raise
        until(lambda: not mega.lost)
        drives = [d for d in second.written if d == sp.encode(sp.Drive(*DriveGeometry().duties(0.2, 0.0), 300))]
        assert drives == []
        motors.drive(0.2, 0.0)


def test_a_silent_mega_is_dropped() -> None:
    with opened(FakeLine(1)) as mega:
        until(lambda: "said nothing" in mega.lost or "no such device" in mega.lost)


def test_nothing_is_written_to_a_line_that_stands_still() -> None:
    """It would wait there and move the robot when the line flows again."""
    line, now_ns = FakeLine(1), [0]
    with opened(line, now_ns=lambda: now_ns[0]) as mega:
        motors = MegaMotors(mega, DriveGeometry())
        motors.drive(0.2, 0.0)
        told = len(line.written)
        now_ns[0] = 501_000_000
        with pytest.raises(DeviceLost, match=r"silent for 0\.5 s"):
            motors.drive(0.2, 0.0)
        assert len(line.written) == told
        line.say(STATUS)
        until(lambda: mega.silence_ns == 0)
        motors.drive(0.2, 0.0)


def test_motors_say_that_the_battery_is_low() -> None:
    line = FakeLine(1)
    with opened(line, now_ns=lambda: 0) as mega:
        low = sp.Status(200, int(sp.Flag.LOW_BATTERY), 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 6100, 0, 0, 100, 6000)
        line.say(low)
        until(lambda: mega.status == low)
        with pytest.raises(DeviceLost, match=r"6\.1 V"):
            MegaMotors(mega, DriveGeometry()).drive(0.1, 0.0)


def test_closing_stops_the_motors() -> None:
    line = FakeLine(1)
    with opened(line):
        pass
    assert line.written[-1] == sp.encode(sp.Stop())
