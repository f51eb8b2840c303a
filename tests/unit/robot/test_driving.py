"""One driver at a time, and only its fresh commands."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from robot.commands import CommandDesk, CommandOrder
from robot.config import DriveConfig
from robot.devices.ports import DeviceSet
from robot.watchdog import MotorWatchdog
from shared.calibration import REFERENCE_ROBOT
from shared.lease import LET_GO_NS
from shared.messages import Drive, Heartbeat, Stop
from tests.support.motors import FakeMotors

MS = 1_000_000
S = 1_000_000_000
guards: list[MotorWatchdog] = []  # of the running test


def close_guards() -> None:
    """After it nothing reaches the motors any more."""
    while guards:
        guards.pop().close()


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    close_guards()


def command(seq: int, t_station_ns: int, ttl_ms: int = 200) -> Drive:
    return Drive(seq=seq, t_station_ns=t_station_ns, linear=0.1, angular=0.0, ttl_ms=ttl_ms)


def test_the_first_to_command_drives_and_others_hear_why_they_do_not() -> None:
    command_desk, _ = desk(9 * S)
    for t in (8 * S, 9 * S):
        command_desk.handle(2, Heartbeat(seq=0, t_station_ns=t), t)
    assert command_desk.handle(1, command(1, 9 * S), 9 * S) is None
    refused = command_desk.handle(2, command(1, 9 * S), 9 * S + 1)
    assert refused is not None and refused.code == "not_driver" and "another station drives" in refused.message
    assert command_desk.handle(2, Stop(seq=2), 9 * S + 2) is None  # anybody may
    refused = command_desk.handle(1, command(2, 9 * S + 50 * MS), 9 * S + 50 * MS)
    assert refused is not None and refused.code == "not_driver" and "let go of the joystick" in refused.message
    assert command_desk.refused == 2
    command_desk.leave(1)
    resting_ns = 9 * S + 50 * MS + LET_GO_NS  # whoever comes may be the one that was stopped, under another number
    assert command_desk.handle(2, command(3, 9 * S + 60 * MS), 9 * S + 60 * MS) is not None
    assert command_desk.handle(2, command(4, resting_ns + 70 * MS), resting_ns + 70 * MS) is None


def two_stations_one_driving() -> CommandDesk:
    """Stations 1 and 2 are known long enough; 1 drives at 9 s."""
    command_desk, _ = desk(9 * S)
    for station in (1, 2):
        for t in (8 * S, 9 * S):
            command_desk.handle(station, Heartbeat(seq=0, t_station_ns=t), t)
    assert command_desk.handle(1, command(1, 9 * S), 9 * S) is None
    return command_desk


def is_refused(command_desk: CommandDesk, station: int, seq: int, t_ns: int) -> bool:
    answer = command_desk.handle(station, command(seq, t_ns), t_ns)
    assert answer is None or "let go of the joystick" in answer.message
    return answer is not None


def one_stopped_who_holds_on() -> CommandDesk:
    """Station 2 says stop at 9.01 s; 1, who drives, has not let go."""
    command_desk = two_stations_one_driving()
    command_desk.handle(2, Stop(seq=2), 9 * S + 10 * MS)
    assert is_refused(command_desk, 1, 2, 9 * S + 50 * MS)
    return command_desk


def test_a_stop_that_a_driving_station_sends_by_itself_lifts_no_other_stop() -> None:
    command_desk = two_stations_one_driving()
    command_desk.handle(2, Stop(seq=2), 9 * S + 10 * MS)
    for step in range(1, 40):  # the joystick is still held; its station's timer sends a stop in between
        t = 9 * S + 10 * MS + step * 50 * MS
        assert is_refused(command_desk, 1, 2 * step, t)
        command_desk.handle(1, Stop(seq=2 * step + 1), t + 10 * MS)


def test_who_was_stopped_before_stops_the_next_driver_as_well() -> None:
    command_desk = one_stopped_who_holds_on()
    later = 11 * S  # station 1 has fallen silent, 2 drives
    assert not is_refused(command_desk, 2, 3, later)
    command_desk.handle(1, Stop(seq=3), later + 10 * MS)
    assert is_refused(command_desk, 2, 4, later + 50 * MS)


def one_station_by_two_connections() -> CommandDesk:
    """Station "a" drives by connection 1 at 9 s and has opened 2; station "b" has 3."""
    command_desk, _ = desk(9 * S)
    for client, station in ((1, "a"), (2, "a"), (3, "b")):
        command_desk.join(client, station)
        for t in (8 * S, 9 * S):
            command_desk.handle(client, Heartbeat(seq=0, t_station_ns=t), t)
    assert command_desk.handle(1, command(1, 9 * S), 9 * S) is None
    return command_desk


def test_a_station_that_says_its_own_stop_again_by_a_new_connection_goes_on_driving() -> None:
    command_desk = one_station_by_two_connections()
    command_desk.handle(2, Stop(seq=1), 9 * S + 10 * MS)
    command_desk.leave(1)
    assert not is_refused(command_desk, 2, 2, 9 * S + 50 * MS)


def test_the_wheel_stays_with_a_station_whose_other_connection_ends() -> None:
    command_desk = one_station_by_two_connections()
    assert not is_refused(command_desk, 2, 1, 9 * S + 50 * MS)
    command_desk.leave(1)
    assert holds_motion()
    refused = command_desk.handle(3, command(1, 9 * S + 60 * MS), 9 * S + 60 * MS)
    assert refused is not None and "another station drives" in refused.message
    command_desk.leave(2)
    assert not holds_motion()
    assert not is_refused(command_desk, 3, 2, 9 * S + 70 * MS)


def test_another_stations_stop_holds_for_all_connections_of_the_one_that_drove() -> None:
    command_desk = one_station_by_two_connections()
    command_desk.handle(3, Stop(seq=1), 9 * S + 10 * MS)
    assert is_refused(command_desk, 2, 1, 9 * S + 50 * MS)
    command_desk.leave(1)
    assert is_refused(command_desk, 2, 2, 9 * S + 100 * MS)


def test_a_connection_that_breaks_is_no_letting_go() -> None:
    command_desk = one_stopped_who_holds_on()
    command_desk.leave(1)
    back = 9 * S + 60 * MS  # under another number, the joystick still held
    command_desk.handle(3, Heartbeat(seq=0, t_station_ns=back), back)
    for step in range(2, 40):
        assert is_refused(command_desk, 3, step, back + step * 50 * MS)
    zero = Drive(seq=99, t_station_ns=back + 3 * S, linear=0.0, angular=0.0, ttl_ms=200)
    assert command_desk.handle(3, zero, back + 3 * S) is None
    assert not is_refused(command_desk, 3, 100, back + 3 * S + 50 * MS)


def test_what_a_frozen_network_kept_is_no_letting_go() -> None:
    """Held on for 0.7 s unheard: of what was said then some comes too late to count, or only the newest comes."""
    for arriving in ([3, 4, 16], [16]):
        command_desk = one_stopped_who_holds_on()
        now = 9 * S + 750 * MS
        for seq in arriving:
            answer = command_desk.handle(1, command(seq, 9 * S + (seq - 1) * 50 * MS), now)
        assert answer is not None and "let go of the joystick" in answer.message


def test_a_driver_who_was_silent_beside_heartbeats_has_let_go() -> None:
    command_desk = one_stopped_who_holds_on()
    for seq in range(3, 9):
        t = 9 * S + (seq - 2) * 100 * MS
        command_desk.handle(1, Heartbeat(seq=seq, t_station_ns=t), t)
    assert not is_refused(command_desk, 1, 9, 9 * S + 700 * MS)


def test_who_comes_back_after_a_stop_was_silent_only_since() -> None:
    command_desk = two_stations_one_driving()
    command_desk.handle(2, Stop(seq=2), 9 * S + 10 * MS)
    command_desk.leave(1)
    back = 12 * S  # the connection was away for three seconds, the joystick held
    command_desk.handle(3, Heartbeat(seq=0, t_station_ns=back), back)
    for step in range(2, 20):
        assert is_refused(command_desk, 3, step, back + step * 50 * MS)
    assert not is_refused(command_desk, 3, 20, back + 2 * S)


def known(station_ahead_ns: int = 0) -> CommandOrder:
    """An order that has heard the station's clock long enough; now is 100 ms."""
    order = CommandOrder()
    for t in (0, 50 * MS, 100 * MS):
        order.observe(t + station_ahead_ns, t)
    return order


def test_older_numbers_are_ignored() -> None:
    order, now = known(), 100 * MS
    assert order.until_ns(command(5, now), now)
    assert order.until_ns(command(5, now), now + 1) is None
    assert order.until_ns(command(4, now), now + 2) is None
    assert order.until_ns(command(6, now), now + 3)


def test_a_stop_makes_commands_sent_before_it_old() -> None:
    order, now = known(), 100 * MS
    assert order.is_newest(7)
    assert order.until_ns(command(6, now), now) is None


def test_the_time_to_live_counts_from_when_it_was_said() -> None:
    order, said = known(77 * S), 100 * MS
    assert order.until_ns(command(1, said + 77 * S), said + 150 * MS) == said + 200 * MS
    assert order.until_ns(command(2, said + 77 * S), said + 200 * MS) is None


def test_a_frozen_network_cannot_replay_the_past() -> None:
    order, seq = CommandOrder(), 0
    station_ahead_ns = 77 * S
    for step in range(100):  # 5 s of driving with 5 ms of delay
        t = step * 50 * MS
        seq += 1
        is_fresh = order.until_ns(command(seq, t + station_ahead_ns), t + 5 * MS) is not None
        assert is_fresh == (step > 0)
    thaw_ns = 14 * S  # everything said from 5 s to 14 s arrives at once
    accepted = []
    for t in range(5 * S, thaw_ns, 50 * MS):
        order.observe(t + station_ahead_ns, thaw_ns)
        seq += 1
        if (until_ns := order.until_ns(command(seq, t + station_ahead_ns), thaw_ns)) is not None:
            assert until_ns <= t + 210 * MS
            accepted.append(t)
    assert accepted and min(accepted) > thaw_ns - 210 * MS


def test_a_connection_that_begins_with_an_old_burst_moves_nothing() -> None:
    """robot-server stood still right after the welcome: all the station said since is read at once, the end too."""
    order = CommandOrder()
    for seq in range(60):
        assert order.until_ns(command(seq, 9 * S + seq * 50 * MS), 20 * S) is None
    said = 9 * S + 60 * 50 * MS
    assert order.until_ns(command(60, said), 20 * S + 50 * MS) is not None  # the driver is still there


@pytest.mark.parametrize("pause_ns", [300 * MS, 5 * S])
@pytest.mark.parametrize("trip_ns", [6 * MS, 120 * MS])
def test_a_station_whose_clock_stood_still_drives_again_soon(pause_ns: int, trip_ns: int) -> None:
    """It slept, or its machine was halted; the connection survived."""
    order = CommandOrder()
    refused_ns = 0
    for step in range(20 * 20):
        now_ns = step * 50 * MS
        paused_ns = pause_ns if step >= 200 else 0
        if 200 * 50 * MS <= now_ns < 200 * 50 * MS + pause_ns:
            continue  # nothing is said
        if step % 2 == 0:
            order.note_heard(now_ns - trip_ns)
        t_station_ns = now_ns - trip_ns // 2 - paused_ns
        order.observe(t_station_ns, now_ns)
        if step > 2 and order.until_ns(command(step, t_station_ns), now_ns) is None:
            refused_ns += 50 * MS
    assert refused_ns <= 2 * S


def test_a_pause_cannot_be_feigned_by_a_network_that_froze() -> None:
    """What the station has heard by then is in the burst, too, and is as old as the burst."""
    order = CommandOrder()
    for step in range(100):  # 5 s of driving with 5 ms of delay each way
        t = step * 50 * MS
        order.note_heard(t - 5 * MS)
        order.observe(t, t + 5 * MS)
    accepted = []
    thaw_ns = 14 * S  # all said from 5 s to 14 s arrives at once; of us it has heard nothing since 5 s
    for seq, t in enumerate(range(5 * S, thaw_ns, 50 * MS)):
        order.note_heard(5 * S)
        if order.until_ns(command(seq, t), thaw_ns) is not None:
            accepted.append(t)
    assert accepted and min(accepted) > thaw_ns - 210 * MS


@pytest.mark.parametrize("there_ms", [1, 40, 120, 300, 700])
@pytest.mark.parametrize("back_ms", [1, 40, 120, 300, 700])
def test_no_motor_moves_for_half_a_second_after_the_last_word_on_a_network_that_is_always_late(
    there_ms: int, back_ms: int
) -> None:
    order, holds = CommandOrder(), []
    for step in range(20 * 70):  # longer than quick arrivals are remembered
        said_ns = step * 50 * MS
        arrived_ns = said_ns + there_ms * MS
        order.note_heard(said_ns - back_ms * MS)
        order.observe(said_ns + 77 * S, arrived_ns)
        if (until_ns := order.until_ns(command(step, said_ns + 77 * S, ttl_ms=250), arrived_ns)) is not None:
            holds.append(until_ns - said_ns)
    assert max(holds, default=0) <= 450 * MS
    if there_ms + back_ms <= 200:
        assert min(holds[1:]) == (250 + there_ms) * MS, "a usual network takes nothing of a command's life"


def test_where_the_robots_clock_stood_still_on_a_late_network_motors_stop_as_soon() -> None:
    order, holds = CommandOrder(), []
    for step in range(20 * 100):
        said_ns = step * 50 * MS
        by_station_ns = said_ns + (20 * S if said_ns >= 30 * S else 0)
        order.note_heard(said_ns - 5 * MS)
        order.observe(by_station_ns, said_ns + 600 * MS)
        if (until_ns := order.until_ns(command(step, by_station_ns, ttl_ms=250), said_ns + 600 * MS)) is not None:
            holds.append(until_ns - said_ns)
    assert max(holds, default=0) <= 450 * MS


def test_a_network_that_becomes_late_for_good_gets_no_more_time_when_the_quick_days_are_forgotten() -> None:
    order, holds = CommandOrder(), []
    for step in range(20 * 200):
        said_ns = step * 50 * MS
        late_ns = (600 if said_ns > 60 * S else 3) * MS
        order.note_heard(said_ns - late_ns)
        order.observe(said_ns, said_ns + late_ns)
        if (until_ns := order.until_ns(command(step, said_ns, ttl_ms=250), said_ns + late_ns)) is not None:
            holds.append(until_ns - said_ns)
    assert max(holds) <= 450 * MS


def test_drifting_clocks_do_not_make_commands_stale() -> None:
    order = CommandOrder()
    for step in range(20 * 300):  # five minutes, 500 ppm as NTP may slew a clock: they part by 150 ms
        t = step * 50 * MS
        until_ns = order.until_ns(command(step, int(t * 0.9995)), t + (step * 7919 % 20) * MS)
        assert step < 2 or until_ns is not None


def test_a_queue_that_fills_is_not_taken_for_a_drift() -> None:
    """No crystal drifts by 18 ms a second: what comes that much later each second is old."""
    order = CommandOrder()
    fresh_ms = []
    for step in range(20 * 30):
        t = step * 50 * MS
        late_ns = t * 18 // 1000
        if order.until_ns(command(step, t), t + late_ns) is not None:
            fresh_ms.append(late_ns // MS)
    assert max(fresh_ms) <= 200


def desk(now_ns: int) -> tuple[CommandDesk, FakeMotors]:
    """A desk whose motors' clock stands at `now_ns`; station 1 has been heard long enough."""
    motors = FakeMotors()
    devices = DeviceSet(calibration=REFERENCE_ROBOT, camera=None, imu=None, motors=motors)
    guards.append(MotorWatchdog(motors, now_ns=lambda: now_ns))
    command_desk = CommandDesk(devices, guards[-1], DriveConfig())
    for t in (8 * S, 9 * S):
        command_desk.handle(1, Heartbeat(seq=0, t_station_ns=t), t)
    return command_desk, motors


def holds_motion() -> bool:
    """Whether the motors' guard wants them to move, told or not yet: its thread may not have had a turn."""
    return guards[-1]._guard.next_deadline_ns() is not None


def test_letting_go_counts_however_late_it_is_read() -> None:
    command_desk, motors = desk(9 * S)
    command_desk.handle(1, Drive(seq=1, t_station_ns=9 * S, linear=0.1, angular=0.0, ttl_ms=250), 9 * S)
    assert motors.wait_for_last(0.1, 0.0)
    late = Drive(seq=2, t_station_ns=8 * S, linear=0.0, angular=0.0, ttl_ms=100)
    command_desk.handle(1, late, 9 * S)
    assert motors.wait_for_last(0.0, 0.0)


def test_a_command_read_before_and_carried_out_after_a_standstill_moves_nothing() -> None:
    """SIGSTOP between reading and the motors: the clock has gone on when the command is carried out."""
    command_desk, motors = desk(11 * S)
    command_desk.handle(1, Drive(seq=1, t_station_ns=9 * S, linear=0.1, angular=0.0, ttl_ms=250), 9 * S)
    assert not holds_motion()
    close_guards()
    assert (0.1, 0.0) not in motors.history


@pytest.mark.parametrize(("late_ms", "starts"), [(90, True), (110, False)])
def test_a_command_starts_motors_only_in_the_first_half_of_its_life(late_ms: int, starts: bool) -> None:
    """The driver fell silent; what it had said last comes when the motors rest, and is not over yet."""
    command_desk, motors = desk(9 * S + late_ms * MS)
    command_desk.handle(1, command(1, 9 * S), 9 * S + late_ms * MS)
    assert holds_motion() is starts and (not starts or motors.wait_for_last(0.1, 0.0))
    close_guards()
    assert ((0.1, 0.0) in motors.history) is starts
