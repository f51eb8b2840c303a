"""Moves what camera and IMU deliver into the outbox, and keeps going when a device fails."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

from robot.depth import DepthSlot
from robot.devices.ports import Camera, DepthSensor, EndOfRecording, Imu
from robot.outbox import ImuBacklog
from robot.video import FrameSlot
from shared.calibration import MAX_IMAGE_SIDE_PX
from shared.errors import HardwareError
from shared.framing import MAX_ROBOT_PAYLOAD
from shared.messages import MAX_DEPTH_BYTES

logger = logging.getLogger(__name__)

RETRY_S = 1.0  # a lost device is asked again so often; adapters reopen what they can
MAX_JPEG_BYTES = MAX_ROBOT_PAYLOAD - 1024  # the rest of a frame message


class Faults:
    """What does not work at present: device → sentence."""

    def __init__(self, on_new: Callable[[str, str], None]) -> None:
        self._on_new = on_new
        self._sentences: dict[str, str] = {}

    def sentences(self) -> tuple[str, ...]:
        return tuple(self._sentences.values())

    def set(self, device: str, sentence: str) -> None:
        """A device fails; told once until it changes."""
        if self._sentences.get(device) != sentence:
            logger.warning("%s", sentence)
            self._sentences[device] = sentence
            self._on_new(device, sentence)

    def keep(self, prefix: str, sentences: dict[str, str]) -> None:
        """All that is wrong with one device: what is no longer among it, works again."""
        wanted = {f"{prefix} {name}": sentence for name, sentence in sentences.items()}
        for device in [d for d in self._sentences if d.startswith(f"{prefix} ") and d not in wanted]:
            self.clear(device)
        for device, sentence in wanted.items():
            self.set(device, sentence)

    def clear(self, device: str) -> None:
        """The device works (again)."""
        if self._sentences.pop(device, None) is not None:
            logger.info("%s works again", device)


async def pump_camera(
    camera: Camera, slot: FrameSlot, faults: Faults, wake: Callable[[], None], now_ns: Callable[[], int]
) -> None:
    """Put every frame into the slot until the recording ends."""

    async def take_one() -> None:
        frame = await camera.capture()
        if len(frame.jpeg) > MAX_JPEG_BYTES or max(frame.width, frame.height) > MAX_IMAGE_SIDE_PX:
            faults.set("camera", f"a camera frame of {len(frame.jpeg)} bytes is too large to send; lower its quality")
            return
        slot.put(frame, now_ns())
        wake()
        faults.clear("camera")

    await _repeat("camera", take_one, faults)


async def pump_depth(sensor: DepthSensor, slot: DepthSlot, faults: Faults, wake: Callable[[], None]) -> None:
    """Put every depth picture into the slot until the recording ends."""

    async def take_one() -> None:
        depth = await sensor.measure()
        if len(depth.png) > MAX_DEPTH_BYTES:
            faults.set("depth", f"a depth picture of {len(depth.png)} bytes is too large to send; take smaller ones")
            return
        slot.put(depth)
        wake()
        faults.clear("depth")

    await _repeat("depth", take_one, faults)


async def pump_imu(
    imu: Imu, backlog: ImuBacklog, faults: Faults, wake: Callable[[], None], batch_interval_s: float
) -> None:
    """Put every sample into the backlog until the recording ends."""

    async def take_some() -> None:
        readings = await imu.read()
        for reading in readings:
            backlog.append(reading)
        wake()
        faults.clear("imu")
        await asyncio.sleep(batch_interval_s)

    await _repeat("imu", take_some, faults)


async def _repeat(device: str, step: Callable[[], Awaitable[None]], faults: Faults) -> None:
    while True:
        try:
            await step()
        except EndOfRecording:
            return
        except HardwareError as exc:
            faults.set(device, f"{device}: {exc}")
            await asyncio.sleep(RETRY_S)
