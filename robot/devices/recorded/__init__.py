"""A recorded drive played as if a robot made it now: files in, frames and samples out at their own pace."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from robot.devices.ports import CapturedDepth, CapturedFrame, DeviceSet, EndOfRecording, ImuReading
from robot.devices.recorded.images import read_size, to_jpeg
from robot.devices.recorded.recording import RecordedFrame, Recording, open_recording
from shared.errors import DataError, DeviceLost

logger = logging.getLogger(__name__)

MAX_CACHED_BYTES = 64 * 1024 * 1024  # a loop of some hundred frames is encoded once
MAX_READINGS = 225  # a second's worth
MAX_HISTORY = 10_000  # changes of the commanded velocity


class Playback:
    """The recording's clock: starts at its first datum when first asked, runs `speed` times as fast as time does."""

    def __init__(self, recording: Recording, speed: float, does_loop: bool, now_ns: Callable[[], int]) -> None:
        self.first_ns = recording.first_ns
        self.period_ns = recording.period_ns if does_loop else None
        self._speed = speed
        self._now_ns = now_ns
        self._began_ns: int | None = None

    def now_ns(self) -> int:
        if self._began_ns is None:
            self._began_ns = self._now_ns()
        return self.first_ns + round((self._now_ns() - self._began_ns) * self._speed)

    def seconds_until(self, t_robot_ns: int) -> float:
        """How long to wait for a recorded time; 0 when it has passed."""
        return max(0.0, (t_robot_ns - self.now_ns()) * 1e-9 / self._speed)

    def place(self, count: int, length: int) -> tuple[int, int]:
        """(index in the recording, shift of its time) of the count-th datum. Raises EndOfRecording."""
        if count < length:
            return count, 0
        if self.period_ns is None:
            raise EndOfRecording
        return count % length, count // length * self.period_ns


class RecordedCamera:
    """Plays images in time order; skips none."""

    def __init__(self, frames: tuple[RecordedFrame, ...], playback: Playback) -> None:
        self._frames = frames
        self._playback = playback
        self._count = 0
        self._cache: dict[int, tuple[bytes, int, int]] = {}
        self._cached_bytes = 0

    async def capture(self) -> CapturedFrame:
        """The next frame at its time. A file that cannot be read is passed over with a DeviceLost that names it."""
        index, shift_ns = self._playback.place(self._count, len(self._frames))
        self._count += 1
        try:
            if (loaded := self._cache.get(index)) is None:
                loaded = await asyncio.to_thread(self._load, index)
        except DataError as exc:
            raise DeviceLost(str(exc)) from exc
        jpeg, width, height = loaded
        frame = self._frames[index]
        t_robot_ns = frame.t_robot_ns + shift_ns
        await asyncio.sleep(self._playback.seconds_until(t_robot_ns))
        return CapturedFrame(t_robot_ns, frame.exposure_ns, width, height, jpeg)

    async def close(self) -> None:
        """Nothing is held open."""

    def _load(self, index: int) -> tuple[bytes, int, int]:
        path, encoded = self._frames[index].path, self._frames[index].encoded()
        width, height = read_size(encoded, path)
        loaded = (to_jpeg(encoded, path), width, height)
        if self._playback.period_ns is not None and self._cached_bytes + len(loaded[0]) <= MAX_CACHED_BYTES:
            self._cache[index] = loaded
            self._cached_bytes += len(loaded[0])
        return loaded


class RecordedDepth:
    """Plays depth pictures in time order; skips none."""

    def __init__(self, pictures: tuple[RecordedFrame, ...], playback: Playback) -> None:
        self._pictures = pictures
        self._playback = playback
        self._count = 0

    async def measure(self) -> CapturedDepth:
        """The next one at its time. A file that cannot be read is passed over with a DeviceLost that names it."""
        index, shift_ns = self._playback.place(self._count, len(self._pictures))
        self._count += 1
        picture = self._pictures[index]
        try:
            png = await asyncio.to_thread(picture.encoded)
        except DataError as exc:
            raise DeviceLost(str(exc)) from exc
        await asyncio.sleep(self._playback.seconds_until(picture.t_robot_ns + shift_ns))
        return CapturedDepth(picture.t_robot_ns + shift_ns, png)

    async def close(self) -> None:
        """Nothing is held open."""


class RecordedImu:
    """Plays inertial samples; every one, however late it is asked."""

    def __init__(self, samples: tuple[ImuReading, ...], playback: Playback) -> None:
        self._samples = samples
        self._playback = playback
        self._count = 0

    async def read(self) -> list[ImuReading]:
        """All samples whose time has come."""
        first = self._reading(self._count)
        await asyncio.sleep(self._playback.seconds_until(first.t_robot_ns))
        now_ns, readings = self._playback.now_ns(), [first]
        self._count += 1
        while len(readings) < MAX_READINGS:
            try:
                reading = self._reading(self._count)
            except EndOfRecording:
                break
            if reading.t_robot_ns > now_ns:
                break
            readings.append(reading)
            self._count += 1
        return readings

    async def close(self) -> None:
        """Nothing is held open."""

    def _reading(self, count: int) -> ImuReading:
        index, shift_ns = self._playback.place(count, len(self._samples))
        sample = self._samples[index]
        return ImuReading(count, sample.t_robot_ns + shift_ns, sample.gyro_imu, sample.accel_imu)


@dataclass
class RecordedMotors:
    """A recording cannot be driven: commands are only kept, so that everything above the motors can be tried."""

    now_ns: Callable[[], int] = time.monotonic_ns
    history: list[tuple[int, float, float]] = field(default_factory=list)  # (time, m/s, rad/s), changes only

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        if self.now_ns() < until_ns:
            self._note(linear_m_s, angular_rad_s)

    def stop(self) -> str:
        self._note(0.0, 0.0)
        return ""

    def close(self) -> None:
        self.stop()

    def _note(self, linear_m_s: float, angular_rad_s: float) -> None:
        if not self.history or self.history[-1][1:] != (linear_m_s, angular_rad_s):
            self.history.append((self.now_ns(), linear_m_s, angular_rad_s))
            del self.history[:-MAX_HISTORY]


def open_recorded(
    dataset: Path,
    *,
    speed: float = 1.0,
    at_end: Literal["stop", "loop"] = "stop",
    now_ns: Callable[[], int] = time.monotonic_ns,
) -> DeviceSet:
    """Play a dataset. Sensor times are the recording's own; in later rounds of a loop they go on increasing.

    Args:
        dataset: ASL folder, folder of images or video with camera.yaml, or MCAP recording.
        speed: 1 is as recorded. The station's clock estimate needs a speed near 1.
        at_end: raise EndOfRecording, or begin anew.
    Raises:
        DataError: the dataset cannot be used.
    """
    recording = open_recording(dataset)
    for remark in recording.remarks:
        logger.warning("%s", remark)
    playback = Playback(recording, speed, at_end == "loop", now_ns)
    return DeviceSet(
        calibration=recording.calibration,
        camera=RecordedCamera(recording.frames, playback) if recording.frames else None,
        imu=RecordedImu(recording.samples, playback) if recording.samples else None,
        motors=RecordedMotors(),
        depth=RecordedDepth(recording.depth, playback) if recording.depth else None,
        clock=playback.now_ns,
    )
