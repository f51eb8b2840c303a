"""How the Pi meets a Mega: its hello, its bootloader, its settings, and a start anew."""

import asyncio
import threading

import pytest

from robot.devices.pi import mega as mega_module
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega_greeting import BOOT_S, AskPlan
from robot.devices.pi.mega_parts import MegaMotors
from shared import serial_protocol as sp
from shared.errors import DeviceLost, DeviceUnavailable
from tests.support.mega_lines import (
    SETTINGS,
    STATUS,
    UNHEARD,
    UNTIL_NS,
    FakeLine,
    can_drive,
    hello,
    imu,
    opened,
    reports,
    told_drives,
    until,
)

RANGE = sp.ConfigRange(100)


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


def test_a_firmware_from_before_the_range_sensor_drives_as_ever_and_its_sensor_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mega_module, "SILENCE_S", 0.1)
    line = FakeLine(1, unknown=(RANGE,))
    with opened(line, now_ns=lambda: 0, range_sensor=RANGE) as mega:
        until(lambda: can_drive(mega))
        assert mega.problems() == {}
        # It tells its time while the range is awaited: silence is counted by the Mega's own clock.
        telling = threading.Timer(0.05, reports, (line, 30))
        telling.start()
        with pytest.raises(DeviceLost, match="too old for an HC-SR04; flash it"):
            asyncio.run(mega.wait_range())
        telling.join()
        assert line.written.count(sp.encode(RANGE)) == 1  # it is not asked again


def test_a_firmware_that_comes_back_newer_is_asked_again() -> None:
    old, new = FakeLine(1, unknown=(RANGE,)), FakeLine(2)
    with opened(old, new, range_sensor=RANGE) as mega:
        old.incoming.put(DeviceLost("pulled out"))
        until(lambda: sp.encode(RANGE) in new.written)
        new.say(sp.RangePacket(0, 1000, 5831, sp.Echo.HEARD))
        assert asyncio.run(mega.wait_range()).echo_us == 5831


def test_a_robot_without_the_sensor_asks_for_none() -> None:
    line = FakeLine(1)
    with opened(line) as mega:
        until(lambda: can_drive(mega))
        line.say(sp.RangePacket(0, 1000, 5831, sp.Echo.HEARD), imu(0))  # from a Mega that another program had set
        assert len(asyncio.run(mega.wait_readings())) == 1
        assert not any(sp.encode(RANGE) == frame for frame in line.written)


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


STATUS_REST = (0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 7400, 0, 0, 100, 6000)


def test_a_falling_uptime_is_a_new_start_also_with_the_same_boot_number() -> None:
    line = FakeLine(1)
    with opened(line, now_ns=lambda: 0) as mega:
        line.boot_id = None  # does not answer yet
        line.say(sp.Status(5, *STATUS_REST))
        until(lambda: line.written.count(sp.encode(sp.AskHello())) == 1)
        told = len(line.written)
        with pytest.raises(DeviceLost, match="started anew"):
            MegaMotors(mega, DriveGeometry()).drive(0.2, 0.0, UNTIL_NS)
        assert "motors are off until it has been greeted" in MegaMotors(mega, DriveGeometry()).stop()
        assert len(line.written) == told
        line.say(hello(1), STATUS)
        until(lambda: line.written.count(sp.encode(sp.ConfigMotors())) == 2)
        until(lambda: can_drive(mega))


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
