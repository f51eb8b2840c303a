"""Motors run only while fresh commands keep coming."""

from __future__ import annotations

import logging
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.watchdog import MAX_TTL_NS, STANDSTILL, DriveGuard, MotorWatchdog, Velocity
from shared.errors import DeviceLost
from tests.support.motors import FakeMotors

MS = 1_000_000
AHEAD = Velocity(0.3, 0.1)


class FrozenClock:
    """Stands until it is moved."""

    def __init__(self) -> None:
        self.t_ns = 10**9

    def __call__(self) -> int:
        return self.t_ns


def later_ns(ms: int) -> int:
    return time.monotonic_ns() + ms * MS


def wait_until_rests(watchdog: MotorWatchdog) -> None:
    while not watchdog.applied.is_zero:
        time.sleep(0.001)


def test_what_may_not_start_the_motors_keeps_them_moving_alone() -> None:
    guard = DriveGuard()
    guard.command(AHEAD, 200 * MS, 100 * MS, 100 * MS)
    assert guard.velocity(100 * MS) == STANDSTILL
    guard.command(AHEAD, 200 * MS, 100 * MS)
    guard.command(AHEAD, 220 * MS, 165 * MS, 120 * MS)
    assert guard.velocity(210 * MS) == AHEAD
    guard.command(AHEAD, 240 * MS, 195 * MS, 140 * MS)  # 25 ms before their time motors may have ended
    assert guard.velocity(221 * MS).is_zero
    guard.command(AHEAD, 240 * MS, 225 * MS, 140 * MS)  # nobody had looked since it ended
    guard.command(AHEAD, 232 * MS, 227 * MS)  # the end of a motion, said again
    assert guard.velocity(230 * MS) == STANDSTILL and guard.stops == 1


@given(
    commands=st.lists(
        st.tuples(st.integers(0, 400 * MS), st.integers(-10, 10**12), st.sampled_from(["drive", "zero", "stop"])),
        max_size=20,
    ),
    ask_after_ns=st.integers(0, 2000 * MS),
)
def test_nothing_ever_moves_longer_than_the_limit_after_the_last_command(
    commands: list[tuple[int, int, str]], ask_after_ns: int
) -> None:
    guard, now_ns, last_drive_ns = DriveGuard(), 0, None
    for wait_ns, ttl_ns, kind in commands:
        now_ns += wait_ns
        if kind == "stop":
            guard.stop()
            assert guard.velocity(now_ns) == STANDSTILL
        else:
            guard.command(AHEAD if kind == "drive" else STANDSTILL, now_ns + ttl_ns, now_ns)
            last_drive_ns = now_ns if kind == "drive" else last_drive_ns
    now_ns += ask_after_ns
    if last_drive_ns is None or now_ns - last_drive_ns >= MAX_TTL_NS:
        assert guard.velocity(now_ns) == STANDSTILL


def test_guard_starts_at_standstill_and_counts_what_silence_ended() -> None:
    guard = DriveGuard()
    assert guard.velocity(0) == STANDSTILL and guard.stops == 0
    guard.command(AHEAD, 100 * MS, 0)
    assert guard.velocity(99 * MS) == AHEAD
    assert guard.velocity(100 * MS) == STANDSTILL and guard.stops == 1
    guard.command(STANDSTILL, 300 * MS, 200 * MS)
    assert guard.velocity(500 * MS) == STANDSTILL and guard.stops == 1


def test_a_command_that_has_lived_already_moves_nothing_but_zero_always_counts() -> None:
    guard = DriveGuard()
    guard.command(AHEAD, 100 * MS, 100 * MS)
    assert guard.velocity(100 * MS) == STANDSTILL
    guard.command(AHEAD, 200 * MS, 100 * MS)
    guard.command(Velocity(0.5, 0.0), 90 * MS, 110 * MS)
    assert guard.velocity(120 * MS) == AHEAD
    guard.command(STANDSTILL, 90 * MS, 130 * MS)
    assert guard.velocity(131 * MS) == STANDSTILL


def test_closed_guard_refuses_commands() -> None:
    guard = DriveGuard()
    guard.close()
    assert not guard.command(AHEAD, 100 * MS, 0)
    assert guard.velocity(1) == STANDSTILL


def test_motors_are_stopped_when_taken_over() -> None:
    motors = FakeMotors()
    MotorWatchdog(motors).close()
    assert motors.history[0] == (0.0, 0.0)


def test_silence_stops_the_motors_without_anybodys_help() -> None:
    motors = FakeMotors()
    watchdog = MotorWatchdog(motors)
    watchdog.command(AHEAD, later_ns(30))
    assert motors.wait_for_last(0.3, 0.1)
    assert motors.wait_for_last(0.0, 0.0)
    assert watchdog.stops == 1
    watchdog.close()


def test_every_command_reaches_the_motors_also_an_unchanged_one() -> None:
    motors = FakeMotors()
    watchdog = MotorWatchdog(motors)
    for count in range(1, 4):
        watchdog.command(AHEAD, later_ns(250))
        with motors.told:
            assert motors.told.wait_for(lambda count=count: motors.history.count((0.3, 0.1)) == count, 10)
    watchdog.close()


@pytest.mark.parametrize(("starts_until_ms", "late_ms"), [(30, 95), (30, 130), (125, 130), (None, 195)])
def test_what_comes_too_late_to_start_motors_is_not_said_once_they_rest(
    starts_until_ms: int | None, late_ms: int
) -> None:
    motors, clock = FakeMotors(), FrozenClock()
    watchdog = MotorWatchdog(motors, now_ns=clock)
    begun_ns = clock.t_ns
    motors.may_go_on.clear()
    watchdog.command(AHEAD, begun_ns + 120 * MS)
    assert motors.wait_for_last(0.3, 0.1)  # its thread is held up in the driver
    clock.t_ns += 50 * MS
    starts_until_ns = None if starts_until_ms is None else begun_ns + starts_until_ms * MS
    watchdog.command(Velocity(0.5, 0.0), begun_ns + 200 * MS, starts_until_ns)
    clock.t_ns = begun_ns + late_ms * MS  # the motors may have ended the first one by themselves
    motors.may_go_on.set()
    assert motors.wait_for_last(0.0, 0.0)
    watchdog.close()
    assert (0.5, 0.0) not in motors.history


def test_motors_hear_when_a_command_ends_however_late_they_hear_it() -> None:
    motors, clock = FakeMotors(), FrozenClock()
    watchdog = MotorWatchdog(motors, now_ns=clock)
    motors.may_go_on.clear()
    made_ns = clock.t_ns
    watchdog.command(AHEAD, made_ns + 250 * MS)
    assert motors.wait_for_last(0.3, 0.1)
    clock.t_ns += 900 * MS  # the process was stopped after its look at the clock, and now the word goes out
    motors.may_go_on.set()
    assert motors.wait_for_last(0.0, 0.0)
    watchdog.close()
    assert motors.until_ns == made_ns + 250 * MS


def test_changes_are_reported_once_each() -> None:
    motors, reported = FakeMotors(), []
    watchdog = MotorWatchdog(motors, reported.append)
    watchdog.command(AHEAD, later_ns(250))
    assert motors.wait_for_last(0.3, 0.1)
    watchdog.command(AHEAD, later_ns(20))
    assert motors.wait_for_last(0.0, 0.0)
    wait_until_rests(watchdog)
    watchdog.close()
    assert reported == [AHEAD, STANDSTILL]


def test_stop_reaches_the_motors_while_the_thread_hangs_in_a_driver() -> None:
    motors = FakeMotors()
    motors.may_go_on.clear()
    watchdog = MotorWatchdog(motors)
    watchdog.command(AHEAD, later_ns(250))
    assert motors.wait_for_last(0.3, 0.1)
    watchdog.stop()
    assert motors.history[-1] == (0.0, 0.0)
    motors.may_go_on.set()
    watchdog.close()
    assert motors.history[-1] == (0.0, 0.0)


def test_check_stops_what_a_hanging_thread_cannot() -> None:
    motors, now_ns = FakeMotors(), [0]
    watchdog = MotorWatchdog(motors, now_ns=lambda: now_ns[0])
    watchdog.command(AHEAD, 250 * MS)
    assert motors.wait_for_last(0.3, 0.1)
    while watchdog.applied.is_zero:
        time.sleep(0.001)
    motors.may_go_on.clear()
    watchdog.command(Velocity(0.2, 0.0), 250 * MS)
    assert motors.wait_for_last(0.2, 0.0)  # the thread hangs now
    now_ns[0] = 251 * MS
    watchdog.check()
    assert motors.history[-1] == (0.0, 0.0)
    motors.may_go_on.set()
    watchdog.close()


def test_motors_that_fail_are_stopped_and_named() -> None:
    motors = FakeMotors()
    motors.failure = DeviceLost("the serial line is gone")
    watchdog = MotorWatchdog(motors)
    watchdog.command(AHEAD, later_ns(250))
    with motors.told:
        assert motors.told.wait_for(lambda: (0.3, 0.1) in motors.history and motors.history[-1] == (0.0, 0.0), 10)
    while not watchdog.fault:
        time.sleep(0.001)
    assert "serial line is gone" in watchdog.fault
    motors.failure = None
    watchdog.command(AHEAD, later_ns(250))
    while watchdog.fault:
        time.sleep(0.001)
    watchdog.close()


def test_a_watchdog_that_fails_itself_says_so_and_what_holds_is_standstill(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1)
    motors = FakeMotors()
    reports: list[Velocity] = []
    watchdog = MotorWatchdog(motors, reports.append)
    while watchdog.applied.is_zero:
        watchdog.command(AHEAD, later_ns(250))
        time.sleep(0.001)
    motors.failure = ZeroDivisionError("a bug in a driver")
    while not watchdog.fault:
        watchdog.command(AHEAD, later_ns(250))
        time.sleep(0.001)
    assert "a bug in a driver" in watchdog.fault and "restart robot-server" in watchdog.fault
    wait_until_rests(watchdog)
    assert motors.history[-1] == (0.0, 0.0) and reports[-1] == STANDSTILL
    watchdog.close()
    assert not watchdog.command(AHEAD, later_ns(250))


def test_after_close_nothing_moves_any_more() -> None:
    motors = FakeMotors()
    watchdog = MotorWatchdog(motors)
    watchdog.close()
    watchdog.close()
    assert not watchdog.command(AHEAD, later_ns(250))
    assert set(motors.history) == {(0.0, 0.0)}


def test_a_stop_that_the_motors_did_not_take_is_known_and_repeated_until_they_do() -> None:
    motors = FakeMotors()
    watchdog = MotorWatchdog(motors)
    try:
        motors.stop_fault = "the Mega is not connected"
        watchdog.stop()
        assert watchdog.stop_fault == "the Mega is not connected"
        motors.stop_fault = ""
        told = len(motors.history)
        watchdog.check()
        assert watchdog.stop_fault == "" and motors.history[told:] == [(0.0, 0.0)]
        watchdog.check()
        assert len(motors.history) == told + 1
    finally:
        watchdog.close()
