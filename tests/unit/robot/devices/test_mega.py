"""The Pi's side of the serial line, against a line that tests write: samples, commands, losses."""

import asyncio
import termios
import threading
import time
from collections.abc import Callable, Iterator

import msgspec
import pytest

from robot.devices.pi import mega as mega_module
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaMotors
from robot.watchdog import MotorWatchdog, Velocity
from shared import serial_protocol as sp
from shared.errors import DeviceLost
from tests.support.mega_lines import (
    STATUS,
    UNTIL_NS,
    WAIT_S,
    FakeLine,
    FullLine,
    hello,
    imu,
    open_full,
    opened,
    told_drives,
    until,
)


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
