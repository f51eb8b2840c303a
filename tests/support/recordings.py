"""A short made-up recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from mcap.reader import NonSeekingReader
from mcap.writer import Writer

import station.recordings.recorder
from shared.calibration import REFERENCE_ROBOT
from shared.geometry import FloatArray
from shared.messages import (
    CameraFrame,
    Capabilities,
    DriveApplied,
    ErrorNotice,
    Hello,
    ImuBatch,
    ImuSample,
    Status,
)
from station.model.frames import decode_picture
from station.recordings.recorder import Recorder, RecordingReport
from tests.support.made_up_workers import made_up_navigation

HELLO = Hello(
    protocol=2,
    robot_id="r",
    name="R",
    session_id="first",
    capabilities=Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False),
    calibration=REFERENCE_ROBOT,
)


START_NS = 1_403_715_283_262_142_976


BATCH = 20  # samples


JPEG = bytes(cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (48, 64), np.uint8))[1])


def frame(seq: int) -> CameraFrame:
    return CameraFrame(
        seq=seq,
        t_robot_ns=START_NS + seq * 50_000_000,
        exposure_ns=7,
        width=64,
        height=48,
        skipped=0,
        jpeg=JPEG + bytes([seq % 256]),
    )


def batch(first: int, count: int = 10) -> ImuBatch:
    return ImuBatch(
        first_sequence=first,
        samples=tuple(
            ImuSample(START_NS + n * 5_000_000 - 20_000_000, (0.1 * n, 1 / 3, -1e-9), (0.0, 1.0, 9.81))
            for n in range(first, first + count)
        ),
    )


def record(path: Path, frames: int = 20) -> RecordingReport:
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(HELLO)
    for n in range(frames):
        recorder.on_imu(batch(10 * n))
        recorder.on_drive_applied(
            DriveApplied(t_robot_ns=START_NS + n * 50_000_000, linear=0.1 * (n // 5), angular=0.0)
        )
        recorder.on_frame(frame(n), n)
    recorder.on_status(Status(t_robot_ns=START_NS, uptime_s=1.0, temperatures_c={"cpu": 50.0}))
    recorder.on_gap(3)
    recorder.on_notice(ErrorNotice(code="device", message="x"))
    recorder.on_disconnected("over")
    return recorder.close()


def record_samples(path: Path, gyro: FloatArray, accel: FloatArray, period_ns: int) -> RecordingReport:
    """A recording of nothing but inertial samples (n, 3), in batches as a robot sends them."""
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(HELLO)
    stamps = range(START_NS, START_NS + len(gyro) * period_ns, period_ns)
    samples = [
        ImuSample(t_ns, (w[0], w[1], w[2]), (a[0], a[1], a[2]))
        for t_ns, w, a in zip(stamps, gyro.tolist(), accel.tolist(), strict=True)
    ]
    for first in range(0, len(samples), BATCH):
        recorder.on_imu(ImuBatch(first_sequence=first, samples=tuple(samples[first : first + BATCH])))
    return recorder.close()


def recorded_in_small_chunks(path: Path) -> bytes:
    """A recording of some forty chunks, the first of which names all channels."""
    chunk, station.recordings.recorder.CHUNK_BYTES = station.recordings.recorder.CHUNK_BYTES, 4096
    try:
        record(path, frames=40)
    finally:
        station.recordings.recorder.CHUNK_BYTES = chunk
    return path.read_bytes()


def messages_in(path: Path) -> list[tuple[str, int, int, bytes]]:
    with path.open("rb") as file:
        found = NonSeekingReader(file).iter_messages(log_time_order=False)
        return [(channel.topic, m.log_time, m.publish_time, m.data) for _, channel, m in found]


def finish(writer: Writer) -> None:
    """Give a file its end."""
    end: Callable[[], None] = writer.finish  # mcap leaves it untyped
    end()


def record_made_up_room(path: Path, frames: int = 12, brightness: int = 0) -> Path:
    """A recording with pictures of the made-up room."""
    navigation = made_up_navigation()
    able = Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False)
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(
        Hello(
            protocol=2,
            robot_id="r",
            name="R",
            session_id="s",
            capabilities=able,
            calibration=navigation.calibration,
        )
    )
    for number in range(frames):
        t_ns = 10**9 + number * 250_000_000
        samples = tuple(ImuSample(t_ns + n * 10_000_000, (0.0, 0.0, 0.01 * n), (0.0, 0.0, 9.81)) for n in range(25))
        picture = decode_picture(navigation.keyframes.encoded[number], cv2.IMREAD_COLOR)
        encoded = cv2.imencode(".jpg", cv2.add(picture, np.full_like(picture, brightness)))[1].tobytes()
        height, width = picture.shape[:2]
        recorder.on_imu(ImuBatch(first_sequence=number * 25, samples=samples))
        recorder.on_drive_applied(DriveApplied(t_robot_ns=t_ns, linear=0.1 * (number % 3), angular=0.0))
        recorder.on_frame(
            CameraFrame(
                seq=number, t_robot_ns=t_ns, exposure_ns=0, width=width, height=height, skipped=0, jpeg=encoded
            ),
            number,
        )
    return recorder.close().path
