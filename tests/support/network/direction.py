"""One direction of an emulated network: decides when a packet arrives, or that it does not. Time is an argument."""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass

from tests.support.network.conditions import Conditions

MS, S = 1_000_000, 1_000_000_000


@dataclass(slots=True)
class Counts:
    """What became of the packets of one direction."""

    packets: int = 0  # that were sent into it
    delivered: int = 0
    delivered_bytes: int = 0
    lost: int = 0
    overflowed: int = 0  # dropped before a full queue
    in_outage: int = 0
    latest_ms: float = 0.0  # by so much at most was one delivered later than it was due: the emulator's own fault


class Direction:
    """A bottleneck with a queue, then the air (loss, outage), then a delay.

    The same seed and the same packets at the same times give the same fates. Which packets are lost depends on their
    number alone, the delay on the time alone.
    """

    def __init__(self, conditions: Conditions, seed: str, begin_ns: int) -> None:
        self.conditions = conditions  # may be changed while packets are on their way
        self.counts = Counts()
        self._seed, self._begin_ns = seed, begin_ns
        self._random = random.Random(seed)
        self._is_in_burst = False
        self._free_ns = begin_ns  # when the bottleneck has sent what waits before it
        self._newest_due_ns = begin_ns
        self._under_way: list[tuple[int, int, bytes]] = []  # heap of (due, number, packet)
        self._jitter_slot, self._jitter = -1, 0.0

    @property
    def next_due_ns(self) -> int | None:
        """When the next packet arrives."""
        return self._under_way[0][0] if self._under_way else None

    def send(self, packet: bytes, now_ns: int) -> None:
        """A packet enters."""
        self.counts.packets += 1
        sent_ns = self._pass_bottleneck(len(packet), now_ns)
        if sent_ns is None:
            self.counts.overflowed += 1
        elif self._is_lost():
            self.counts.lost += 1
        elif self._is_outage(sent_ns):
            self.counts.in_outage += 1
        else:
            heapq.heappush(self._under_way, (self._due_ns(sent_ns), self.counts.packets, packet))

    def arrived(self, now_ns: int) -> list[bytes]:
        """The packets that have arrived by now, in the order of their arrival."""
        packets = []
        while self._under_way and self._under_way[0][0] <= now_ns:
            due_ns, _, packet = heapq.heappop(self._under_way)
            packets.append(packet)
            self.counts.delivered += 1
            self.counts.delivered_bytes += len(packet)
            self.counts.latest_ms = max(self.counts.latest_ms, (now_ns - due_ns) / MS)
        return packets

    def _pass_bottleneck(self, num_bytes: int, now_ns: int) -> int | None:
        """When the last bit is sent; None when the queue is full."""
        conditions = self.conditions
        if not conditions.rate_mbit_s:
            return now_ns
        begin_ns = max(now_ns, self._free_ns)
        if begin_ns - now_ns > conditions.queue_ms * MS:
            return None
        self._free_ns = begin_ns + round(num_bytes * 8000 / conditions.rate_mbit_s)
        return self._free_ns

    def _is_lost(self) -> bool:
        """Gilbert-Elliott: a good state with independent loss and a bad one that loses all.

        Source: Gilbert, Bell System Technical Journal 39(5), 1960; Elliott, 42(5), 1963. With a share b of packets in
        the bad state and L packets in it each time, it is left with 1 / L and entered with b / (1 - b) / L.
        """
        conditions = self.conditions
        change, loss = self._random.random(), self._random.random()  # both for every packet: fates go by number
        if self._is_in_burst:
            self._is_in_burst = change >= 1 / conditions.burst_packets
        else:
            share = conditions.burst_loss
            self._is_in_burst = change * (1 - share) * conditions.burst_packets < share
        return self._is_in_burst or loss < conditions.loss

    def _is_outage(self, t_ns: int) -> bool:
        every_ns, outage_ns = self.conditions.outage_every_s * S, self.conditions.outage_s * S
        return bool(every_ns) and (t_ns - self._begin_ns) % every_ns >= every_ns - outage_ns

    def _due_ns(self, sent_ns: int) -> int:
        conditions = self.conditions
        due_ns = sent_ns + round((conditions.delay_ms + self._jitter_ms(sent_ns)) * MS)
        due_ns = max(due_ns, self._newest_due_ns)
        if self._random.random() < conditions.reordered:
            return due_ns + round(conditions.reordered_by_ms * MS)
        self._newest_due_ns = due_ns
        return due_ns

    def _jitter_ms(self, t_ns: int) -> float:
        """Anew for every 2 · jitter, the time in which an earlier delay has surely passed: only the first packets
        after a change wait for those before them."""
        jitter_ms = self.conditions.jitter_ms
        if not jitter_ms:
            return 0.0
        slot = int((t_ns - self._begin_ns) / (2 * jitter_ms * MS))
        if slot != self._jitter_slot:
            self._jitter_slot = slot
            self._jitter = random.Random(f"{self._seed} {slot}").uniform(-1, 1)
        return self._jitter * jitter_ms
