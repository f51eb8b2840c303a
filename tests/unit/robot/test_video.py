"""Pictures fit the link: fresh and even at any rate, one too many at most, larger again when there is room."""

from __future__ import annotations

import heapq
import itertools
import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.devices.ports import CapturedFrame
from robot.frame_budget import LEAST_QUALITY, SIZE_AT, UNLIMITED, FrameBudget, SizeModel, budget
from robot.link_meter import LinkEstimate, LinkMeter
from robot.video import HERE_IN_FLIGHT, MAX_WAIT_NS, FrameSlot, Picture, VideoStream
from shared.messages import MAX_FRAMES_IN_FLIGHT

MS, S = 1_000_000, 1_000_000_000
STATION_AHEAD_NS = 7_000 * S  # its clock before the robot's
OWN_BYTES = 70_000  # of a picture as the simulated camera makes it


def captured(num_bytes: int = OWN_BYTES) -> CapturedFrame:
    return CapturedFrame(0, 0, 640, 480, bytes(num_bytes))


@dataclass
class ThinLink:
    """A camera, a bottleneck that sends one byte after the other, and a station that confirms. Time is simulated."""

    bytes_per_s: Callable[[float], float]  # at a time in s
    delay_ms: float
    camera_hz: float = 30.0
    now_ns: int = 0
    frames: list[tuple[int, int, int]] = field(default_factory=list)  # (taken, arrived, bytes)
    most_waiting_bytes: float = 0.0
    is_on_this_machine: bool = False
    counts_bytes: bool = True  # False: a station of before `Received.num_bytes`
    paused_ms: Callable[[float], float] = lambda _: 0.0  # by so much the station's clock has stood still
    back_ms: Callable[[float], float] = lambda _: 0.0  # by so much a word of the station's is late, at a time in s

    def __post_init__(self) -> None:
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._free_ns = self._back_ns = 0
        self._sent = self._read = self._read_ns = 0
        self.slot = FrameSlot(self._make_smaller)
        self.meter = LinkMeter()
        self.stream = VideoStream(self.slot, self.meter, is_on_this_machine=self.is_on_this_machine)

    def run(self, seconds: float) -> None:
        end_ns = self.now_ns + round(seconds * S)
        for every_ns, what in (
            (round(S / self.camera_hz), self._take),
            (10 * MS, self._send_imu),
            (100 * MS, self._beat),
        ):
            for t_ns in range(self.now_ns, end_ns, every_ns):
                self._at(t_ns, what)
        while self._events and self._events[0][0] < end_ns:
            self.now_ns, _, what = heapq.heappop(self._events)
            what()
        self.now_ns = end_ns

    def rate_hz(self, seconds: float) -> float:
        return sum(arrived > self.now_ns - seconds * S for _, arrived, _ in self.frames) / seconds

    def ages_ms(self, seconds: float) -> list[float]:
        return [(b - a) / MS for a, b, _ in self.frames if b > self.now_ns - seconds * S]

    def gaps_ms(self, seconds: float) -> list[float]:
        taken = [a for a, b, _ in self.frames if b > self.now_ns - seconds * S]
        return [(b - a) / MS for a, b in itertools.pairwise(taken)]

    def _at(self, t_ns: int, what: Callable[[], None]) -> None:
        heapq.heappush(self._events, (t_ns, next(self._numbers), what))

    def _make_smaller(self, picture: Picture, quality: int) -> None:
        def made() -> None:
            picture.smaller[quality] = bytes(round(0.6 * OWN_BYTES * SIZE_AT[quality]))
            self._send_frames()

        self._at(self.now_ns + 5 * MS, made)

    def _take(self) -> None:
        self.slot.put(captured(), self.now_ns)
        self._send_frames()

    def _send_imu(self) -> None:
        self._send(170, None)
        self._send_frames()

    def _send_frames(self) -> None:
        if (frame := self.stream.next_frame(self.now_ns)) is not None:
            taken_ns = self.now_ns if self.slot.newest is None else self.slot.newest.taken_ns
            self._send(len(frame.jpeg) + 100, (frame.seq, taken_ns, len(frame.jpeg)))

    def _send(self, num_bytes: int, frame: tuple[int, int, int] | None) -> None:
        rate = self.bytes_per_s(self.now_ns / S)
        waiting_ns = max(0, self._free_ns - self.now_ns)
        self._free_ns = max(self._free_ns, self.now_ns) + round(num_bytes / rate * S)
        self.most_waiting_bytes = max(self.most_waiting_bytes, waiting_ns / S * rate)
        self._sent += num_bytes
        self.meter.send(num_bytes, frame is not None, self.now_ns)
        end = self._sent
        self._at(self._free_ns + round(self.delay_ms * MS), lambda: self._arrive(end, frame))

    def _arrive(self, end: int, frame: tuple[int, int, int] | None) -> None:
        self._read, self._read_ns = end, self.now_ns
        if frame is not None:
            self.frames.append((frame[1], self.now_ns, frame[2]))
            self._confirm(frame[0])

    def _beat(self) -> None:
        self._confirm(-1)

    def _confirm(self, seq: int) -> None:
        read, read_ns, held_ns = self._read, self._read_ns, self.now_ns - self._read_ns
        t_station_ns = read_ns + STATION_AHEAD_NS - round(self.paused_ms(read_ns / S) * MS)
        delay_ns = round((self.delay_ms + self.back_ms(self.now_ns / S)) * MS)

        def hear() -> None:
            count = self.stream.confirm(seq)
            if self.counts_bytes:
                self.meter.confirm(read, held_ns, self.now_ns, t_station_ns)
            else:
                for _ in range(count):
                    self.meter.confirm_frame(self.now_ns)
            self._send_frames()

        self._back_ns = max(self._back_ns, self.now_ns + delay_ns)  # in order
        self._at(self._back_ns, hear)


@pytest.mark.parametrize(
    ("mbit_s", "delay_ms", "least_hz"), [(40.0, 3.0, 28.0), (6.0, 15.0, 15.0), (2.0, 40.0, 8.0), (1.0, 60.0, 3.0)]
)
def test_pictures_arrive_fresh_at_any_rate(mbit_s: float, delay_ms: float, least_hz: float) -> None:
    link = ThinLink(lambda _: mbit_s * 125_000, delay_ms)
    link.run(20.0)
    assert link.rate_hz(15.0) >= least_hz
    assert float(np.percentile(link.ages_ms(15.0), 99)) <= 250.0


@pytest.mark.parametrize(("mbit_s", "delay_ms"), [(40.0, 3.0), (6.0, 15.0), (2.0, 40.0), (1.0, 60.0)])
def test_pictures_are_fresh_at_an_older_station_too(mbit_s: float, delay_ms: float) -> None:
    """It confirms pictures and no bytes: its delay cannot be told from its rate, and it gets fewer than it could."""
    link = ThinLink(lambda _: mbit_s * 125_000, delay_ms, counts_bytes=False)
    link.run(20.0)
    assert link.rate_hz(15.0) >= 2.0
    assert float(np.percentile(link.ages_ms(15.0), 99)) <= 250.0


@pytest.mark.parametrize("mbit_s", [2.0, 3.0, 6.0])
def test_pictures_come_less_often_rather_than_too_coarse_to_know_a_place_by(mbit_s: float) -> None:
    link = ThinLink(lambda _: mbit_s * 125_000, delay_ms=40.0)
    link.run(20.0)
    assert median(size for *_, size in link.frames[-50:]) >= 0.6 * OWN_BYTES * SIZE_AT[20]


@pytest.mark.parametrize(("mbit_s", "delay_ms"), [(40.0, 3.0), (6.0, 15.0), (2.0, 40.0)])
def test_pictures_come_evenly(mbit_s: float, delay_ms: float) -> None:
    link = ThinLink(lambda _: mbit_s * 125_000, delay_ms)
    link.run(20.0)
    gaps = link.gaps_ms(10.0)
    assert sum(abs(gap - median(gaps)) < 17.0 for gap in gaps) >= 0.95 * len(gaps)


def test_a_link_that_gets_thin_has_little_in_its_queue_and_is_used_again_when_it_recovers() -> None:
    link = ThinLink(lambda t_s: 250_000.0 if 10.0 <= t_s < 20.0 else 5_000_000.0, delay_ms=10.0)
    link.run(10.0)
    assert {size for *_, size in link.frames[-10:]} == {OWN_BYTES}
    link.most_waiting_bytes = 0.0
    link.run(10.0)
    assert max(link.ages_ms(8.0)) <= 250.0
    # What the link held before (20 ms of 5 MB/s), a picture that should have left, and one more.
    assert link.most_waiting_bytes <= 100_000 + 2 * OWN_BYTES
    assert max(size for *_, size in link.frames[-10:]) < OWN_BYTES / 3
    link.run(10.0)
    assert {size for *_, size in link.frames[-10:]} == {OWN_BYTES} and link.rate_hz(5.0) >= 28.0


def test_a_link_of_long_delay_has_several_pictures_on_its_way() -> None:
    link = ThinLink(lambda _: 5_000_000.0, delay_ms=60.0)
    link.run(20.0)
    assert link.rate_hz(10.0) >= 28.0


def test_what_is_lost_on_the_way_back_is_not_taken_for_a_thin_link() -> None:
    """Some of what the station says is lost, and holds up what comes behind it until it is said again."""
    rng = np.random.default_rng(0)
    link = ThinLink(lambda _: 250_000.0, delay_ms=40.0, back_ms=lambda _: 250.0 if rng.random() < 0.3 else 0.0)
    link.run(40.0)
    assert link.meter.estimate is not None
    assert link.meter.estimate.bytes_per_s == pytest.approx(250_000, rel=0.2)
    assert float(np.percentile(link.ages_ms(30.0), 99)) <= 250.0


@pytest.mark.parametrize("paused_s", [3.0, 0.2, -3.0])  # below 0: the robot's own clock stood still
@pytest.mark.parametrize(("mbit_s", "delay_ms"), [(6.0, 15.0), (1.0, 60.0)])
def test_a_clock_that_stood_still_changes_nothing_of_what_the_link_is_thought_to_carry(
    mbit_s: float, delay_ms: float, paused_s: float
) -> None:
    rate = mbit_s / 8 * 1e6
    link = ThinLink(lambda _: rate, delay_ms, paused_ms=lambda t_s: 1e3 * paused_s * (t_s > 10.0))
    link.run(9.9)
    for _ in range(100):
        link.run(0.1)
        assert link.meter.estimate is not None
        assert 0.5 * rate < link.meter.estimate.bytes_per_s < 2 * rate


def test_a_late_picture_is_never_sent() -> None:
    slot = FrameSlot(lambda picture, quality: None)
    stream = VideoStream(slot, LinkMeter(), is_on_this_machine=True)
    slot.put(captured(), 0)
    assert stream.next_frame(MAX_WAIT_NS + 1) is None and stream.is_at_end
    slot.put(captured(), MAX_WAIT_NS + 1)
    frame = stream.next_frame(MAX_WAIT_NS + 2)
    assert frame is not None and (frame.seq, frame.skipped) == (1, 1)


def test_a_picture_that_is_made_smaller_too_late_is_passed_over() -> None:
    slot = FrameSlot(lambda picture, quality: None)
    stream = VideoStream(slot, LinkMeter())  # the first one is made smaller: nothing is known of the link
    slot.put(captured(), 0)
    assert stream.next_frame(0) is None and not stream.is_at_end
    assert stream.next_frame(MAX_WAIT_NS + 1) is None and stream.is_at_end


@pytest.mark.parametrize(("is_on_this_machine", "most"), [(False, 1), (True, HERE_IN_FLIGHT)])
def test_a_station_that_confirms_nothing_gets_little(is_on_this_machine: bool, most: int) -> None:
    slot, meter = FrameSlot(lambda picture, quality: None), LinkMeter()
    stream = VideoStream(slot, meter, is_on_this_machine=is_on_this_machine)
    seqs = []
    for n in range(MAX_FRAMES_IN_FLIGHT + 2):
        slot.put(captured(1000), n * 33 * MS)
        if (frame := stream.next_frame(n * 33 * MS)) is not None:
            meter.send(len(frame.jpeg), True, n * 33 * MS)
            seqs.append(frame.seq)
    assert seqs == list(range(most))


def test_a_relay_on_this_machine_is_found_to_be_thin() -> None:
    link = ThinLink(lambda _: 250_000.0, delay_ms=40.0, is_on_this_machine=True)
    link.run(20.0)
    assert link.rate_hz(10.0) >= 8.0 and float(np.percentile(link.ages_ms(10.0), 99)) <= 250.0


@given(st.lists(st.integers(0, 5), max_size=20))
def test_frames_sent_and_skipped_are_all_there_are(counts: list[int]) -> None:
    slot = FrameSlot(lambda picture, quality: None)
    slot.put(captured(10), 0)
    stream = VideoStream(slot, LinkMeter())
    assert stream.next_frame(0) is None  # it came before this station
    sent = skipped = 0
    number = 0
    for count in counts:
        for _ in range(count):
            number += 1
            slot.put(captured(10), number)
        if (frame := stream.next_frame(number)) is not None:
            stream.confirm(frame.seq)
            assert frame.seq == number
            sent, skipped = sent + 1, skipped + frame.skipped
        assert stream.next_frame(number) is None
    assert sent + skipped == number and stream.skipped == skipped


def test_the_frame_says_of_which_quality_it_is() -> None:
    made: list[tuple[Picture, int]] = []
    slot = FrameSlot(lambda picture, quality: made.append((picture, quality)))
    stream = VideoStream(slot, LinkMeter())
    slot.put(captured(), 0)
    assert stream.next_frame(0) is None
    picture, quality = made[0]
    picture.smaller[quality] = b"smaller"
    frame = stream.next_frame(MS)
    assert frame is not None and (frame.jpeg, frame.quality) == (b"smaller", quality)
    slot.put(captured(100), 100 * MS)
    stream.confirm(0)
    frame = stream.next_frame(100 * MS)
    assert frame is not None and frame.quality == 0


def test_two_stations_share_what_was_made_smaller() -> None:
    made: list[int] = []
    slot = FrameSlot(lambda picture, quality: made.append(quality))
    streams = [VideoStream(slot, LinkMeter()) for _ in range(2)]
    slot.put(captured(), 0)
    for stream in streams:
        stream.next_frame(0)
    assert len(made) == 1


@given(
    mbit_s=st.floats(0.01, 1000),
    trip_ms=st.integers(0, 2000),
    other=st.floats(0, 1e6),
    own=st.integers(1, 1_000_000),
    period_ms=st.integers(1, 500),
)
def test_every_link_has_a_budget(mbit_s: float, trip_ms: int, other: float, own: int, period_ms: int) -> None:
    estimate = LinkEstimate(mbit_s * 125_000, trip_ms * MS, other)
    found = budget(estimate, own, SizeModel(), period_ms * MS, UNLIMITED)
    assert found.num_bytes > 0 and found.interval_ns >= 0


@pytest.mark.parametrize(("mbit_s", "camera_hz"), [(0.5, 30), (3.0, 60)])
def test_a_beat_that_swings_does_not_change_the_budget(mbit_s: float, camera_hz: int) -> None:
    """The same links, and a camera's period that is measured anew with each picture."""
    estimate, period_ns = LinkEstimate(mbit_s * 125_000, 20 * MS, 0.0), round(S / camera_hz)
    settled = budget(estimate, 20_000, SizeModel(), period_ns, UNLIMITED)
    assert settled.interval_ns > 0
    before = FrameBudget(settled.num_bytes, settled.interval_ns + 1000)
    assert budget(estimate, 20_000, SizeModel(), period_ns, before) == settled


def test_the_size_of_a_picture_at_a_quality_is_learned() -> None:
    sizes = SizeModel()
    for _ in range(30):
        sizes.learn(100_000, 50, 40_000)
    assert sizes.size(100_000, 50) == pytest.approx(40_000, rel=0.01)
    assert sizes.quality(100_000, 40_500) == 50
    assert sizes.quality(100_000, 10) == LEAST_QUALITY
    assert sizes.quality(100_000, 100_000) is None


def test_a_station_that_confirms_no_bytes_fills_no_memory() -> None:
    def size(messages: int, confirms_frames: bool) -> int:
        meter = LinkMeter()
        for n in range(messages):
            meter.send(200, is_frame=n % 10 == 0 and confirms_frames, now_ns=n * MS)
            if confirms_frames:
                meter.confirm_frame(n * MS)
        return len(pickle.dumps(meter))

    assert size(100_000, False) <= 1.1 * size(10_000, False)
    assert size(100_000, True) <= 1.1 * size(10_000, True)
