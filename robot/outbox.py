"""IMU samples that wait for stations: one bounded backlog for all, a cursor for each."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from robot.devices.ports import ImuReading
from shared.messages import (
    MAX_IMU_IN_FLIGHT,
    MAX_IMU_SAMPLES_PER_BATCH,
    ImuBatch,
    ImuSample,
)


class ImuBacklog:
    """Ring of the newest samples. Positions count every sample kept here; sequence numbers are the sensor's own."""

    def __init__(self, capacity: int) -> None:
        self._ring: list[tuple[int, ImuSample] | None] = [None] * capacity
        self.end = 0  # position after the newest sample
        self.lost_in_sensor = 0  # holes in the sensor's count
        self.restarts = 0  # how often the sensor counted backwards
        self._shift = 0  # added to the sensor's count, so that ours never goes back
        self._last_sequence: int | None = None

    @property
    def begin(self) -> int:
        """Position of the oldest sample still kept."""
        return max(0, self.end - len(self._ring))

    def append(self, reading: ImuReading) -> None:
        """Keep a sample; the oldest one makes room."""
        sequence = reading.sequence + self._shift
        if self._last_sequence is not None:
            if sequence <= self._last_sequence:
                self.restarts += 1
                self._shift += self._last_sequence + 1 - sequence
                sequence = self._last_sequence + 1
            self.lost_in_sensor += sequence - self._last_sequence - 1
        self._last_sequence = sequence
        sample = ImuSample(reading.t_robot_ns, reading.gyro_imu, reading.accel_imu)
        self._ring[self.end % len(self._ring)] = (sequence, sample)
        self.end += 1

    def position_of(self, sequence: int) -> int:
        """Position of the first kept sample numbered `sequence` or higher."""
        return self.begin + bisect_left(range(self.begin, self.end), sequence, key=self.sequence_at)

    def sequence_at(self, position: int) -> int:
        """Number of the sample at a kept position."""
        return self._at(position)[0]

    def batch(self, position: int) -> tuple[ImuBatch, int] | None:
        """Consecutively numbered samples from a kept position on, and the position after them; None at the end."""
        if position >= self.end:
            return None
        first_sequence, sample = self._at(position)
        samples = [sample]
        position += 1
        while position < self.end and len(samples) < MAX_IMU_SAMPLES_PER_BATCH:
            sequence, sample = self._at(position)
            if sequence != first_sequence + len(samples):
                break
            samples.append(sample)
            position += 1
        return ImuBatch(first_sequence=first_sequence, samples=tuple(samples)), position

    def _at(self, position: int) -> tuple[int, ImuSample]:
        entry = self._ring[position % len(self._ring)]
        if entry is None or not self.begin <= position < self.end:
            raise IndexError(f"position {position} is not kept ({self.begin}..{self.end})")
        return entry


class ImuCursor:
    """How far one station has read the backlog. Falling out of it is a counted gap."""

    def __init__(self, backlog: ImuBacklog, position: int) -> None:
        self._backlog = backlog
        self._position = position
        self._in_flight: deque[tuple[int, int]] = deque()  # (next sequence, samples) of batches not confirmed yet
        self._num_in_flight = 0
        self.lost = 0

    @classmethod
    def resuming(cls, backlog: ImuBacklog, next_sequence: int) -> ImuCursor:
        """Continue at a sequence number; what the backlog no longer holds counts as lost."""
        cursor = cls(backlog, backlog.position_of(next_sequence))
        if cursor._position == backlog.begin < backlog.end:
            cursor.lost = max(0, backlog.sequence_at(backlog.begin) - next_sequence) if backlog.begin else 0
        return cursor

    @property
    def is_at_end(self) -> bool:
        """Whether the station has been sent all there is."""
        return self._position >= self._backlog.end

    def next_batch(self) -> ImuBatch | None:
        """The next samples for this station; None when it has all, or has not confirmed enough of them."""
        if self._num_in_flight >= MAX_IMU_IN_FLIGHT:
            return None
        if self._position < self._backlog.begin:
            self.lost += self._backlog.begin - self._position
            self._position = self._backlog.begin
        found = self._backlog.batch(self._position)
        if found is None:
            return None
        batch, self._position = found
        self._in_flight.append((batch.next_sequence, len(batch.samples)))
        self._num_in_flight += len(batch.samples)
        return batch

    def confirm(self, next_sequence: int) -> None:
        """The station has everything before this number."""
        while self._in_flight and self._in_flight[0][0] <= next_sequence:
            self._num_in_flight -= self._in_flight.popleft()[1]
