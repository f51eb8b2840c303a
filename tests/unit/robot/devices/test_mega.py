"""The Pi's side of the serial line, against a line that tests write: greeting, restarts, losses."""

import asyncio
import contextlib
import os
import pty
import queue
import select
import struct
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
import pytest

from robot.devices.pi import mega as mega_module
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_greeting import BOOT_S, AskPlan
from robot.devices.pi.mega_parts import MegaMotors
from robot.devices.pi.serial_line import PySerialLine
from robot.watchdog import MotorWatchdog, Velocity
from shared import serial_protocol as sp
from shared.errors import DeviceLost, DeviceUnavailable

WAIT_S = 20.0
UNHEARD = -1
UNTIL_NS = 250_000_000
SETTINGS = {sp.encode(sp.ConfigImu()): sp.Type.CONFIG_IMU, sp.encode(sp.ConfigMotors()): sp.Type.CONFIG_MOTORS}
STATUS = sp.Status(100, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 7400, 0, 0, 100, 6000)


STATUS_REST = (0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 7400, 0, 0, 100, 6000)


def hello(boot_id: int, version: int = sp.PROTOCOL_VERSION) -> sp.Hello:
    return sp.Hello(version, 1, 0, 1, 0x69, 0xEA, 1, 1, 3, 3, 4, boot_id)


def imu(sequence: int) -> sp.ImuPacket:
    return sp.ImuPacket(sequence, 1000 + 4444 * sequence, 0x11, bytes(23))


class FakeLine:
    """Gives what tests put in. Says hello at its start and when asked, and confirms its settings."""

    def __init__(self, boot_id: int | None, *, results: tuple[int, ...] = (), is_mute: bool = False) -> None:
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
        if data in SETTINGS:
            result = self._results.pop(0) if self._results else 0
            if result != UNHEARD:
                self.say(sp.Ack(SETTINGS[data], result))

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


def told_drives(line: FakeLine) -> list[sp.Drive]:
    """All drive commands that the line was given."""
    payloads = [sp.cobs_decode(frame[:-1]) for frame in line.written]
    bodies = [payload[1:11] for payload in payloads if payload is not None and payload[0] == sp.Type.DRIVE]
    return [sp.Drive(*struct.unpack("<hhIH", body)) for body in bodies]


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
        while len(got) < 5:
            got += [r.sequence for r in asyncio.run(mega.wait_readings())]
        assert got == [0, 1, 3, 5, 6]
        assert mega.restarts == 1
        assert line.written.count(sp.encode(sp.ConfigMotors())) == 2


async def test_a_sensor_is_given_its_time_by_the_clock_of_the_mega(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mega_module, "SILENCE_S", 0.2)
    line = FakeLine(1)
    with opened(line) as mega:
        waiting = asyncio.create_task(mega.wait_readings())
        for _ in range(60):  # six times as long; the Mega's own clock stands still, as in a machine that was held up
            line.say(STATUS)
            await asyncio.sleep(0.02)
        assert not waiting.done()
        line.say(imu(0))
        assert [r.sequence for r in await asyncio.wait_for(waiting, WAIT_S)] == [0]


async def test_a_sensor_that_gives_nothing_while_the_mega_runs_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mega_module, "SILENCE_S", 0.2)
    line = FakeLine(1)
    with opened(line) as mega:
        waiting = asyncio.create_task(mega.wait_readings())
        uptime_ms = STATUS.uptime_ms
        while not waiting.done():
            uptime_ms += 20
            line.say(msgspec.structs.replace(STATUS, uptime_ms=uptime_ms, flags=sp.Flag.IMU_MISSING))
            await asyncio.sleep(0.02)
        with pytest.raises(DeviceLost, match="finds no ICM-20948"):
            await waiting


def test_a_lost_line_is_opened_again_and_nothing_drives_meanwhile() -> None:
    first, second = FakeLine(1), FakeLine(2)
    with opened(first, second, now_ns=lambda: 0) as mega:
        motors = MegaMotors(mega, DriveGeometry())
        motors.drive(0.2, 0.0, UNTIL_NS)
        first.incoming.put(DeviceLost("pulled out"))
        until(lambda: mega.lost)
        with pytest.raises(DeviceLost, match="pulled out"):
            motors.drive(0.2, 0.0, UNTIL_NS)
        motors.stop()  # does not raise
        until(lambda: not mega.lost)
        assert told_drives(second) == []
        motors.drive(0.2, 0.0, UNTIL_NS)
        assert [drive.boot_id for drive in told_drives(second)] == [2]


def test_a_silent_mega_is_dropped() -> None:
    with opened(FakeLine(1)) as mega:
        until(lambda: "said nothing" in mega.lost or "no such device" in mega.lost)


def test_a_drive_command_ends_by_the_clock_of_the_mega_and_never_later_than_it_was_given() -> None:
    """A report that took long to us, or waited for us, makes the end earlier."""
    line, now_ns = FakeLine(7), [0]
    with opened(line, now_ns=lambda: now_ns[0]) as mega:
        for uptime_ms, heard_ms, until_ms, ends_at_ms in (
            (5000, 1000, 1250, 5250),
            (6000, 2400, 2250, 5850),  # sent at 2000 by our clock, read 400 ms later, when the command's time was over
            (0xFFFFFFF0, 3000, 3100, 84),
        ):
            now_ns[0] = heard_ms * 1_000_000
            line.say(msgspec.structs.replace(STATUS, uptime_ms=uptime_ms))
            until(lambda uptime_ms=uptime_ms: mega.status and mega.status.uptime_ms == uptime_ms)
            mega.drive(300, -300, until_ms * 1_000_000)
            assert told_drives(line)[-1] == sp.Drive(300, -300, ends_at_ms, 7)


def test_nothing_drives_a_mega_that_started_anew_before_its_new_clock_is_known() -> None:
    line = FakeLine(1)
    with opened(line, now_ns=lambda: 0) as mega:
        line.say(hello(2))
        until(lambda: mega.restarts)
        until(lambda: line.written.count(sp.encode(sp.ConfigMotors())) == 2)
        with pytest.raises(DeviceLost, match=r"not reported its clock|not confirmed its settings"):
            mega.drive(300, 300, UNTIL_NS)
        line.say(STATUS)
        until(lambda: can_drive(mega))
        assert {drive.boot_id for drive in told_drives(line)} == {2}


def test_a_refused_drive_command_is_said() -> None:
    line = FakeLine(1)
    with opened(line) as mega:
        line.say(sp.Ack(sp.Type.DRIVE, 4))
        until(lambda: "too busy" in mega.problems().get("late_commands", ""))
        line.say(msgspec.structs.replace(STATUS, uptime_ms=STATUS.uptime_ms + 5001))
        until(lambda: not mega.problems())


def test_nothing_is_written_to_a_line_that_stands_still() -> None:
    """Whoever drives must hear of it."""
    line, now_ns = FakeLine(1), [0]
    with opened(line, now_ns=lambda: now_ns[0]) as mega:
        motors = MegaMotors(mega, DriveGeometry())
        motors.drive(0.2, 0.0, UNTIL_NS)
        told = len(line.written)
        now_ns[0] = 501_000_000
        with pytest.raises(DeviceLost, match=r"silent for 0\.5 s"):
            motors.drive(0.2, 0.0, UNTIL_NS)
        assert len(line.written) == told
        line.say(STATUS)
        until(lambda: mega.silence_ns == 0)
        motors.drive(0.2, 0.0, UNTIL_NS)


def test_motors_say_that_the_battery_is_low() -> None:
    line = FakeLine(1)
    with opened(line, now_ns=lambda: 0) as mega:
        low = sp.Status(200, int(sp.Flag.LOW_BATTERY), 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 6100, 0, 0, 100, 6000)
        line.say(low)
        until(lambda: mega.status == low)
        with pytest.raises(DeviceLost, match=r"6\.1 V"):
            MegaMotors(mega, DriveGeometry()).drive(0.1, 0.0, UNTIL_NS)


def test_closing_stops_the_motors() -> None:
    line = FakeLine(1)
    with opened(line):
        pass
    assert line.written[-1] == sp.encode(sp.Stop())


# The stock bootloader of the Mega: what it hears within its window begins a programming session.
WINDOW_S, SESSION_S = 0.83, 7.0


class Bootloader:
    """A Mega that was just reset, in virtual time."""

    def __init__(self) -> None:
        self._leaves_s = WINDOW_S
        self.in_session = False

    def runs(self, now_s: float) -> bool:
        """Whether the firmware runs already."""
        return now_s >= self._leaves_s

    def take_byte(self, now_s: float) -> None:
        if not self.runs(now_s):
            self.in_session = True
            self._leaves_s = now_s + SESSION_S


@pytest.mark.parametrize("is_in_session", [False, True])
def test_a_mega_reset_by_its_opening_is_never_held_in_its_bootloader(is_in_session: bool) -> None:
    """In the session another byte came first: a modem manager's, say. Ours must not lengthen it for ever."""
    boot, plan = Bootloader(), AskPlan(0.0)
    if is_in_session:
        boot.take_byte(0.1)
    asked = []
    for step in range(2200):
        now_s = step * 0.01
        if plan.is_due(now_s):
            asked.append(now_s)
            assert boot.runs(now_s), f"asked the bootloader at {now_s:.2f} s"
    assert 1 <= len(asked) <= 2  # a lost hello is asked for


def test_stale_frames_do_not_have_us_ask_before_the_bootloader_is_over() -> None:
    plan = AskPlan(0.0)
    for step in range(100):
        plan.hear(step * 0.001)  # what the line still held from before the reset
        assert not plan.is_due(step * 0.001)
    assert not any(plan.is_due(0.1 + step * 0.01) for step in range(900))
    plan.hear(BOOT_S + 20)
    assert plan.is_due(BOOT_S + 20)
    assert not plan.is_due(BOOT_S + 20.4)


def test_nothing_is_written_before_the_hello() -> None:
    line = FakeLine(1)
    with opened(line):
        assert line.written[0] in SETTINGS
        assert sp.encode(sp.AskHello()) not in line.written


def test_a_firmware_that_runs_without_a_hello_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot.devices.pi.mega_greeting.BOOT_S", 0.0)
    line = FakeLine(1, is_mute=True)
    line.say(STATUS)
    with opened(line):
        assert line.written[0] == sp.encode(sp.AskHello())


def test_settings_that_are_not_confirmed_are_said_again_and_nothing_drives_before() -> None:
    line = FakeLine(1, results=(0, UNHEARD))
    with opened(line, now_ns=lambda: 0) as mega:
        MegaMotors(mega, DriveGeometry()).drive(0.2, 0.0, UNTIL_NS)
        first_drive = next(i for i, d in enumerate(line.written) if d[1] == sp.Type.DRIVE)
        told = line.written[:first_drive]
        assert told.count(sp.encode(sp.ConfigMotors())) == 2 and told.count(sp.encode(sp.ConfigImu())) == 1


def test_settings_that_are_refused_are_named_and_nothing_drives() -> None:
    line = FakeLine(1, results=(0, *[2] * 100))
    with opened(line, now_ns=lambda: 0) as mega:
        with pytest.raises(DeviceLost, match="refuses ConfigMotors"):
            MegaMotors(mega, DriveGeometry()).drive(0.2, 0.0, UNTIL_NS)
        assert "settings" in mega.problems()


def can_drive(mega: Mega) -> bool:
    try:
        MegaMotors(mega, DriveGeometry()).drive(0.2, 0.0, UNTIL_NS)
    except DeviceLost:
        return False
    return True


def test_a_falling_uptime_is_a_new_start_also_with_the_same_boot_number() -> None:
    line = FakeLine(1)
    with opened(line, now_ns=lambda: 0) as mega:
        line.boot_id = None  # does not answer yet
        line.say(sp.Status(5, *STATUS_REST))
        until(lambda: line.written.count(sp.encode(sp.AskHello())) == 1)
        told = len(line.written)
        with pytest.raises(DeviceLost, match="started anew"):
            MegaMotors(mega, DriveGeometry()).drive(0.2, 0.0, UNTIL_NS)
        MegaMotors(mega, DriveGeometry()).stop()
        assert len(line.written) == told
        line.say(hello(1), STATUS)
        until(lambda: line.written.count(sp.encode(sp.ConfigMotors())) == 2)
        until(lambda: can_drive(mega))


def test_a_reading_thread_outlives_whatever_the_line_throws() -> None:
    first, second = FakeLine(1), FakeLine(2)
    with opened(first, second) as mega:
        first.incoming.put(termios.error(5, "Input/output error"))
        until(lambda: mega.restarts == 1 and not mega.lost)


def test_an_opening_that_throws_anything_is_tried_again() -> None:
    lines: list[FakeLine | Exception] = [FakeLine(1), termios.error(5, "Input/output error"), FakeLine(2)]

    def open_line() -> FakeLine:
        found = lines.pop(0)
        if isinstance(found, Exception):
            raise found
        found.say(hello(2)) if not lines else None
        return found

    first = lines[0]
    assert isinstance(first, FakeLine)
    mega = Mega(open_line, sp.ConfigImu(), sp.ConfigMotors())
    try:
        first.incoming.put(DeviceLost("pulled out"))
        until(lambda: mega.restarts == 1 and not mega.lost)
    finally:
        mega.close()


def test_flags_and_rising_counters_become_sentences() -> None:
    line = FakeLine(1)
    with opened(line) as mega:
        assert mega.problems() == {}
        flags = int(sp.Flag.DRIVER_FAULT | sp.Flag.BUS_ERROR)
        line.say(sp.Status(200, flags, 0, 0, 0, 0, 1, 0, 7, 0, 0, 0, 7400, 0, 0, 100, 6000))
        until(lambda: set(mega.problems()) == {"DRIVER_FAULT", "rx_bad"})  # the bus is still being set up
        line.say(sp.Status(2500, flags, 0, 0, 0, 0, 1, 0, 7, 0, 0, 0, 7400, 0, 0, 100, 6000))
        until(lambda: set(mega.problems()) == {"DRIVER_FAULT", "BUS_ERROR", "rx_bad"})
        line.say(sp.Status(6000, 0, 0, 0, 0, 0, 1, 0, 7, 0, 0, 0, 7400, 0, 0, 100, 6000))
        until(lambda: mega.problems() == {})


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


def within(seconds: float, act: Callable[[], object]) -> None:
    thread = threading.Thread(target=act, daemon=True)
    thread.start()
    thread.join(seconds)
    assert not thread.is_alive(), "it waits for the line"


def drive_until_full(motors: MegaMotors) -> None:
    while True:
        motors.drive(0.2, 0.0, UNTIL_NS)


@pytest.fixture
def full_line() -> Iterator[FullLine]:
    line = FullLine()
    yield line
    line.close()


def open_full(full_line: FullLine) -> tuple[Mega, MegaMotors]:
    def open_line() -> PySerialLine:
        line = PySerialLine(full_line.path)
        full_line.greet()  # after the opening, which throws away what waited
        return line

    mega = Mega(open_line, sp.ConfigImu(), sp.ConfigMotors(), now_ns=lambda: 0)
    return mega, MegaMotors(mega, DriveGeometry())


def test_a_full_line_is_an_error_and_neither_stop_nor_close_waits_for_it(full_line: FullLine) -> None:
    mega, motors = open_full(full_line)
    full_line.fill()

    def drive() -> None:
        with pytest.raises(DeviceLost, match=r"takes no more bytes|no hello|said nothing"):
            drive_until_full(motors)

    for act in (drive, motors.stop, mega.close):
        within(WAIT_S, act)


def test_a_full_line_holds_up_no_way_of_stopping_the_watchdog(full_line: FullLine) -> None:
    mega, motors = open_full(full_line)
    watchdog = MotorWatchdog(motors)
    assert watchdog.command(Velocity(0.2, 0.0), time.monotonic_ns() + 250_000_000)
    full_line.fill()
    for act in (watchdog.stop, watchdog.check, watchdog.close, mega.close):
        within(WAIT_S, act)
    assert watchdog.applied.is_zero
