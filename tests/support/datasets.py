"""What tests take from a recorded drive."""

from __future__ import annotations

from collections.abc import Iterator

from station.datasets import Dataset
from station.model.frames import ImageFrame, ImuBatch


def imu_of(data: Dataset) -> ImuBatch:
    """All inertial samples of a drive that has some."""
    assert data.imu is not None, f"{data.path} holds no IMU data"
    return data.imu


def frames_of(data: Dataset) -> Iterator[ImageFrame]:
    """The pictures of a drive that has some, in time order, still encoded."""
    assert data.read_frames is not None, f"{data.path} holds no camera images"
    return data.read_frames()
