"""Puts what the link delivers into sensor-time order, as SLAM needs it: inertial and drive samples, then the frame."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from itertools import count

from shared.errors import DataError
from station.model.frames import DriveSample, ImageFrame, ImuBatch

HOLD_BACK_NS = 60_000_000  # drive reports come every 50 ms, IMU batches every 20 ms; what is later is lost anyway
MAX_HELD_FRAMES = 60  # frames that wait for an IMU that has gone silent: two seconds, then they go without it
# A robot whose clocks disagree, or that lies, dates samples so that no frame ever reaches them.
MAX_AHEAD_NS = 60_000_000_000  # of the newest frame; a camera that is silent for a minute has lost SLAM anyway
MAX_HELD_SAMPLES = 60_000  # a minute at 1 kHz, 40 MB at most
_NEVER_NS = -(1 << 62)


class Sequencer:
    """Holds a frame until everything measured before it has had time to arrive. Pure: sensor time only."""

    def __init__(self, shift_s: float, has_imu: bool) -> None:
        """`shift_s`: from a frame's time to the IMU's time of its middle row."""
        self._shift_ns = round(shift_s * 1e9)
        self._has_imu = has_imu
        self._frames: deque[ImageFrame] = deque()
        self._samples: list[tuple[int, int, ImuBatch | DriveSample]] = []
        self._order = count()
        self._num_held = 0  # samples, of all batches
        self._imu_until_ns = _NEVER_NS
        self._newest_frame_ns = self._released_ns = _NEVER_NS

    def add_imu(self, imu: ImuBatch) -> None:
        """Raises DataError: these samples are left out, or others for them."""
        self._hold(int(imu.t_robot_ns[0]), int(imu.t_robot_ns[-1]), imu)
        self._imu_until_ns = int(imu.t_robot_ns[-1])

    def add_drive(self, drive: DriveSample) -> None:
        """Raises DataError, as add_imu."""
        self._hold(drive.t_robot_ns, drive.t_robot_ns, drive)

    def _hold(self, begin_ns: int, end_ns: int, sample: ImuBatch | DriveSample) -> None:
        if self._is_far_ahead(end_ns):
            raise DataError(
                f"samples dated more than {MAX_AHEAD_NS / 1e9:.0f} s after every picture are left out: the camera is"
                " silent, or the robot's clocks disagree"
            )
        self._push(begin_ns, sample)
        if self._num_held > MAX_HELD_SAMPLES:
            self._make_room()
            raise DataError(f"more than {MAX_HELD_SAMPLES} samples waited for a picture; the oldest are left out")

    def _is_far_ahead(self, t_ns: int) -> bool:
        return self._newest_frame_ns != _NEVER_NS and t_ns > self._newest_frame_ns + MAX_AHEAD_NS

    def _make_room(self) -> None:
        """What was dated far ahead before the first frame goes, then the oldest: some more, as looking takes time."""
        held = [entry for entry in self._samples if not self._is_far_ahead(entry[0])]
        self._samples = sorted(held)
        self._num_held = sum(_size(sample) for _, _, sample in held)
        while self._num_held > 0.9 * MAX_HELD_SAMPLES:
            self._pop()

    def _push(self, begin_ns: int, sample: ImuBatch | DriveSample) -> None:
        heapq.heappush(self._samples, (begin_ns, next(self._order), sample))
        self._num_held += _size(sample)

    def _pop(self) -> ImuBatch | DriveSample:
        _, _, sample = heapq.heappop(self._samples)
        self._num_held -= _size(sample)
        return sample

    def add_frame(self, frame: ImageFrame) -> None:
        """Frames out of time order are dropped: the camera's clock only runs forward.

        Raises DataError where one is far ahead of the next: it is left out while it waits, else those after it are.
        """
        far_ns = frame.t_robot_ns + MAX_AHEAD_NS
        is_wrong = self._newest_frame_ns > far_ns
        while self._frames and self._frames[-1].t_robot_ns > far_ns:
            self._frames.pop()
            self._newest_frame_ns = self._frames[-1].t_robot_ns if self._frames else self._released_ns
        if frame.t_robot_ns > self._newest_frame_ns:
            self._newest_frame_ns = frame.t_robot_ns
            self._frames.append(frame)
        if is_wrong:
            raise DataError(
                f"pictures dated more than {MAX_AHEAD_NS / 1e9:.0f} s before an earlier one: some are left out, the"
                " camera's clock jumped"
            )

    def ready(self) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
        """What can go on now, in order."""
        while self._frames and self._is_complete(self._frames[0]):
            yield from self._release(self._frames.popleft())

    def rest(self) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
        """Everything that is still held, at the end."""
        while self._frames:
            yield from self._release(self._frames.popleft())
        while self._samples:
            yield self._pop()

    def _is_complete(self, frame: ImageFrame) -> bool:
        if len(self._frames) > MAX_HELD_FRAMES:
            return True
        if self._has_imu:
            return self._imu_until_ns >= frame.t_robot_ns + self._shift_ns + HOLD_BACK_NS
        return self._newest_frame_ns >= frame.t_robot_ns + HOLD_BACK_NS

    def _release(self, frame: ImageFrame) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
        self._released_ns = frame.t_robot_ns
        until_ns = frame.t_robot_ns + self._shift_ns
        while self._samples and self._samples[0][0] <= until_ns:
            sample = self._pop()
            if isinstance(sample, ImuBatch) and int(sample.t_robot_ns[-1]) > until_ns:
                early, late = _split(sample, until_ns)
                self._push(int(late.t_robot_ns[0]), late)
                yield early
            else:
                yield sample
        yield frame


def _size(sample: ImuBatch | DriveSample) -> int:
    return len(sample) if isinstance(sample, ImuBatch) else 1


def _split(imu: ImuBatch, until_ns: int) -> tuple[ImuBatch, ImuBatch]:
    early = imu.t_robot_ns <= until_ns
    return (
        ImuBatch(imu.t_robot_ns[early], imu.gyro_imu[early], imu.accel_imu[early]),
        ImuBatch(imu.t_robot_ns[~early], imu.gyro_imu[~early], imu.accel_imu[~early]),
    )
