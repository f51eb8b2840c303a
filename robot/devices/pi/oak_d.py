"""A Luxonis OAK-D on USB, which measures depth by two cameras of its own. The only file that imports depthai."""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
from datetime import timedelta
from typing import Any

import numpy as np
import numpy.typing as npt

from robot.devices.mailbox import Mailbox
from robot.devices.ports import CapturedDepth
from shared.advice import install
from shared.calibration import DepthCalibration
from shared.errors import ConfigError, DeviceLost, DeviceUnavailable
from shared.geometry import se3
from shared.pictures import depth_png

logger = logging.getLogger(__name__)

SIZE = (640, 400)  # px, of the pair that depth is made of
RATE_HZ = 5.0  # stations get four a second
STEP = 2  # of so many pixels one is kept, across and down: 320 x 200 have 60 kB, and maps keep 64 a side
SILENCE_S = 3.0
REOPEN_S = 1.0
CLOSE_S = SILENCE_S + 1.0  # a thread that waits for a picture ends after SILENCE_S


class OakD:
    """Depth pictures. A thread of its own takes, thins and compresses them; the newest wins."""

    def __init__(self, position_m: tuple[float, float, float], pitch_rad: float) -> None:
        """Opens the camera and waits for its first picture, which says how its pixels look.

        Args:
            position_m: of the camera from the IMU: forward, left, up.
            pitch_rad: by how much it looks up.
        Raises:
            DeviceUnavailable: no depthai, or no camera.
        """
        self._pictures: Mailbox[CapturedDepth] = Mailbox(1)
        self._closed = threading.Event()
        stream = _Stream()
        try:
            first = stream.next()
            self.calibration = calibration_of(first, position_m, pitch_rad)
        except (DeviceLost, ConfigError) as exc:
            stream.close()
            raise DeviceUnavailable(str(exc)) from exc
        self._thread = threading.Thread(target=self._run, args=(stream,), name="oak-d", daemon=True)
        self._thread.start()

    async def measure(self) -> CapturedDepth:
        return (await self._pictures.get())[-1]

    async def close(self) -> None:
        await asyncio.to_thread(self.end)

    def end(self) -> None:
        """As `close`, for whoever has no event loop. Safe to call twice."""
        self._closed.set()
        self._thread.join(CLOSE_S)

    def _run(self, stream: _Stream | None) -> None:
        while not self._closed.is_set():
            try:
                stream = stream or _Stream()
                self._publish(stream.next())
                self._pictures.recover()
            except (DeviceLost, DeviceUnavailable) as exc:
                logger.warning("%s", exc)
                self._pictures.fail(DeviceLost(str(exc)))
                if stream is not None:
                    stream.close()
                    stream = None
                self._closed.wait(REOPEN_S)
        if stream is not None:
            stream.close()

    def _publish(self, picture: _Picture) -> None:
        size = picture.millimetres.shape[::-1]
        if size != (self.calibration.width, self.calibration.height):
            raise DeviceLost(f"the OAK-D now gives pictures of {size[0]}x{size[1]}; restart robot-server")
        self._pictures.put(CapturedDepth(picture.t_robot_ns, depth_png(picture.millimetres)))


class _Picture:
    """What came, thinned."""

    def __init__(self, t_robot_ns: int, millimetres: npt.NDArray[np.uint16], K: npt.NDArray[np.float64]) -> None:
        first = (STEP - 1) // 2
        self.t_robot_ns = t_robot_ns
        self.millimetres = np.ascontiguousarray(millimetres[first::STEP, first::STEP])
        self.full_size = millimetres.shape[::-1]
        self.K = K  # (3, 3) px, before it was thinned


def calibration_of(picture: _Picture, position_m: tuple[float, float, float], pitch_rad: float) -> DepthCalibration:
    """As the camera's own calibration has it; where it sits, somebody told by hand. Raises ConfigError."""
    c, s = math.cos(pitch_rad), math.sin(pitch_rad)
    R_body_depth = np.array([[0.0, s, c], [-1.0, 0.0, 0.0], [0.0, -c, s]])
    full = DepthCalibration(
        width=picture.full_size[0],
        height=picture.full_size[1],
        fx=float(picture.K[0, 0]),
        fy=float(picture.K[1, 1]),
        cx=float(picture.K[0, 2]),
        cy=float(picture.K[1, 2]),
        T_body_depth=tuple(se3(R_body_depth, np.array(position_m)).ravel().tolist()),
        is_measured=False,
    )
    return full.thinned(STEP)


class _Stream:
    """An open camera. Raises DeviceUnavailable."""

    def __init__(self) -> None:
        try:
            import depthai
        except ImportError as exc:
            raise DeviceUnavailable(
                f'pi.depth = "oak-d" needs {exc.name}, which is not installed; run: {install("oak")}'
            ) from exc
        self._depthai: Any = depthai
        try:
            self._pipeline = depthai.Pipeline()
            socket = depthai.CameraBoardSocket
            left, right = (
                self._pipeline.create(depthai.node.Camera).build(side).requestOutput(SIZE, fps=RATE_HZ)
                for side in (socket.CAM_B, socket.CAM_C)
            )
            stereo = self._pipeline.create(depthai.node.StereoDepth).build(left, right)
            self._queue = stereo.depth.createOutputQueue(maxSize=1, blocking=False)
            self._pipeline.start()
        except Exception as exc:  # depthai raises RuntimeError and others, by release and cause
            raise DeviceUnavailable(
                f"the OAK-D cannot be opened ({exc}); plug it into a blue USB 3 port with its own cable"
            ) from exc

    def next(self) -> _Picture:
        """Waits for one. Raises DeviceLost."""
        try:
            frame = self._queue.get(timedelta(seconds=SILENCE_S))
            if frame is None:
                raise DeviceLost(f"the OAK-D gave no depth for {SILENCE_S:.0f} s; check its USB cable")
            age = self._depthai.Clock.now() - frame.getTimestamp(self._depthai.CameraExposureOffset.MIDDLE)
            millimetres = np.asarray(frame.getFrame(), dtype=np.uint16)
            K = np.array(frame.getTransformation().getIntrinsicMatrix(), dtype=np.float64)
        except DeviceLost:
            raise
        except Exception as exc:  # see above
            raise DeviceLost(f"the OAK-D failed ({exc or type(exc).__name__}); trying to open it again") from exc
        return _Picture(time.monotonic_ns() - round(1e9 * age.total_seconds()), millimetres, K)

    def close(self) -> None:
        try:
            self._pipeline.stop()
        except Exception as exc:  # a camera that was pulled out
            logger.info("the OAK-D does not end well (%s)", exc)
