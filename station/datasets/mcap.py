"""Our MCAP recordings. A file without its end (crash, full disk) is read up to its last whole chunk.

Times are the robot's. A recording that goes on after robot-server restarted holds two clocks: it is read up to there.
"""

from __future__ import annotations

import base64
import logging
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import CRCValidationError, StreamReader

from shared.errors import DataError, RobotSystemError
from shared.messages import Hello
from station.datasets.dataset import Dataset, choose_frames, cut_to_frames
from station.foxglove import NANO, decode_image
from station.frames import DriveSample, ImageFrame, ImuBatch
from station.recorder import DRIVE_TOPIC, FRAME_TOPIC, HELLO_TOPIC, IMAGE_TOPIC, IMU_TOPIC

logger = logging.getLogger(__name__)

MAX_RECORD_BYTES = 256 * 1024 * 1024  # a damaged length must not fill the memory
DAMAGE = (McapError, CRCValidationError, RuntimeError, struct.error, ValueError, EOFError)  # lz4 raises RuntimeError


def open_mcap(path: Path, first: int | None, last: int | None, step: int) -> Dataset:
    """Open a recording made by `station.recorder`. Frames stay on disk; IMU and drive commands are read at once.

    Raises:
        DataError: no MCAP file, not one of ours, or nothing in it.
    """
    content = _Content(path)
    if content.unusable_samples:
        logger.warning("%s: %d IMU samples are no numbers and are left out", path, content.unusable_samples)
    hello = content.hello
    if hello is None:
        raise DataError(f"{path} holds no {HELLO_TOPIC}; only recordings made by this station can be read")
    frame_times = np.array([t for t, _ in content.frames], dtype=np.int64)
    if not len(frame_times) and not content.samples:
        raise DataError(f"{path} holds neither images nor IMU samples; record again, with a robot connected")
    chosen = choose_frames(range(len(frame_times)), first, last, step)
    if len(frame_times) and not chosen:
        raise DataError(f"{path} has {len(frame_times)} frames, none of them in the range asked for")
    imu, drive = content.imu(), tuple(content.drive)
    if chosen and (first is not None or last is not None):
        imu, drive = cut_to_frames(imu, drive, frame_times[chosen])
    exposures = [exposure_ns for _, exposure_ns in content.frames]

    def read_frames() -> Iterator[ImageFrame]:
        wanted = iter(enumerate(chosen))
        index, position = next(wanted, (-1, -1))
        for count, jpeg in enumerate(_images(path)):
            if count == position:
                yield ImageFrame(index, int(frame_times[count]), exposures[count], jpeg, f"{path.name} frame {count}")
                index, position = next(wanted, (-1, -1))
                if position < 0:
                    return

    return Dataset(
        path=path,
        kind="mcap",
        calibration=hello.calibration,
        intrinsics_known=True,
        frame_times_ns=frame_times[chosen],
        read_frames=read_frames if chosen else None,
        imu_samples=imu,
        drive_samples=drive,
    )


class _Content:
    """Everything but the images, in one pass."""

    def __init__(self, path: Path) -> None:
        self.hello: Hello | None = None
        self.frames: list[tuple[int, int]] = []  # (t_robot_ns, exposure_ns), as many as there are images
        self.samples: list[tuple[int, list[float]]] = []
        self.drive: list[DriveSample] = []
        self.unusable_samples = 0
        self._pending: tuple[int, int] | None = None  # a frame's record, whose image must follow
        for topic, data in _messages(path, {HELLO_TOPIC, FRAME_TOPIC, IMAGE_TOPIC, IMU_TOPIC, DRIVE_TOPIC}):
            try:
                if not self._take(topic, data, path):
                    return
            except (KeyError, TypeError, ValueError) as exc:
                raise DataError(f"{path}: a message on {topic} is not one of ours ({exc!r}); record again") from exc

    def _take(self, topic: str, data: bytes, path: Path) -> bool:
        """False when the rest of the file must not be used."""
        if topic == IMAGE_TOPIC:
            if self._pending is not None:
                self.frames.append(self._pending)
            self._pending = None
            return True
        content = _json(data, path)
        if topic == HELLO_TOPIC:
            return self._take_hello(content, path)
        if topic == FRAME_TOPIC:
            self._pending = (_time(content), int(content["exposure_ns"]))
        elif topic == IMU_TOPIC:
            self._take_sample(content)
        else:
            self._take_drive(DriveSample(_time(content), float(content["linear"]), float(content["angular"])))
        return True

    def imu(self) -> ImuBatch | None:
        if not self.samples:
            return None
        table = np.array([values for _, values in self.samples], dtype=np.float64)
        times = np.array([t for t, _ in self.samples], dtype=np.int64)
        return ImuBatch(times, np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3:]))

    def _take_hello(self, content: dict[str, Any], path: Path) -> bool:
        """False when the robot was started anew: what follows has another clock."""
        try:
            hello = msgspec.msgpack.decode(base64.b64decode(content["msgpack_base64"]), type=Hello)
        except (msgspec.DecodeError, RobotSystemError, ValueError, KeyError) as exc:
            raise DataError(f"{path}: {HELLO_TOPIC} cannot be read ({exc}); the file is damaged") from exc
        if self.hello is not None and self.hello.session_id != hello.session_id:
            logger.warning("%s: robot-server was restarted during the recording; what came after is left out", path)
            return False
        self.hello = self.hello or hello
        return True

    def _take_sample(self, content: dict[str, Any]) -> None:
        t_ns = _time(content)
        if self.samples and t_ns <= self.samples[-1][0]:
            return  # a sensor that repeats a stamp; estimators need increasing times
        readings = [content[kind][axis] for kind in ("gyro", "accel") for axis in "xyz"]
        if not all(isinstance(x, int | float) and math.isfinite(x) for x in readings):  # JSON's null: not a number
            self.unusable_samples += 1
            return
        self.samples.append((t_ns, readings))

    def _take_drive(self, sample: DriveSample) -> None:
        """Reports come 20 times a second; only changes say something."""
        if self.drive and sample.t_robot_ns <= self.drive[-1].t_robot_ns:
            return
        last = self.drive[-1] if self.drive else None
        if last is None or (last.linear_m_s, last.angular_rad_s) != (sample.linear_m_s, sample.angular_rad_s):
            self.drive.append(sample)


def _images(path: Path) -> Iterator[bytes]:
    for _, data in _messages(path, {IMAGE_TOPIC}):
        yield decode_image(data)


def _messages(path: Path, topics: set[str]) -> Iterator[tuple[str, bytes]]:
    """(topic, data) in the order written. Damage ends the iteration with a warning; what came before counts."""
    try:
        file = path.open("rb")
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); check its permissions") from exc
    with file:
        if file.read(6) != b"\x89MCAP0":
            raise DataError(f"{path} is not an MCAP file; give a recording made by this station")
        file.seek(0)
        wanted: dict[int, str] = {}
        try:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records:
                if isinstance(record, Channel) and record.topic in topics:
                    wanted[record.id] = record.topic
                elif isinstance(record, Message) and record.channel_id in wanted:
                    yield wanted[record.channel_id], record.data
        except DAMAGE as exc:
            logger.warning("%s ends early (%s): read up to its last whole chunk", path, type(exc).__name__)


def _json(data: bytes, path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = msgspec.json.decode(data, type=dict[str, Any])
    except msgspec.DecodeError as exc:
        raise DataError(f"{path} holds a message that is not JSON ({exc}); the file is damaged") from exc
    return content


def _time(content: dict[str, Any]) -> int:
    stamp = content["timestamp"]
    return int(stamp["sec"]) * NANO + int(stamp["nsec"])
