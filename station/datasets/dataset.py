"""One recorded navigation, whatever format it lies in: the same calls for every kind of dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shared.calibration import Calibration
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray
from station.model.frames import DepthFrame, DriveSample, ImageFrame, ImuBatch

# Inertial samples kept on both sides of a chosen range of frames: filters interpolate at its ends.
IMU_MARGIN_NS = 500_000_000
LAST_NS = int(np.iinfo(np.int64).max)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where the body really was. For judging only."""

    t_robot_ns: IntArray  # (N,) increasing
    T_world_body: FloatArray  # (N, 4, 4), the truth's own world; body = IMU, or the camera where there is no IMU
    v_world: FloatArray | None = None  # (N, 3) m/s
    gyro_bias: FloatArray | None = None  # (N, 3) rad/s
    accel_bias: FloatArray | None = None  # (N, 3) m/s^2

    def __len__(self) -> int:
        return len(self.t_robot_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """Sensor data of one navigation. Frames stay on disk until asked for; everything else is in memory."""

    path: Path
    kind: str  # "asl", "images", "video", "mcap"
    calibration: Calibration
    intrinsics_known: bool  # False: only a rough guess, let SfM refine it
    frame_times_ns: IntArray  # (F,) robot clock; also where the images themselves are absent
    read_frames: Callable[[], Iterator[ImageFrame]] | None  # None: no images
    imu: ImuBatch | None = None  # all samples; None: no IMU
    drive: Sequence[DriveSample] = ()  # velocities the motors were told to hold; empty where not recorded
    truth: Truth | None = None  # for judging, never for estimating
    read_depth: Callable[[], Iterator[DepthFrame]] | None = None  # in time order; None: no depth sensor

    @property
    def has_images(self) -> bool:
        return self.read_frames is not None

    def events(self) -> Iterator[ImuBatch | DriveSample | DepthFrame | ImageFrame]:
        """Everything in sensor-time order, as a SlamBackend wants it: what was measured up to a frame comes before it.

        Up to its stamp, and up to when it was taken by the IMU's clock: a camera may stamp earlier than that.
        """
        pending = _InertialEvents(self.imu, self.drive)
        depth = _until(iter(()) if self.read_depth is None else self.read_depth())
        camera = self.calibration.camera
        late_ns = max(0, round(1e9 * camera.middle_row_shift_s)) if camera is not None else 0
        if self.read_frames is not None:
            for frame in self.read_frames():
                yield from pending.until(frame.t_robot_ns + late_ns)
                yield from depth(frame.t_robot_ns + late_ns)
                yield frame
        yield from pending.until(LAST_NS)
        yield from depth(LAST_NS)


def _until(frames: Iterator[DepthFrame]) -> Callable[[int], Iterator[DepthFrame]]:
    """Hands out what was measured up to a time, one time after the other."""
    waiting = next(frames, None)

    def until(t_ns: int) -> Iterator[DepthFrame]:
        nonlocal waiting
        while waiting is not None and waiting.t_robot_ns <= t_ns:
            yield waiting
            waiting = next(frames, None)

    return until


class _InertialEvents:
    """IMU samples cut at drive commands and at the times asked for."""

    def __init__(self, imu: ImuBatch | None, drive: Sequence[DriveSample]) -> None:
        self._imu = imu
        self._drive = drive
        self._next_imu = 0
        self._next_drive = 0

    def until(self, t_ns: int) -> Iterator[ImuBatch | DriveSample]:
        while self._next_drive < len(self._drive) and self._drive[self._next_drive].t_robot_ns <= t_ns:
            sample = self._drive[self._next_drive]
            self._next_drive += 1
            yield from self._imu_until(sample.t_robot_ns)
            yield sample
        yield from self._imu_until(t_ns)

    def _imu_until(self, t_ns: int) -> Iterator[ImuBatch]:
        if self._imu is None:
            return
        stop = int(np.searchsorted(self._imu.t_robot_ns, t_ns, side="right"))
        if stop > self._next_imu:
            yield slice_imu(self._imu, self._next_imu, stop)
            self._next_imu = stop


def slice_imu(imu: ImuBatch, start: int, stop: int) -> ImuBatch:
    """Samples start..stop-1."""
    return ImuBatch(imu.t_robot_ns[start:stop], imu.gyro_imu[start:stop], imu.accel_imu[start:stop])


def choose_frames(path: Path, numbers: Sequence[int], first: int | None, last: int | None, step: int) -> list[int]:
    """Positions of the frames whose number lies in first..last (both included), every step-th of them.

    Raises DataError where there are frames, but none of them there; `path` is what the message calls the whole.
    """
    if step < 1:
        raise DataError(f"step {step} must be at least 1")
    chosen = [
        i for i, number in enumerate(numbers) if (first is None or number >= first) and (last is None or number <= last)
    ]
    if numbers and not chosen:
        raise DataError(f"{path} has {len(numbers)} frames, none of them in the range asked for")
    return chosen[::step]


def cut_to_frames(
    imu: ImuBatch | None, drive: Sequence[DriveSample], frame_times_ns: IntArray
) -> tuple[ImuBatch | None, tuple[DriveSample, ...]]:
    """The inertial samples and commands that belong to a chosen range of frames, with a margin."""
    begin, end = int(frame_times_ns[0]) - IMU_MARGIN_NS, int(frame_times_ns[-1]) + IMU_MARGIN_NS
    if imu is not None:
        start, stop = np.searchsorted(imu.t_robot_ns, [begin, end])
        imu = slice_imu(imu, int(start), int(stop)) if stop > start else None
    # The command that holds at the begin was given before it.
    held = [d for d in drive if d.t_robot_ns < begin][-1:]
    return imu, (*held, *(d for d in drive if begin <= d.t_robot_ns < end))
