"""A stand-in for Luxonis' depthai 3 with one OAK-D, which obeys the rules of the real one that we lean on."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

K = [[400.0, 0.0, 321.0], [0.0, 402.0, 199.0], [0.0, 0.0, 1.0]]


class Socket(Enum):
    CAM_A = 0
    CAM_B = 1
    CAM_C = 2


class ExposureOffset(Enum):
    START = 0
    MIDDLE = 1
    END = 2


class Oak:
    """The camera, as tests handle it."""

    present = True
    opened = 0
    age_s = 0.0  # of each picture
    millimetres = np.zeros((400, 640), dtype=np.uint16)


class Frame:
    def getTimestamp(self, offset: ExposureOffset = ExposureOffset.END) -> timedelta:
        assert offset is ExposureOffset.MIDDLE, "depth is of the middle of the exposure"
        return Clock.now() - timedelta(seconds=Oak.age_s)

    def getFrame(self) -> np.ndarray[Any, Any]:
        return Oak.millimetres

    def getTransformation(self) -> Any:
        return SimpleNamespace(getIntrinsicMatrix=lambda: K)


class Queue:
    def get(self, timeout: timedelta) -> Frame | None:
        assert timeout > timedelta(0)
        time.sleep(0.01)
        if not Oak.present:
            raise RuntimeError("Couldn't read data from stream: 'depth' (X_LINK_ERROR)")
        return Frame()


class Camera:
    def build(self, socket: Socket) -> Camera:
        self.socket = socket
        return self

    def requestOutput(self, size: tuple[int, int], *, fps: float) -> Camera:
        assert fps > 0
        self.size = size
        return self


class StereoDepth:
    def build(self, left: Camera, right: Camera) -> StereoDepth:
        assert (left.socket, right.socket) == (Socket.CAM_B, Socket.CAM_C) and left.size == right.size == (640, 400)
        return self

    @property
    def depth(self) -> Any:
        def create(maxSize: int, blocking: bool) -> Queue:
            assert maxSize == 1 and not blocking
            return Queue()

        return SimpleNamespace(createOutputQueue=create)


class Pipeline:
    def __init__(self) -> None:
        if not Oak.present:
            raise RuntimeError("No available devices")
        Oak.opened += 1

    def create(self, kind: type[Any]) -> Any:
        return kind()

    def start(self) -> None: ...

    def stop(self) -> None:
        if not Oak.present:
            raise RuntimeError("the device is gone")


class Clock:
    @staticmethod
    def now() -> timedelta:
        return timedelta(microseconds=time.monotonic_ns() / 1000)


@contextmanager
def installed() -> Iterator[type[Oak]]:
    """Where imports find it, a camera plugged in."""
    module = ModuleType("depthai")
    module.__dict__.update(
        Pipeline=Pipeline,
        CameraBoardSocket=Socket,
        CameraExposureOffset=ExposureOffset,
        Clock=Clock,
        node=SimpleNamespace(Camera=Camera, StereoDepth=StereoDepth),
    )
    before = sys.modules.get("depthai")
    sys.modules["depthai"] = module
    Oak.present, Oak.opened, Oak.age_s = True, 0, 0.0
    Oak.millimetres = np.full((400, 640), 1500, dtype=np.uint16)
    try:
        yield Oak
    finally:
        del sys.modules["depthai"]
        if before is not None:
            sys.modules["depthai"] = before
