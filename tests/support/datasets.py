"""What tests take from a recorded drive."""

from __future__ import annotations

from station.datasets import Dataset
from station.model.frames import ImuBatch


def imu_of(data: Dataset) -> ImuBatch:
    """All inertial samples of a drive that has some."""
    assert data.imu is not None, f"{data.path} holds no IMU data"
    return data.imu
