"""Our MCAP recordings (shared/mcap_recording.py) as datasets."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shared.errors import DataError
from shared.mcap_recording import HELLO_TOPIC, McapContent, mcap_depth, mcap_images
from station.datasets.dataset import Dataset, choose_frames, cut_to_frames
from station.model.frames import DepthFrame, DriveSample, ImageFrame, ImuBatch

logger = logging.getLogger(__name__)


def open_mcap(path: Path, first: int | None, last: int | None, step: int) -> Dataset:
    """Open a recording made by the station. Frames stay on disk; IMU and drive commands are read at once.

    Raises:
        DataError: no MCAP file, not one of ours, or nothing in it.
    """
    content = McapContent(path)
    if content.unusable_samples:
        logger.warning("%s: %d IMU samples are no numbers and are left out", path, content.unusable_samples)
    hello = content.hello
    if hello is None:
        raise DataError(f"{path} holds no {HELLO_TOPIC}; only recordings made by this station can be read")
    frame_times = np.array([t for t, _ in content.frames], dtype=np.int64)
    if not len(frame_times) and not content.samples:
        raise DataError(f"{path} holds neither images nor IMU samples; record again, with a robot connected")
    chosen = choose_frames(path, range(len(frame_times)), first, last, step)
    imu, drive = _imu(content), tuple(DriveSample(*command) for command in content.drive)
    if chosen and (first is not None or last is not None):
        imu, drive = cut_to_frames(imu, drive, frame_times[chosen])
    exposures = [exposure_ns for _, exposure_ns in content.frames]

    def read_frames() -> Iterator[ImageFrame]:
        wanted = iter(enumerate(chosen))
        index, position = next(wanted, (-1, -1))
        for count, jpeg in enumerate(mcap_images(path)):
            if count == position:
                yield ImageFrame(index, int(frame_times[count]), exposures[count], jpeg, f"{path.name} frame {count}")
                index, position = next(wanted, (-1, -1))
                if position < 0:
                    return

    sensor, depth_times = hello.calibration.depth_sensor, content.depth_times

    def read_depth() -> Iterator[DepthFrame]:
        if sensor is None:
            return
        whole = first is None and last is None
        for count, (t_ns, png) in enumerate(zip(depth_times, mcap_depth(path), strict=False)):
            if whole or not chosen or frame_times[chosen[0]] <= t_ns <= frame_times[chosen[-1]]:
                yield DepthFrame(t_ns, png, sensor, f"{path.name} depth {count}")

    return Dataset(
        path=path,
        kind="mcap",
        calibration=hello.calibration,
        intrinsics_known=True,
        frame_times_ns=frame_times[chosen],
        read_frames=read_frames if chosen else None,
        imu=imu,
        drive=drive,
        read_depth=read_depth if depth_times and sensor is not None else None,
    )


def _imu(content: McapContent) -> ImuBatch | None:
    if not content.samples:
        return None
    table = np.array([values for _, values in content.samples], dtype=np.float64)
    times = np.array([t for t, _ in content.samples], dtype=np.int64)
    return ImuBatch(times, np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3:]))
