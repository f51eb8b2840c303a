"""Reads our MCAP recordings, for robot and station alike. A file without its end (crash, full disk) is read up to its
last whole chunk.

Times are the robot's. A recording that goes on after robot-server restarted holds two clocks: it is read up to there.
"""

from __future__ import annotations

import base64
import contextlib
import logging
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import CRCValidationError
from zstandard import ZstdError

from shared.bounded import Refused, open_file, shown
from shared.errors import DataError
from shared.mcap_records import bounded_records
from shared.message_codec import UNDECODABLE
from shared.messages import Hello
from shared.pictures import why_not_as_announced
from shared.recorded_files import MAX_EXPOSURE_NS, MAX_TIME_NS
from shared.text import explain

logger = logging.getLogger(__name__)

HELLO_TOPIC = "/robot/hello"
IMAGE_TOPIC = "/camera/image"
FRAME_TOPIC = "/camera/frame"
IMU_TOPIC = "/imu"
DRIVE_TOPIC = "/drive/applied"
DEPTH_TOPIC = "/depth/image"

NANO = 1_000_000_000
# What damaged bytes raise; lz4 a RuntimeError.
DAMAGE = (McapError, CRCValidationError, RuntimeError, ZstdError, struct.error, ValueError, EOFError, Refused)
_VARINT, _LENGTH = 0, 2  # wire types of protobuf


class McapContent:
    """Everything but the images, in one pass.

    Raises:
        DataError: no MCAP file, or one that holds something else under our names.
    """

    def __init__(self, path: Path) -> None:
        self.hello: Hello | None = None
        self.frames: list[tuple[int, int]] = []  # (t_robot_ns, exposure_ns), as many as there are images
        self.samples: list[tuple[int, list[float]]] = []
        self.drive: list[tuple[int, float, float, float, float]] = []  # t_robot_ns, m/s, rad/s, pan, tilt; changes only
        self.depth_times: list[int] = []  # t_robot_ns, increasing
        self.unusable_samples = 0
        self._pending: tuple[int, int] | None = None  # a frame's record, whose image must follow
        topics = {HELLO_TOPIC, FRAME_TOPIC, IMAGE_TOPIC, IMU_TOPIC, DRIVE_TOPIC, DEPTH_TOPIC}
        for topic, data, t_ns in _messages(path, topics):
            with _taken_for_ours(path, topic):
                if topic == DEPTH_TOPIC:
                    self.depth_times.append(_bounded(t_ns, MAX_TIME_NS))
                elif not self._add(topic, data, path):
                    return

    def _add(self, topic: str, data: bytes, path: Path) -> bool:
        """False when the rest of the file must not be used."""
        if topic == IMAGE_TOPIC:
            if self._pending is not None:
                self.frames.append(self._pending)
            self._pending = None
            return True
        content = _json(data, path)
        if topic == HELLO_TOPIC:
            return self._add_hello(content, path)
        if topic == FRAME_TOPIC:
            self._pending = (_time(content), _bounded(content["exposure_ns"], MAX_EXPOSURE_NS))
        elif topic == IMU_TOPIC:
            self._add_sample(content)
        else:
            head = (float(content.get("pan", 0.0)), float(content.get("tilt", 0.0)))  # a fixed camera has none
            self._add_drive(_time(content), (float(content["linear"]), float(content["angular"]), *head))
        return True

    def _add_hello(self, content: dict[str, Any], path: Path) -> bool:
        """False when the robot was started anew: what follows has another clock."""
        try:
            hello = msgspec.msgpack.decode(base64.b64decode(content["msgpack_base64"]), type=Hello)
        except (*UNDECODABLE, KeyError) as exc:
            raise DataError(f"{path}: {HELLO_TOPIC} cannot be read ({explain(exc)}); the file is damaged") from exc
        if self.hello is not None and self.hello.session_id != hello.session_id:
            logger.warning("%s: robot-server was restarted during the recording; what came after is left out", path)
            return False
        self.hello = self.hello or hello
        return True

    def _add_sample(self, content: dict[str, Any]) -> None:
        t_ns = _time(content)
        if self.samples and t_ns <= self.samples[-1][0]:
            return  # a sensor that repeats a stamp; estimators need increasing times
        readings = [content[kind][axis] for kind in ("gyro", "accel") for axis in "xyz"]
        if not all(isinstance(x, int | float) and math.isfinite(x) for x in readings):  # JSON's null: not a number
            self.unusable_samples += 1
            return
        self.samples.append((t_ns, readings))

    def _add_drive(self, t_ns: int, command: tuple[float, float, float, float]) -> None:
        """Reports come 20 times a second; only changes say something."""
        if not all(map(math.isfinite, command)):
            raise ValueError(f"{command} is no command")
        if self.drive and t_ns <= self.drive[-1][0]:
            return
        if not self.drive or self.drive[-1][1:] != command:
            self.drive.append((t_ns, *command))


def mcap_images(path: Path) -> Iterator[bytes]:
    """The JPEG images of a recording, in order."""
    for _, data, _ in _messages(path, {IMAGE_TOPIC}):
        yield decode_image(data)


def mcap_depth(path: Path) -> Iterator[bytes]:
    """The depth pictures of a recording, PNG files, in order."""
    for _, data, _ in _messages(path, {DEPTH_TOPIC}):
        yield decode_image(data)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPicture:
    """One picture of a recording, as it came from the camera."""

    number: int
    t_robot_ns: int
    since_first_s: float
    jpeg: bytes
    why_unusable: str = ""  # it is not of the size that was announced with it; goes on a sentence


def recorded_pictures(path: Path) -> Iterator[RecordedPicture]:
    """Pictures in the order recorded, read as they are asked for. Raises DataError, also later."""
    pending: tuple[int, int, int] | None = None  # time, width, height
    first_ns: int | None = None
    number = 0
    for topic, data, _ in _messages(path, {FRAME_TOPIC, IMAGE_TOPIC}):
        if topic == FRAME_TOPIC:
            with _taken_for_ours(path, topic):
                content = _json(data, path)
                pending = _time(content), content["width"], content["height"]
        elif pending is not None:
            t_ns, width, height = pending
            first_ns = t_ns if first_ns is None else first_ns
            jpeg = decode_image(data)
            why = why_not_as_announced(jpeg, width, height)
            yield RecordedPicture(number, t_ns, (t_ns - first_ns) * 1e-9, jpeg, why)
            number, pending = number + 1, None


def _messages(path: Path, topics: set[str]) -> Iterator[tuple[str, bytes, int]]:
    """(topic, data, sensor time) in the order written. Damage ends it with a warning; what came before counts."""
    try:
        file = open_file(path)
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a recording that you may read") from exc
    with file:
        if file.read(6) != b"\x89MCAP0":
            raise DataError(f"{path} is not an MCAP file; give a recording made by this station")
        known: dict[int, str] = {}
        number = 0  # the recorder counts its messages from 1; 0: behind a hole that was recovered, or another's
        frame: int | None = None  # the time of the frame whose record came last
        try:
            for record in bounded_records(file):
                if isinstance(record, Channel):
                    known[record.id] = record.topic
                elif isinstance(record, Message):
                    if number and record.sequence and record.sequence != (number + 1) & 0xFFFFFFFF:
                        # A chunk whose kind is damaged is passed over without a word, as one of a kind yet to come.
                        raise ValueError(f"messages {number + 1} to {record.sequence - 1} are missing")
                    number = record.sequence
                    topic = known.get(record.channel_id, "")
                    if topic == FRAME_TOPIC:
                        frame = record.publish_time
                    elif topic == IMAGE_TOPIC and frame != record.publish_time:
                        continue  # its frame's record was lost in a hole: nobody knows when it was seen
                    if topic in topics:
                        yield topic, record.data, record.publish_time
        except DAMAGE as exc:
            why = exc if isinstance(exc, Refused) else type(exc).__name__
            logger.warning("%s ends early (%s): read up to its last whole chunk", path, why)


@contextlib.contextmanager
def _taken_for_ours(path: Path, topic: str) -> Iterator[None]:
    """Raises DataError: the message holds something else."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError) as exc:
        reason = f"without {exc}" if isinstance(exc, KeyError) else exc
        raise DataError(f"{path}: a message on {topic} is not one of ours ({reason}); record again") from exc


def _json(data: bytes, path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.DecodeError, RecursionError) as exc:
        raise DataError(f"{path} holds a message that is not JSON ({exc}); the file is damaged") from exc
    return content


def _time(content: dict[str, Any]) -> int:
    stamp = content["timestamp"]
    if not isinstance(stamp, dict):
        raise ValueError(f"{shown(stamp)} is no time")
    seconds, nanoseconds = _bounded(stamp["sec"], MAX_TIME_NS // NANO), _bounded(stamp["nsec"], MAX_TIME_NS)
    return _bounded(seconds * NANO + nanoseconds, MAX_TIME_NS)


def _bounded(value: Any, limit: int) -> int:
    if not isinstance(value, int) or abs(value) > limit:
        raise ValueError(f"{shown(value)} is no time")
    return value


def decode_image(message: bytes) -> bytes:
    """The picture of an encoded foxglove.CompressedImage. Raises DataError when there is none."""
    position = 0
    while position < len(message):
        key, position = _read_varint(message, position)
        value, position = _read_varint(message, position)
        if key & 7 == _LENGTH:
            if key >> 3 == 2:
                return message[position : position + value]
            position += value
        elif key & 7 != _VARINT:
            break
    else:
        if position == len(message):
            return b""  # protobuf leaves out what is empty
    raise DataError("an image message of the recording holds no image; the file is damaged")


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while position < len(data) and shift < 64:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            break
        shift += 7
    return value, position
