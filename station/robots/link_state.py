"""What is known of a link to a robot: counts, rates, round trip, clocks, whether it hears us. Time is an argument."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from shared.messages import CameraFrame, ErrorNotice, Hello, ImuBatch, Received, Status
from station.robots.network import NOT_CONNECTED, NetworkState

RATE_WINDOW_NS = 2_000_000_000
# Heartbeats are answered before anything else is sent. So late an answer, and the robot spoke on for so long with so
# many messages: it does not hear us. After a stall of the network the answers come behind all that waited, and reading
# that takes a slow computer its time: after a silence as long as a late answer's, lateness counts anew.
UNHEARD_AFTER_NS, UNHEARD_FOR_NS, UNHEARD_MESSAGES = 900_000_000, 250_000_000, 10

# Behind why a robot that is met without TLS says nothing: one that speaks TLS waits for our greeting, and we for its.
MAY_BE_UNPAIRED = "; if it has access control, pair with it (docs/access.md)"


@dataclass(frozen=True, slots=True)
class RobotIdentity:
    """Which robot it is."""

    robot_id: str  # as it says
    fingerprint: bytes  # of its certificate, which proves it; empty: no TLS


@dataclass(frozen=True, slots=True)
class LinkState:
    """Snapshot of a link for the API and the page. Counts run since the link was made."""

    host: str
    port: int
    connected: bool = False
    quiet: bool = False  # connected, but the robot has said nothing for a second
    hello: Hello | None = None  # of the present or the last connection
    robot: RobotIdentity | None = None  # who said it
    reason: str = "not connected yet"  # why not connected, in a sentence
    connections: int = 0  # how often a connection was made
    network: NetworkState = NOT_CONNECTED
    rtt_ms: float | None = None  # of the last heartbeat
    clock_offset_ns: int | None = None  # t_station - t_robot, now
    clock_bound_ns: int | None = None  # the offset may be wrong by that at most; None: nothing was answered yet
    clock_drift_ppm: float | None = None  # the robot's clock is this much faster than the station's
    frame_rate_hz: float = 0.0  # over the last seconds
    imu_rate_hz: float = 0.0
    received_bytes_per_s: float = 0.0
    frames: int = 0
    frames_skipped: int = 0
    imu_samples: int = 0
    imu_gaps: int = 0  # how many holes
    imu_lost: int = 0  # how many samples were in them
    status: Status | None = None  # the last one
    notice: ErrorNotice | None = None  # the last one


class Arrivals:
    """Counts of what arrived over a link, and the numbers of the newest."""

    def __init__(self) -> None:
        self.bytes = self.frames = self.frames_skipped = 0
        self.imu_samples = self.imu_gaps = self.imu_lost = 0
        self.next_imu_sequence = self._newest_frame = self._connection_frame = -1
        self._connection_bytes = self._read_ns = 0

    def begin_connection(self) -> None:
        """The robot counts the bytes of each connection from its beginning, and what it skipped."""
        self._connection_bytes = 0
        self._connection_frame = -1

    @property
    def is_empty(self) -> bool:
        """Whether this connection has carried nothing yet."""
        return self._connection_bytes == 0

    def add_bytes(self, count: int, now_ns: int) -> None:
        self.bytes += count
        self._connection_bytes += count
        self._read_ns = now_ns

    def begin_run(self) -> None:
        """The robot was started anew, or is another one: it numbers frames and samples from the beginning."""
        self.next_imu_sequence = self._newest_frame = -1

    def add_frame(self, frame: CameraFrame) -> bool:
        """False: a newer one was here before it."""
        if frame.seq <= self._newest_frame:
            return False
        self.frames += 1
        lost_too = frame.seq - self._connection_frame - 1 if self._connection_frame >= 0 else 0
        self.frames_skipped += max(frame.skipped, lost_too)
        self._newest_frame = self._connection_frame = frame.seq
        return True

    def add_imu(self, batch: ImuBatch) -> int:
        """Returns how many samples are missing before it."""
        missing = 0
        if self.next_imu_sequence >= 0:
            missing = max(0, batch.first_sequence - self.next_imu_sequence)
        self.imu_gaps += missing > 0
        self.imu_lost += missing
        self.next_imu_sequence = batch.next_sequence
        self.imu_samples += len(batch.samples)
        return missing

    def confirmation(self, now_ns: int) -> Received:
        """For the robot: up to where everything is here."""
        return Received(
            frame_seq=self._newest_frame,
            next_imu_sequence=self.next_imu_sequence,
            num_bytes=self._connection_bytes,
            held_ns=max(0, now_ns - self._read_ns),
            t_station_ns=self._read_ns,
        )


class RateMeter:
    """Frames, samples and bytes per second over the last two seconds, from totals sampled now and then."""

    def __init__(self) -> None:
        self._totals: deque[tuple[int, int, int, int]] = deque()  # (t_ns, frames, samples, bytes)

    def sample(self, now_ns: int, frames: int, samples: int, num_bytes: int) -> None:
        self._totals.append((now_ns, frames, samples, num_bytes))
        while now_ns - self._totals[0][0] > RATE_WINDOW_NS:
            self._totals.popleft()

    def rates(self) -> tuple[float, float, float]:
        """(frames/s, samples/s, bytes/s)."""
        if len(self._totals) < 2:
            return 0.0, 0.0, 0.0
        first, last = self._totals[0], self._totals[-1]
        seconds = (last[0] - first[0]) * 1e-9
        return (last[1] - first[1]) / seconds, (last[2] - first[2]) / seconds, (last[3] - first[3]) / seconds


class Hearing:
    """Whether a robot that speaks to us hears us too: compares what it says with how late it answers heartbeats."""

    def __init__(self) -> None:
        self._due_from_ns = 0  # an answer is late from here: the last one, or the end of a silence
        self._spoke_ns = 0  # when the robot last said something
        self._unanswered = 0  # messages that came when an answer was late already
        self._unanswered_since_ns = 0  # when the first of them came

    def note_answer(self, now_ns: int) -> None:
        """The robot heard us: it let us in, or answered a heartbeat."""
        self._due_from_ns, self._unanswered = now_ns, 0

    def note_message(self, now_ns: int) -> None:
        """The robot said something, whatever it was."""
        if now_ns - self._spoke_ns >= UNHEARD_AFTER_NS:
            self._due_from_ns, self._unanswered = now_ns, 0
        self._spoke_ns = now_ns
        if now_ns - self._due_from_ns >= UNHEARD_AFTER_NS:
            if self._unanswered == 0:
                self._unanswered_since_ns = now_ns
            self._unanswered += 1

    def is_lost(self, now_ns: int) -> bool:
        """It speaks and does not answer: what we say is lost, or its end waits for the rest of something."""
        speaks_on = now_ns - self._unanswered_since_ns >= UNHEARD_FOR_NS
        return speaks_on and self._unanswered >= UNHEARD_MESSAGES
