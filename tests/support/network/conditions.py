"""What a network does to packets, and the five networks of a home that robots are tried on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Conditions:
    """Holds for each direction by itself: what one carries takes nothing from the other."""

    rate_mbit_s: float = 0.0  # of IP packets; 0: no limit, and no queue
    queue_ms: float = (
        200.0  # what waits before the bottleneck at most, as time to send it; what comes on top is dropped
    )
    delay_ms: float = 0.0  # one way, beside the queue
    jitter_ms: float = 0.0  # the delay is uniform in delay ± jitter, a new one every 2 · jitter; packets stay in order
    loss: float = 0.0  # share of packets, each by itself
    burst_loss: float = 0.0  # share of packets, lost in bursts
    burst_packets: float = 5.0  # mean length of such a burst
    reordered: float = 0.0  # share of packets that those behind them overtake
    reordered_by_ms: float = 10.0  # by so much they come later
    outage_every_s: float = 0.0  # 0: never; counted from the start of the network
    outage_s: float = 0.0  # at the end of each such period all packets are lost for so long


PROFILES = {
    "good Wi-Fi": Conditions(rate_mbit_s=40, delay_ms=3, loss=0.001),
    "busy 2.4 GHz": Conditions(rate_mbit_s=6, delay_ms=15, jitter_ms=10, burst_loss=0.02),
    "two walls": Conditions(rate_mbit_s=2, delay_ms=40, jitter_ms=30, loss=0.05),
    # 60 ms as the other links of this rate, and up to 300 ms more.
    "bad": Conditions(rate_mbit_s=1, delay_ms=210, jitter_ms=150, loss=0.1),
    "roaming": Conditions(rate_mbit_s=40, delay_ms=3, loss=0.001, outage_every_s=10, outage_s=0.5),
}
