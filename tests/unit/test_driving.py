"""One driver at a time, and only its fresh commands."""

from __future__ import annotations

from robot.driving import LEASE_NS, RELEASE_NS, CommandOrder, DriverLease
from shared.messages import Drive

MS = 1_000_000
S = 1_000_000_000


def command(seq: int, t_station_ns: int, ttl_ms: int = 200) -> Drive:
    return Drive(seq=seq, t_station_ns=t_station_ns, linear=0.1, angular=0.0, ttl_ms=ttl_ms)


def test_the_first_to_command_drives_and_others_are_told() -> None:
    lease = DriverLease()
    assert lease.request(1, False, 10 * S) == ""
    assert "another station drives" in lease.request(2, False, 10 * S + 1)


def test_the_wheel_is_free_after_silence() -> None:
    lease = DriverLease()
    lease.request(1, False, 10 * S)
    assert lease.request(2, False, 10 * S + LEASE_NS - 1)
    assert lease.request(2, False, 10 * S + LEASE_NS) == ""


def test_who_leaves_gives_the_wheel_away() -> None:
    lease = DriverLease()
    lease.request(1, False, 10 * S)
    assert not lease.release(2)
    assert lease.release(1)
    assert lease.request(2, False, 10 * S + 1) == ""


def test_a_stop_by_somebody_else_holds_until_the_driver_lets_go() -> None:
    lease = DriverLease()
    lease.request(1, False, 10 * S)
    lease.stop(2)
    now_ns = 10 * S
    for _ in range(100):  # the joystick is still held
        now_ns += 50 * MS
        assert "let go" in lease.request(1, False, now_ns)
    assert lease.request(1, True, now_ns + 50 * MS) == ""
    assert lease.request(1, False, now_ns + 100 * MS) == ""


def test_half_a_second_of_silence_is_letting_go() -> None:
    lease = DriverLease()
    lease.request(1, False, 10 * S)
    lease.stop(2)
    assert lease.request(1, False, 10 * S + RELEASE_NS) == ""


def test_the_drivers_own_stop_needs_no_letting_go() -> None:
    lease = DriverLease()
    lease.request(1, False, 10 * S)
    lease.stop(1)
    assert lease.request(1, False, 10 * S + 50 * MS) == ""


def test_older_numbers_are_ignored() -> None:
    order = CommandOrder()
    assert order.is_fresh(command(5, 0), 100)
    assert not order.is_fresh(command(5, 0), 101)
    assert not order.is_fresh(command(4, 0), 102)
    assert order.is_fresh(command(6, 0), 103)


def test_a_stop_makes_commands_sent_before_it_old() -> None:
    order = CommandOrder()
    assert order.is_newest(7)
    assert not order.is_fresh(command(6, 0), 1)


def test_a_frozen_network_cannot_replay_the_past() -> None:
    order, seq = CommandOrder(), 0
    station_ahead_ns = 77 * S
    for step in range(100):  # 5 s of driving with 5 ms of delay
        t = step * 50 * MS
        seq += 1
        assert order.is_fresh(command(seq, t + station_ahead_ns), t + 5 * MS)
    thaw_ns = 14 * S  # everything said from 5 s to 14 s arrives at once
    accepted = []
    for t in range(5 * S, thaw_ns, 50 * MS):
        order.observe(t + station_ahead_ns, thaw_ns)
        seq += 1
        if order.is_fresh(command(seq, t + station_ahead_ns), thaw_ns):
            accepted.append(t)
    assert accepted and min(accepted) > thaw_ns - 210 * MS


def test_drifting_clocks_do_not_make_commands_stale() -> None:
    order = CommandOrder()
    for step in range(20 * 300):  # five minutes, 5000 ppm: the clocks part by 1.5 s
        t = step * 50 * MS
        assert order.is_fresh(command(step, int(t * 0.995)), t + (step * 7919 % 20) * MS)
