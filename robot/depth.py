"""Depth pictures that wait for stations: the newest only, and no more than a share of what a station's link carries."""

from __future__ import annotations

from robot.devices.ports import CapturedDepth
from robot.link_meter import LinkMeter
from robot.video import MAX_WAIT_NS, THIN_BYTES_PER_S
from shared.messages import Depth

# A robot at 0.4 m/s has moved 10 cm since the last one: what is nearer together shows the same again.
LEAST_INTERVAL_NS = 250_000_000
SHARE = 0.25  # of the link's bytes: pictures are what people drive by
# A range sensor's pixel (68 bytes) goes whatever the link: four a second are less than the answers to heartbeats.
# A robot without a camera never learns what its link carries, and its driver sees nothing else.
ALWAYS_BYTES = 256


class DepthSlot:
    """The newest depth picture."""

    def __init__(self) -> None:
        self.newest: CapturedDepth | None = None
        self.count = 0  # how many the sensor has made

    def put(self, depth: CapturedDepth) -> None:
        self.newest = depth
        self.count += 1


class DepthStream:
    """Which depth pictures one station gets. Starts with the next one. Time is an argument."""

    def __init__(self, slot: DepthSlot, meter: LinkMeter, *, is_on_this_machine: bool) -> None:
        self._slot = slot
        self._meter = meter
        self._is_on_this_machine = is_on_this_machine
        self._sent = slot.count
        self._due_ns = 0

    @property
    def is_at_end(self) -> bool:
        """Whether the newest one was sent or passed over."""
        return self._sent == self._slot.count

    def next_depth(self, now_ns: int) -> Depth | None:
        """The one that is to be sent now; None when there is none, or the link has enough to carry."""
        newest, estimate = self._slot.newest, self._meter.estimate
        if newest is None or self.is_at_end or now_ns < self._due_ns or not self._meter.has_room(now_ns):
            return None
        interval_ns = LEAST_INTERVAL_NS
        if estimate is None and not self._is_on_this_machine and len(newest.png) > ALWAYS_BYTES:
            return None
        # Little carried on this machine is a relay to a network.
        if estimate is not None and not (self._is_on_this_machine and estimate.bytes_per_s > THIN_BYTES_PER_S):
            service_ns = 1e9 * len(newest.png) / estimate.bytes_per_s
            if service_ns > MAX_WAIT_NS:  # what waits behind it would be too old to be sent
                self._sent = self._slot.count
                return None
            interval_ns = max(interval_ns, round(service_ns / SHARE))
        self._due_ns = now_ns + interval_ns
        self._sent = self._slot.count
        return Depth(seq=self._slot.count - 1, t_robot_ns=newest.t_robot_ns, png=newest.png)
