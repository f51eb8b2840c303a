"""Puts what the link delivers into sensor-time order, as SLAM needs it: inertial and drive samples, then the frame."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from itertools import count

from station.model.frames import DriveSample, ImageFrame, ImuBatch

HOLD_BACK_NS = 60_000_000  # drive reports come every 50 ms, IMU batches every 20 ms; what is later is lost anyway
MAX_HELD_FRAMES = 60  # frames that wait for an IMU that has gone silent: two seconds, then they go without it


class Sequencer:
    """Holds a frame until everything measured before it has had time to arrive. Pure: sensor time only."""

    def __init__(self, shift_s: float, has_imu: bool) -> None:
        """`shift_s`: from a frame's time to the IMU's time of its middle row."""
        self._shift_ns = round(shift_s * 1e9)
        self._has_imu = has_imu
        self._frames: deque[ImageFrame] = deque()
        self._samples: list[tuple[int, int, ImuBatch | DriveSample]] = []
        self._order = count()
        self._imu_until_ns = -(1 << 62)
        self._newest_frame_ns = -(1 << 62)

    def add_imu(self, imu: ImuBatch) -> None:
        heapq.heappush(self._samples, (int(imu.t_robot_ns[0]), next(self._order), imu))
        self._imu_until_ns = int(imu.t_robot_ns[-1])

    def add_drive(self, drive: DriveSample) -> None:
        heapq.heappush(self._samples, (drive.t_robot_ns, next(self._order), drive))

    def add_frame(self, frame: ImageFrame) -> None:
        """Frames out of time order are dropped: the camera's clock only runs forward."""
        if frame.t_robot_ns > self._newest_frame_ns:
            self._newest_frame_ns = frame.t_robot_ns
            self._frames.append(frame)

    def ready(self) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
        """What can go on now, in order."""
        while self._frames and self._is_complete(self._frames[0]):
            yield from self._release(self._frames.popleft())

    def rest(self) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
        """Everything that is still held, at the end."""
        while self._frames:
            yield from self._release(self._frames.popleft())
        while self._samples:
            yield heapq.heappop(self._samples)[2]

    def _is_complete(self, frame: ImageFrame) -> bool:
        if len(self._frames) > MAX_HELD_FRAMES:
            return True
        if self._has_imu:
            return self._imu_until_ns >= frame.t_robot_ns + self._shift_ns + HOLD_BACK_NS
        return self._newest_frame_ns >= frame.t_robot_ns + HOLD_BACK_NS

    def _release(self, frame: ImageFrame) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
        until_ns = frame.t_robot_ns + self._shift_ns
        while self._samples and self._samples[0][0] <= until_ns:
            _, _, sample = heapq.heappop(self._samples)
            if isinstance(sample, ImuBatch) and int(sample.t_robot_ns[-1]) > until_ns:
                early, late = _split(sample, until_ns)
                heapq.heappush(self._samples, (int(late.t_robot_ns[0]), next(self._order), late))
                yield early
            else:
                yield sample
        yield frame


def _split(imu: ImuBatch, until_ns: int) -> tuple[ImuBatch, ImuBatch]:
    early = imu.t_robot_ns <= until_ns
    return (
        ImuBatch(imu.t_robot_ns[early], imu.gyro_imu[early], imu.accel_imu[early]),
        ImuBatch(imu.t_robot_ns[~early], imu.gyro_imu[~early], imu.accel_imu[~early]),
    )
