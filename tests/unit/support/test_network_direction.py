"""One direction of the emulated network, with a clock of the test's own."""

from __future__ import annotations

import itertools

import pytest

from tests.support.network.conditions import PROFILES, Conditions
from tests.support.network.direction import MS, Direction, S

PACKET = bytes(1250)  # 10 kbit: 1 ms at 10 Mbit/s
FOREVER_NS = 10**18


def numbered(n: int) -> bytes:
    return n.to_bytes(4, "big") + PACKET[4:]


def arrivals(conditions: Conditions, sent_ns: list[int], seed: str = "1") -> dict[int, int]:
    """When each packet arrives that does, in the order of arrival."""
    direction = Direction(conditions, seed, 0)
    arrived: dict[int, int] = {}

    def deliver(until_ns: int) -> None:
        while direction.next_due_ns is not None and direction.next_due_ns <= until_ns:
            due_ns = direction.next_due_ns
            arrived.update({int.from_bytes(packet[:4], "big"): due_ns for packet in direction.arrived(due_ns)})

    for n, t_ns in enumerate(sent_ns):
        deliver(t_ns)
        direction.send(numbered(n), t_ns)
    deliver(FOREVER_NS)
    return arrived


def every(period_ns: int, count: int) -> list[int]:
    return [n * period_ns for n in range(count)]


def test_nothing_asked_means_nothing_done() -> None:
    assert arrivals(Conditions(), every(MS, 5)) == {n: n * MS for n in range(5)}


def test_bottleneck_sends_one_after_the_other_and_delay_comes_on_top() -> None:
    arrived = arrivals(Conditions(rate_mbit_s=10, delay_ms=20), [0, 0, 0, 50 * MS])
    assert arrived == {0: 21 * MS, 1: 22 * MS, 2: 23 * MS, 3: 71 * MS}


def test_queue_holds_so_many_milliseconds_and_drops_what_comes_on_top() -> None:
    arrived = arrivals(Conditions(rate_mbit_s=10, queue_ms=5), [0] * 100)
    assert list(arrived) == [0, 1, 2, 3, 4, 5]


def test_share_of_independent_losses_is_what_was_asked() -> None:
    arrived = arrivals(Conditions(loss=0.1), every(MS, 20_000))
    assert 1 - len(arrived) / 20_000 == pytest.approx(0.1, abs=0.01)  # 5 sigma


def test_burst_losses_have_the_share_and_the_length_that_were_asked() -> None:
    num = 200_000
    arrived = arrivals(Conditions(burst_loss=0.02, burst_packets=5), every(MS, num))
    lost = [n not in arrived for n in range(num)]
    bursts = [len(list(run)) for is_lost, run in itertools.groupby(lost) if is_lost]
    assert sum(lost) / num == pytest.approx(0.02, abs=0.005)
    assert sum(bursts) / len(bursts) == pytest.approx(5, abs=0.7)


def test_delay_wanders_as_far_as_was_asked_and_packets_stay_in_order() -> None:
    sent = every(MS, 20_000)
    arrived = arrivals(Conditions(delay_ms=40, jitter_ms=30), sent)
    delays_ms = [(arrived[n] - t_ns) / MS for n, t_ns in enumerate(sent)]
    assert list(arrived) == sorted(arrived)
    assert min(delays_ms) >= 10 and max(delays_ms) <= 70
    assert min(delays_ms) < 12 and max(delays_ms) > 68
    # Waiting for those before them makes some later, by a few milliseconds in the mean.
    assert 40 - 3 < sum(delays_ms) / len(delays_ms) < 40 + 8


def test_reordered_packets_are_overtaken_and_the_others_are_not_held_up() -> None:
    sent = every(MS, 10_000)
    arrived = arrivals(Conditions(delay_ms=5, reordered=0.1, reordered_by_ms=7.5), sent)
    late = {n for n, t_ns in enumerate(sent) if arrived[n] - t_ns == round(12.5 * MS)}
    assert all(arrived[n] - sent[n] == 5 * MS for n in range(len(sent)) if n not in late)
    assert len(late) / len(sent) == pytest.approx(0.1, abs=0.02)
    assert list(arrived) != sorted(arrived)


def test_all_is_lost_in_an_outage_and_nothing_before_or_after() -> None:
    sent = every(10 * MS, 3000)
    arrived = arrivals(Conditions(outage_every_s=10, outage_s=0.5), sent)
    lost = [t_ns for n, t_ns in enumerate(sent) if n not in arrived]
    assert lost == [t_ns for t_ns in sent if t_ns % (10 * S) >= 9.5 * S]


def test_changed_conditions_hold_for_later_packets_alone() -> None:
    direction = Direction(Conditions(delay_ms=100), "1", 0)
    direction.send(numbered(0), 0)
    direction.conditions = Conditions(loss=1.0)
    direction.send(numbered(1), MS)
    direction.conditions = Conditions()
    direction.send(numbered(2), 200 * MS)
    assert [packet[3] for packet in direction.arrived(FOREVER_NS)] == [0, 2]


@pytest.mark.parametrize("name", PROFILES)
def test_same_seed_same_fates_and_another_seed_others(name: str) -> None:
    sent = every(7 * MS, 3000)
    arrived = arrivals(PROFILES[name], sent, "1")
    assert arrivals(PROFILES[name], sent, "1") == arrived
    assert arrivals(PROFILES[name], sent, "2") != arrived


def test_every_packet_is_accounted_for() -> None:
    direction = Direction(
        Conditions(rate_mbit_s=1, queue_ms=50, delay_ms=5, loss=0.2, outage_every_s=1, outage_s=0.2), "1", 0
    )
    for n in range(2000):
        direction.send(PACKET, n * 5 * MS)
    assert len(direction.arrived(FOREVER_NS)) == direction.counts.delivered
    counts = direction.counts
    assert min(counts.delivered, counts.lost, counts.overflowed, counts.in_outage) > 0
    assert counts.delivered + counts.lost + counts.overflowed + counts.in_outage == counts.packets == 2000
