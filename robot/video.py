"""Pictures that wait for stations: the newest only, and as large and as often as each station's link takes them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from robot.devices.ports import CapturedFrame
from robot.frame_budget import (
    BEFORE_MEASURED,
    UNLIMITED,
    FrameBudget,
    SizeModel,
    budget,
)
from robot.link_meter import LinkMeter
from shared.messages import MAX_FRAMES_IN_FLIGHT, CameraFrame

# Of the 250 ms after which no picture is worth sending, exposure, readout and compression take 50 at most.
MAX_WAIT_NS = 200_000_000
RECONSIDERED_NS = 1_000_000_000  # how often the rate may change: one that swings is not even
FIRST_PERIOD_NS = 33_000_000
# On this machine nothing is made smaller while more than this is carried: what looks thin is a busy machine, which
# making pictures smaller would keep busier. Less than this is a relay to a network.
THIN_BYTES_PER_S = 1_000_000.0
HERE_IN_FLIGHT = 3
LONGEST_PERIOD_NS = 500_000_000


@dataclass(slots=True)
class Picture:
    """A camera frame and what was made of it for thin links."""

    frame: CapturedFrame
    seq: int  # counts every frame the camera made
    taken_ns: int  # when the camera handed it out
    smaller: dict[int, bytes | None] = field(default_factory=dict)  # quality → JPEG; None: being made

    def is_late(self, now_ns: int) -> bool:
        return now_ns - self.taken_ns > MAX_WAIT_NS


class FrameSlot:
    """The newest camera frame."""

    def __init__(self, make_smaller: Callable[[Picture, int], None]) -> None:
        """`make_smaller` makes a picture of that quality in the background, and wakes whoever waits for it."""
        self._make_smaller = make_smaller
        self.newest: Picture | None = None
        self.count = 0  # how many frames the camera has made
        self.period_ns = FIRST_PERIOD_NS  # from one to the next

    def put(self, frame: CapturedFrame, now_ns: int) -> None:
        if self.newest is not None:
            since_ns = min(now_ns - self.newest.taken_ns, LONGEST_PERIOD_NS)
            self.period_ns = max(1, (7 * self.period_ns + since_ns) // 8)
        self.newest = Picture(frame, self.count, now_ns)
        self.count += 1

    def jpeg(self, picture: Picture, quality: int | None) -> bytes | None:
        """The picture at a quality (None: the camera's own); None while it is being made."""
        if quality is None:
            return picture.frame.jpeg
        if quality not in picture.smaller:
            picture.smaller[quality] = None
            self._make_smaller(picture, quality)
        return picture.smaller[quality]


class VideoStream:
    """Which frames one station gets, of which size. Starts with the next one. Time is an argument."""

    def __init__(self, slot: FrameSlot, meter: LinkMeter, *, is_on_this_machine: bool = False) -> None:
        """`is_on_this_machine`: no network lies between, unless little is carried."""
        self._is_on_this_machine = is_on_this_machine
        self._slot = slot
        self._meter = meter
        self._looked = slot.count  # frames before were sent, or passed over
        self._sent = slot.count - 1  # number of the frame sent last
        self._sent_taken_ns = -LONGEST_PERIOD_NS  # when the camera handed it out
        self._chosen: tuple[Picture, int | None] | None = None  # waits for its JPEG
        self._in_flight: deque[int] = deque()  # numbers of frames not confirmed yet
        self._budget = UNLIMITED if is_on_this_machine else BEFORE_MEASURED
        self._considered_ns = 0
        self._sizes = SizeModel()
        self.is_thin = False  # whether pictures ever had to be made smaller or rarer, by a settled estimate
        self.skipped = 0

    def change_way(self, meter: LinkMeter) -> None:
        """From now on they go another way, of which nothing is known or what this meter knows."""
        self._meter = meter
        self._in_flight.clear()
        self._budget = BEFORE_MEASURED

    @property
    def is_at_end(self) -> bool:
        """Whether the newest frame was sent or passed over."""
        return self._slot.count == self._looked and self._chosen is None

    def next_frame(self, now_ns: int) -> CameraFrame | None:
        """The frame that is to be sent now; None when there is none, or the link has enough to carry."""
        if self._chosen is None:
            self._chosen = self._choose(now_ns)
        if self._chosen is None:
            return None
        picture, quality = self._chosen
        jpeg = self._slot.jpeg(picture, quality)
        if jpeg is None and not picture.is_late(now_ns):
            return None
        self._chosen = None
        if jpeg is None or picture.is_late(now_ns):
            return None
        if quality is not None and jpeg is not picture.frame.jpeg:
            self._sizes.learn(len(picture.frame.jpeg), quality, len(jpeg))
        return self._message(picture, jpeg, quality)

    def confirm(self, seq: int) -> int:
        """The station has this frame and all before it. Returns how many that are."""
        count = len(self._in_flight)
        while self._in_flight and self._in_flight[0] <= seq:
            self._in_flight.popleft()
        return count - len(self._in_flight)

    def _choose(self, now_ns: int) -> tuple[Picture, int | None] | None:
        picture = self._slot.newest
        if picture is None or picture.seq < self._looked:
            return None
        if picture.is_late(now_ns):
            self._looked = self._slot.count
            return None
        self._reconsider(picture, now_ns)
        if not self._has_room(now_ns) or not self._is_due(picture, now_ns):
            return None
        self._looked = self._slot.count
        return picture, self._sizes.quality(len(picture.frame.jpeg), self._budget.num_bytes)

    @property
    def _is_unlimited(self) -> bool:
        estimate = self._meter.estimate
        return self._is_on_this_machine and (estimate is None or estimate.bytes_per_s > THIN_BYTES_PER_S)

    def _has_room(self, now_ns: int) -> bool:
        if self._is_unlimited:
            return len(self._in_flight) < HERE_IN_FLIGHT
        return len(self._in_flight) < MAX_FRAMES_IN_FLIGHT and self._meter.has_room(now_ns)

    def _is_due(self, picture: Picture, now_ns: int) -> bool:
        """By the camera's own beat, so that the gaps are even; by our clock where the camera paused."""
        interval_ns, period_ns = self._budget.interval_ns, self._slot.period_ns
        since_ns = picture.taken_ns - self._sent_taken_ns
        return since_ns >= interval_ns - period_ns // 2 or now_ns - self._sent_taken_ns >= interval_ns + period_ns

    def _reconsider(self, picture: Picture, now_ns: int) -> None:
        estimate = self._meter.estimate
        if self._is_unlimited:
            self._budget = UNLIMITED
        if estimate is None or self._is_unlimited:
            return
        own_bytes = len(picture.frame.jpeg)
        wanted = budget(estimate, own_bytes, self._sizes, self._slot.period_ns, self._budget)
        is_whole = wanted.interval_ns == 0 and wanted.num_bytes >= own_bytes
        self.is_thin |= self._meter.is_settled and not is_whole
        if now_ns - self._considered_ns >= RECONSIDERED_NS or self._budget in (UNLIMITED, BEFORE_MEASURED):
            self._considered_ns = now_ns
            self._budget = wanted
        else:
            period_ns = self._slot.period_ns
            share = max(self._budget.interval_ns, period_ns) / max(wanted.interval_ns, period_ns)
            self._budget = FrameBudget(wanted.num_bytes * min(1.0, share), self._budget.interval_ns)

    def _message(self, picture: Picture, jpeg: bytes, quality: int | None) -> CameraFrame:
        skipped = picture.seq - self._sent - 1
        self.skipped += skipped
        self._sent, self._sent_taken_ns = picture.seq, picture.taken_ns
        self._in_flight.append(picture.seq)
        frame = picture.frame
        return CameraFrame(
            seq=picture.seq,
            t_robot_ns=frame.t_robot_ns,
            exposure_ns=frame.exposure_ns,
            width=frame.width,
            height=frame.height,
            skipped=skipped,
            quality=0 if jpeg is frame.jpeg else quality or 0,
            jpeg=jpeg,
        )
