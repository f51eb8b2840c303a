"""Commands by two ways: whatever a network does to the datagrams, no old, repeated or forged one moves a motor."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from robot.commands import CommandOrder
from robot.datagram_path import DatagramPath
from shared.clock import MAX_CRYSTAL_DRIFT
from shared.datagrams import KEY_BYTES, Sealer
from shared.message_codec import encode_message
from shared.messages import Datagrams, Drive, Stop

MS, S = 1_000_000, 1_000_000_000
TOLD = Datagrams(session=7, key_to_station=bytes(KEY_BYTES), key_to_robot=bytes(range(KEY_BYTES)))
TICK_NS, TTL_MS, STATION_BEHIND_NS = 50 * MS, 200, 5 * S


def said_at(seq: int) -> int:
    return 10 * S + seq * TICK_NS


def drive(seq: int) -> Drive:
    return Drive(seq=seq, t_station_ns=said_at(seq) - STATION_BEHIND_NS, linear=0.1, angular=0.0, ttl_ms=TTL_MS)


def known_order() -> CommandOrder:
    """A connection whose delay is known: its quickest way takes nothing."""
    order = CommandOrder()
    for t_ns in range(8 * S, 10 * S, 100 * MS):
        order.observe(t_ns - STATION_BEHIND_NS, t_ns)
    return order


@settings(deadline=None)
@given(
    num=st.integers(2, 40),
    stops=st.sets(st.integers(1, 40)),
    loss=st.floats(0, 0.9),
    most_late_ms=st.integers(0, 2000),
    seed=st.integers(0, 2**32),
)
def test_nothing_older_than_a_stop_than_another_command_or_than_its_life_moves_a_motor(
    num: int, stops: set[int], loss: float, most_late_ms: int, seed: int
) -> None:
    rng = random.Random(seed)
    sealer, forger = Sealer(TOLD.key_to_robot, TOLD.session), Sealer(TOLD.key_to_station, TOLD.session)
    path, order = DatagramPath(TOLD), known_order()
    arrivals: list[tuple[int, int, bytes | Drive | Stop | int]] = []
    connection_ns = 0
    for seq in range(1, num + 1):
        said = Stop(seq=seq) if seq in stops else drive(seq)
        content = encode_message(said)
        for datagram in (sealer.seal(content), sealer.seal(content)):
            for _ in range(rng.choice([1, 1, 2, 3])):  # and what a stranger keeps and sends again
                if rng.random() >= loss:
                    arrivals.append((said_at(seq) + rng.randint(0, most_late_ms) * MS, len(arrivals), datagram))
        damaged = bytearray(forger.seal(content))
        arrivals.append((said_at(seq), len(arrivals), bytes(damaged)))
        damaged = bytearray(sealer.seal(content))
        damaged[rng.randrange(len(damaged))] ^= rng.randrange(1, 256)
        arrivals.append((said_at(seq), len(arrivals), bytes(damaged)))
        arrivals.append((said_at(seq), len(arrivals), bytes(damaged[: rng.randrange(len(damaged))])))
        connection_ns = max(connection_ns, said_at(seq) + rng.randint(0, most_late_ms) * MS)  # it keeps the order
        arrivals.append((connection_ns, len(arrivals), said))
        arrivals.append((connection_ns, len(arrivals), said_at(seq)))  # and then: what we sent until then was heard
    newest = 0
    stopped: list[int] = []
    for t_ns, _, item in sorted(arrivals, key=lambda arrival: arrival[:2]):
        if isinstance(item, int):
            order.note_heard(item)
            continue
        is_datagram = isinstance(item, bytes)
        command = path.receive(item, t_ns) if isinstance(item, bytes) else item
        if not isinstance(command, Drive | Stop):
            continue
        if isinstance(command, Stop):
            if order.is_first(command.seq, is_datagram=is_datagram):
                order.is_newest(command.seq)
                stopped.append(command.seq)
                newest = max(newest, command.seq)
            continue
        is_first = order.is_first(command.seq, is_datagram=is_datagram)
        until_ns = order.until_ns(command, t_ns, is_datagram=is_datagram)
        if is_first and until_ns is not None:
            assert command.seq > newest
            assert t_ns < until_ns <= said_at(command.seq) + TTL_MS * MS + MAX_CRYSTAL_DRIFT * (t_ns - 8 * S)
            newest = command.seq
    assert len(stopped) == len(set(stopped))
    assert set(stopped) == {seq for seq in stops if seq <= num}, "each stop counts, once"


def test_what_was_held_back_until_the_station_woke_moves_nothing() -> None:
    """Its clock stood still meanwhile: measured by it the old command looks fresh."""
    order, slept_ns = known_order(), 5 * S
    order.note_heard(said_at(0) + slept_ns)
    woken = Drive(seq=9, t_station_ns=said_at(9) - STATION_BEHIND_NS, linear=0.1, angular=0.0, ttl_ms=TTL_MS)
    assert order.until_ns(woken, said_at(9) + slept_ns, is_datagram=True) is None, "no datagram shows a pause"
    order.observe(said_at(8) - STATION_BEHIND_NS, said_at(9) + slept_ns)  # the connection does
    order.observe(said_at(10) - STATION_BEHIND_NS, said_at(10) + slept_ns)
    at_ns = said_at(11) + slept_ns
    held_back = Drive(seq=20, t_station_ns=said_at(7) - STATION_BEHIND_NS, linear=0.1, angular=0.0, ttl_ms=TTL_MS + 50)
    assert order.until_ns(held_back, at_ns, is_datagram=True) is None
    fresh = Drive(seq=21, t_station_ns=said_at(11) - STATION_BEHIND_NS, linear=0.1, angular=0.0, ttl_ms=TTL_MS)
    assert order.until_ns(fresh, at_ns, is_datagram=True) is not None
