"""Writes everything that arrives from a robot into an MCAP file, in a thread of its own (docs/recordings.md).

A recording that could not be closed (crash, power cut, full disk) stays readable up to its last chunk.
"""

from __future__ import annotations

import base64
import logging
import os
import queue
import stat
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
from mcap.writer import CompressionType, Writer

from shared.disk import flush, make_folder
from shared.errors import DataError
from shared.mcap_recording import DEPTH_TOPIC, DRIVE_TOPIC, FRAME_TOPIC, HELLO_TOPIC, IMAGE_TOPIC, IMU_TOPIC
from shared.messages import CameraFrame, Depth, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.events import LogLine
from station.files.foxglove import camera_calibration, encode_image, time_of
from station.model.place_answer import PlaceReport
from station.model.slam_update import SlamUpdate
from station.recordings.chunk_indices import ChunkIndices
from station.recordings.topics import (
    ANSWER_TOPIC,
    CALIBRATION_TOPIC,
    COMMAND_TOPIC,
    GAP_TOPIC,
    LIBRARY,
    LINK_TOPIC,
    LOG_TOPIC,
    NOTICE_TOPIC,
    POSE_TOPIC,
    STATE_TOPIC,
    STATUS_TOPIC,
    log_line,
    place_answer,
    register_channels,
    slam_pose,
    slam_state,
)
from station.recordings.writer_lock import hold

logger = logging.getLogger(__name__)

REST_S = 0.05  # the thread takes all that came meanwhile: woken by each message it would take turns with the event loop
CHUNK_BYTES = 512 * 1024  # about a third of a second of video
MAX_WAITING_FRAMES = 120  # and depth; some seconds between event loop and disk; then they are dropped, and counted
MAX_LATE = 20_000  # IMU batches and reports are never dropped; a disk that is minutes behind ends the recording
CLOSE_WITHIN_S = 60.0  # a disk that hangs must not keep the station from ending
MIN_FREE_BYTES = 256 * 1024 * 1024  # the disk also holds the maps: stop in time, with a proper end of the file
CHECK_DISK_NS = 1_000_000_000  # so often what was taken is written to the disk: the most that a crash may cost

_BATCHES = msgspec.msgpack.Decoder(ImuBatch)


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """What became of a recording."""

    path: Path
    messages: int
    bytes: int
    frames_dropped: int  # the disk was too slow for them
    error: str  # empty, or the sentence why it ended before it was closed


@dataclass(frozen=True, slots=True)
class _Entry:
    topic: str
    t_sensor_ns: int
    t_station_ns: int
    content: bytes  # encoded: while the disk holds up thousands wait, and objects are three times as large


@dataclass(frozen=True, slots=True)
class _ImuArrival:
    """Samples that came together: one entry each, made in the recorder's thread."""

    packed: bytes  # the batch
    t_station_ns: int

    def entries(self) -> Iterator[_Entry]:
        batch = _BATCHES.decode(self.packed)
        for number, sample in enumerate(batch.samples):
            content = {
                "timestamp": time_of(sample.t_robot_ns),
                "sequence": batch.first_sequence + number,
                "gyro": dict(zip("xyz", sample.gyro_imu, strict=True)),
                "accel": dict(zip("xyz", sample.accel_imu, strict=True)),
            }
            yield _Entry(IMU_TOPIC, max(0, sample.t_robot_ns), self.t_station_ns, msgspec.json.encode(content))


class Recorder:
    """A link's listener that records. Give it the present hello first, when the robot is connected already.

    Raises:
        DataError: the file cannot be made; one sentence.
    """

    def __init__(
        self,
        path: Path,
        *,
        min_free_bytes: int = MIN_FREE_BYTES,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.path = path
        self._now_ns = now_ns
        self._wall_minus_monotonic_ns = time.time_ns() - now_ns()
        self._min_free_bytes = min_free_bytes
        self._file = _create(path, min_free_bytes)
        self._waiting: queue.SimpleQueue[_Entry | _ImuArrival | None] = queue.SimpleQueue()
        self._messages = 0
        self._frames_taken = 0
        self._frames_written = 0
        self._frames_dropped = 0
        # Log times of the newest that was taken, that was given to the file, that the disk has:
        self._newest_ns = self._written_ns = self._safe_ns = self._wall_minus_monotonic_ns + now_ns()
        self.error = ""  # why the recording ended by itself, in a sentence; empty while it works
        self._closed = False
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    @property
    def report(self) -> RecordingReport:
        """How it stands now; `error` is set as soon as the recording ended by itself."""
        size = self.path.stat().st_size if self.path.is_file() else 0
        return RecordingReport(self.path, self._messages, size, self._frames_dropped, self.error)

    def close(self, within_s: float = CLOSE_WITHIN_S) -> RecordingReport:
        """Write what waits, finish the file. Safe to call twice. Without `error` the whole file is on the disk then.

        A disk that does not take it in that time is left to itself; the report says so.
        """
        if not self._closed:
            self._closed = True
            self._waiting.put(None)
        self._thread.join(within_s)
        if self._thread.is_alive():
            self._fail(f"the disk did not take what waited within {within_s:g} s")
        return self.report

    # LinkListener

    def on_connected(self, hello: Hello) -> None:
        self.on_calibration(hello)
        self._put(LINK_TOPIC, None, {"connected": True, "reason": ""})

    def on_calibration(self, hello: Hello) -> None:
        content = {
            "robot_id": hello.robot_id,
            "name": hello.name,
            "session_id": hello.session_id,
            "msgpack_base64": base64.b64encode(msgspec.msgpack.encode(hello)).decode(),  # JSON has no infinity
        }
        self._put(HELLO_TOPIC, None, content)
        camera = hello.calibration.camera
        if camera is not None:
            self._put(CALIBRATION_TOPIC, None, camera_calibration(camera, self._now_ns()))

    def on_disconnected(self, reason: str) -> None:
        self._put(LINK_TOPIC, None, {"connected": False, "reason": reason})

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        if not self._takes_a_frame():
            return
        content = {
            "timestamp": time_of(frame.t_robot_ns),
            "seq": frame.seq,
            "exposure_ns": frame.exposure_ns,
            "width": frame.width,
            "height": frame.height,
            "skipped": frame.skipped,
            "quality": frame.quality,
        }
        self._put(FRAME_TOPIC, frame.t_robot_ns, content, t_station_ns)
        self._put(IMAGE_TOPIC, frame.t_robot_ns, encode_image(frame.t_robot_ns, frame.jpeg), t_station_ns)

    def on_imu(self, batch: ImuBatch) -> None:
        packed = msgspec.msgpack.encode(batch)
        self._queue(_ImuArrival(packed, self._now_ns() + self._wall_minus_monotonic_ns))

    def on_gap(self, num_samples: int) -> None:
        self._put(GAP_TOPIC, None, {"num_samples": num_samples})

    def on_depth(self, depth: Depth) -> None:
        if not self._takes_a_frame():
            return
        image = encode_image(depth.t_robot_ns, depth.png, frame_id="depth", kind="png")
        self._put(DEPTH_TOPIC, depth.t_robot_ns, image)

    def _takes_a_frame(self) -> bool:
        if self._frames_taken - self._frames_written >= MAX_WAITING_FRAMES:
            self._frames_dropped += 1
            return False
        self._frames_taken += 1
        return True

    def on_drive_applied(self, applied: DriveApplied) -> None:
        content = {
            "timestamp": time_of(applied.t_robot_ns),
            "linear": applied.linear,
            "angular": applied.angular,
            "pan": applied.pan,
            "tilt": applied.tilt,
        }
        self._put(DRIVE_TOPIC, applied.t_robot_ns, content)

    def on_status(self, status: Status) -> None:
        content = {"timestamp": time_of(status.t_robot_ns), **msgspec.structs.asdict(status)}
        self._put(STATUS_TOPIC, status.t_robot_ns, content)

    def on_notice(self, notice: ErrorNotice) -> None:
        self._put(NOTICE_TOPIC, None, {"code": notice.code, "message": notice.message})

    # What the station decides

    def on_command(self, driver: str, linear: float, angular: float, ttl_ms: int) -> None:
        content = {"driver": driver, "linear": linear, "angular": angular, "ttl_ms": ttl_ms}
        self._put(COMMAND_TOPIC, None, content)

    def on_slam(self, update: SlamUpdate) -> None:
        self._put(STATE_TOPIC, update.t_robot_ns, slam_state(update))
        if (pose := slam_pose(update)) is not None:
            self._put(POSE_TOPIC, update.t_robot_ns, pose)

    def on_answer(self, report: PlaceReport) -> None:
        self._put(ANSWER_TOPIC, report.answer.t_robot_ns, place_answer(report))

    def on_log(self, line: LogLine) -> None:
        self._put(LOG_TOPIC, None, log_line(line))

    # The recorder's thread

    def _put(
        self, topic: str, t_sensor_ns: int | None, content: bytes | dict[str, Any], t_station_ns: int | None = None
    ) -> None:
        t_station_ns = self._now_ns() if t_station_ns is None else t_station_ns
        # Foxglove's time line is the log time, which is wall time; the sensor's own time is the publish time.
        wall_ns = t_station_ns + self._wall_minus_monotonic_ns
        try:
            encoded = content if isinstance(content, bytes) else msgspec.json.encode(content)
        except (ValueError, TypeError, msgspec.MsgspecError) as exc:
            self._fail(f"an error of the recorder ({exc})")
            return
        self._queue(_Entry(topic, max(0, wall_ns if t_sensor_ns is None else t_sensor_ns), wall_ns, encoded))

    def _queue(self, arrival: _Entry | _ImuArrival) -> None:
        if self._closed or self.error:
            return
        if self._waiting.qsize() >= MAX_LATE:
            self._fail(f"the disk is {MAX_LATE} messages behind; record to a faster one")
            return
        self._newest_ns = max(self._newest_ns, arrival.t_station_ns)
        self._waiting.put(arrival)

    def _fail(self, why: str) -> None:
        if not self.error:
            self.error = f"recording {self.path} ended: {why}"
            logger.error("%s", self.error)
            self._waiting.put(None)  # what was accepted until now is still written

    def _fail_to_write(self, why: str) -> None:
        """The disk did not take everything: say how much, also of a recording that was being ended already."""
        lost_s = -(-(self._newest_ns - self._safe_ns) // 100_000_000) / 10  # rounded up
        why = f"{why}; its last {lost_s:.1f} s may be missing, what came before can be read"
        if not self.error:
            self._fail(why)
        else:
            self.error += f"; its end could not be written: {why}"
            logger.error("%s", self.error)

    def _write_all(self) -> None:
        try:
            with self._file, ChunkIndices() as indices:
                self._write_entries(indices)
        except OSError as exc:
            self._fail_to_write(exc.strerror or str(exc))
        except Exception as exc:
            logger.exception("recorder")
            self._fail_to_write(f"an error of the recorder ({exc})")

    def _write_entries(self, indices: ChunkIndices) -> None:
        if self._is_on_disk:
            flush(self.path.parent)  # its name too survives a power cut
        writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        vars(writer)["_Writer__chunk_indices"] = indices  # a list of its own would grow as long as the recording
        writer.start(profile="", library=LIBRARY)
        channels = register_channels(writer)
        checked_ns = self._now_ns()
        while True:
            try:
                arrival = self._waiting.get(timeout=max(0.05, CHECK_DISK_NS / 1e9))
            except queue.Empty:  # a silent robot: what came last must not wait in memory
                self._write_out(writer)
                continue
            if arrival is None:
                break
            for entry in (arrival,) if isinstance(arrival, _Entry) else arrival.entries():
                self._messages += 1
                self._written_ns = max(self._written_ns, entry.t_station_ns)
                self._frames_written += entry.topic in (IMAGE_TOPIC, DEPTH_TOPIC)
                writer.add_message(
                    channel_id=channels[entry.topic],
                    log_time=entry.t_station_ns,
                    data=entry.content,
                    publish_time=entry.t_sensor_ns,
                    sequence=self._messages & 0xFFFFFFFF,
                )
            if self._now_ns() - checked_ns >= CHECK_DISK_NS:
                checked_ns = self._now_ns()
                self._write_out(writer)
                self._check_disk()
            if self._waiting.empty() and not self._closed:
                time.sleep(REST_S)
        finish: Callable[[], None] = writer.finish  # mcap leaves it untyped
        finish()
        self._file.flush()
        self._wait_for_disk()  # whoever hears that it is closed may pull the plug

    def _write_out(self, writer: Writer) -> None:
        """End the chunk and wait until the disk has it."""
        write_chunk: Callable[[], None] = writer.flush  # it flushes the file too
        write_chunk()
        self._wait_for_disk()

    def _wait_for_disk(self) -> None:
        if self._is_on_disk:
            os.fsync(self._file.fileno())
        self._safe_ns = self._written_ns

    @property
    def _is_on_disk(self) -> bool:
        """A device (/dev/full) cannot be waited for."""
        return stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)

    def _check_disk(self) -> None:
        free = _free_bytes(self.path)
        if free < self._min_free_bytes:
            self._fail(
                f"{free // 2**20} MiB are left on the disk, {self._min_free_bytes // 2**20} MiB are kept free;"
                " delete old recordings"
            )


def _create(path: Path, min_free_bytes: int) -> BinaryIO:
    try:
        make_folder(path.parent)
        free = _free_bytes(path)
        if free < min_free_bytes:
            raise DataError(
                f"cannot record to {path}: {free // 2**20} MiB are left on the disk, {min_free_bytes // 2**20} MiB are"
                " kept free; delete old recordings"
            )
        file = os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT, 0o666), "wb")
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            if not hold(file):  # until it is finished: nobody recovers it meanwhile
                file.close()
                raise DataError(f"cannot record to {path}: it is being recorded already; choose another name")
            file.truncate(0)
        return file
    except OSError as exc:
        raise DataError(f"cannot record to {path} ({exc.strerror}); choose a folder that can be written") from exc


def _free_bytes(path: Path) -> int:
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize
