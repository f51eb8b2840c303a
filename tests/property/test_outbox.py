"""Every IMU sample is either received once, in order, or counted as lost."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robot.devices.ports import ImuReading
from robot.outbox import ImuBacklog, ImuCursor
from shared.messages import MAX_IMU_IN_FLIGHT, MAX_IMU_SAMPLES_PER_BATCH


def reading(sequence: int) -> ImuReading:
    return ImuReading(sequence, sequence * 1000, (0.0, 0.0, float(sequence)), (0.0, 0.0, 9.81))


def drain(cursor: ImuCursor) -> list[int]:
    received = []
    while (batch := cursor.next_batch()) is not None:
        assert 1 <= len(batch.samples) <= MAX_IMU_SAMPLES_PER_BATCH
        received += range(batch.first_sequence, batch.next_sequence)
        cursor.confirm(batch.next_sequence)
        assert [s.gyro_imu[2] for s in batch.samples] == list(range(batch.first_sequence, batch.next_sequence))
    return received


@given(
    capacity=st.integers(1, 50),
    steps=st.lists(st.tuples(st.integers(0, 60), st.sampled_from([0, 0, 0, 1, 7]), st.booleans()), max_size=12),
)
def test_received_and_lost_samples_are_all_there_are(capacity: int, steps: list[tuple[int, int, bool]]) -> None:
    backlog = ImuBacklog(capacity)
    cursor = ImuCursor(backlog, backlog.end)
    received: list[int] = []
    sent: list[int] = []
    sequence = holes = 0
    for count, hole, is_read in steps:
        if sent:
            sequence += hole
            holes += hole
        for _ in range(count):
            backlog.append(reading(sequence))
            sent.append(sequence)
            sequence += 1
        if is_read:
            received += drain(cursor)
    received += drain(cursor)
    assert received == sorted(set(received))
    assert set(received) <= set(sent)
    assert len(received) + cursor.lost == len(sent)
    seen_holes = 0 if not sent else (sent[-1] - sent[0] + 1) - len(sent)
    assert backlog.lost_in_sensor == seen_holes


@given(capacity=st.integers(5, 50), total=st.integers(1, 120), received=st.integers(0, 120), later=st.integers(0, 80))
def test_a_station_that_comes_back_misses_only_what_no_longer_fits(
    capacity: int, total: int, received: int, later: int
) -> None:
    received = min(received, total)
    backlog = ImuBacklog(capacity)
    for sequence in range(total + later):
        backlog.append(reading(sequence))
    cursor = ImuCursor.resuming(backlog, received)
    got = drain(cursor)
    oldest = max(0, total + later - capacity)
    assert got == list(range(max(received, oldest), total + later))
    assert cursor.lost == max(0, oldest - received)


def test_a_sensor_that_counts_anew_is_no_loss() -> None:
    backlog = ImuBacklog(100)
    cursor = ImuCursor(backlog, 0)
    for sequence in [5, 6, 7, 0, 1, 2]:
        backlog.append(ImuReading(sequence, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    batch = cursor.next_batch()
    assert batch is not None and (batch.first_sequence, len(batch.samples)) == (5, 6)
    assert (backlog.lost_in_sensor, backlog.restarts) == (0, 1)


def test_a_station_that_confirms_nothing_gets_few_samples() -> None:
    backlog = ImuBacklog(5000)
    imu = ImuCursor(backlog, 0)
    sent = 0
    for n in range(3000):
        backlog.append(reading(n))
    while (batch := imu.next_batch()) is not None:
        sent += len(batch.samples)
    assert MAX_IMU_IN_FLIGHT <= sent < MAX_IMU_IN_FLIGHT + MAX_IMU_SAMPLES_PER_BATCH
    imu.confirm(sent)
    batch = imu.next_batch()
    assert batch is not None and batch.first_sequence == sent
