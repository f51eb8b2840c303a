"""The Pi's camera through picamera2 (Debian's python3-picamera2). The only file that imports it."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from robot.config import PiConfig
from robot.devices.mailbox import Mailbox
from robot.devices.pi.exposure import Exposure, ExposureControl
from robot.devices.ports import CapturedFrame
from shared.errors import DeviceLost, DeviceUnavailable

logger = logging.getLogger(__name__)

SILENCE_S = 2.0
EXPOSURE_PERIOD_FRAMES = 6  # a change takes the sensor three frames to show
WHITE_BALANCE_FRAMES = 45  # let it find the light of the room, then hold it
BRIGHTNESS_STEP = 8  # every 8th pixel is enough
LENS_POSITION = 0.5  # dioptres, for cameras with a focus motor; the reference camera is turned by hand


class PiCamera:
    """Frames with sensor time stamps. A thread of its own captures and compresses; the newest frame wins."""

    def __init__(self, settings: PiConfig) -> None:
        self._settings = settings
        self._max_exposure_us = round(1000 * settings.max_exposure_ms)
        self._frames: Mailbox[CapturedFrame] = Mailbox(1)
        self._failure = ""
        self._dark = False
        self._closed = threading.Event()
        self._reopening: _Errand | None = None
        self._camera = self._open()
        self._thread = self._start()

    async def capture(self) -> CapturedFrame:
        """The next frame. Raises DeviceLost on silence and while the picture is black."""
        if not self._thread.is_alive():
            await asyncio.to_thread(self._reopen)  # a camera stack that hangs must not hold the server up
        try:
            async with asyncio.timeout(SILENCE_S):  # wait_for may swallow a cancellation before Python 3.12
                return (await self._frames.get())[0]
        except TimeoutError:
            raise DeviceLost(self._why_silent()) from None

    async def close(self) -> None:
        """Release the camera; one that hangs is left to the process' end. Safe to call twice."""
        self._closed.set()
        await asyncio.to_thread(self._thread.join, SILENCE_S)
        closing = _Errand(self._release)
        if not await asyncio.to_thread(closing.wait, SILENCE_S):
            logger.warning("the camera does not let itself be closed")

    def _why_silent(self) -> str:
        if self._dark:
            return "the camera sees only black; take the lens cap off or switch a light on"
        return self._failure or f"the camera gave no frame for {SILENCE_S:.0f} s; check its ribbon cable"

    def _open(self) -> Any:
        try:
            from picamera2 import Picamera2
        except ImportError as exc:
            raise DeviceUnavailable(
                "the camera needs python3-picamera2 and a venv that sees it; run robot/install.sh on the Pi"
            ) from exc
        s = self._settings
        try:
            camera = Picamera2()
            period_us = round(1e6 / s.rate_hz)
            controls: dict[str, Any] = {"FrameDurationLimits": (period_us, period_us), "AeEnable": False}
            controls |= {"ExposureTime": self._max_exposure_us, "AnalogueGain": 2.0}
            if "LensPosition" in camera.camera_controls:
                controls |= {"AfMode": 0, "LensPosition": LENS_POSITION}  # 0: manual
            # "RGB888" is blue first in memory, as OpenCV has it.
            camera.configure(
                camera.create_video_configuration(
                    main={"size": (s.width, s.height), "format": "RGB888"}, buffer_count=4, controls=controls
                )
            )
            camera.start()
        except (IndexError, RuntimeError, OSError) as exc:  # picamera2 raises IndexError where it finds no camera
            raise DeviceUnavailable(
                f"the camera cannot be opened ({exc}); check its ribbon cable and `rpicam-hello --list-cameras`"
            ) from exc
        return camera

    def _start(self) -> threading.Thread:
        thread = threading.Thread(target=self._run, name="camera", daemon=True)
        thread.start()
        return thread

    def _reopen(self) -> None:
        """Close what failed and open it anew. Raises DeviceLost where that fails or hangs; call again."""
        if self._reopening is None:
            self._reopening = _Errand(self._release_and_open)
        if not self._reopening.wait(SILENCE_S):
            raise DeviceLost("the camera's software hangs; if this lasts, restart the Pi")
        done, self._reopening = self._reopening, None
        if done.error is not None:
            raise DeviceLost(str(done.error)) from done.error
        self._failure = ""
        self._thread = self._start()

    def _release(self) -> None:
        # The job that timed out still stands first in picamera2's queue; a stop would wait behind it.
        if hasattr(self._camera, "cancel_all_and_flush"):
            self._camera.cancel_all_and_flush()
        self._camera.close()

    def _release_and_open(self) -> None:
        self._release()
        self._camera = self._open()

    def _run(self) -> None:
        control = ExposureControl(self._max_exposure_us, self._settings.max_gain)
        count = 0
        try:
            while not self._closed.is_set():
                # Seconds, then TimeoutError: picamera2 0.3.20 and later. Older ones wait for ever; capture() says so.
                request = self._camera.capture_request(wait=SILENCE_S)
                try:
                    image, metadata = request.make_array("main"), request.get_metadata()
                finally:
                    request.release()
                if count == WHITE_BALANCE_FRAMES:
                    self._camera.set_controls({"AwbEnable": False, "ColourGains": metadata["ColourGains"]})
                brightness = float(np.mean(image[::BRIGHTNESS_STEP, ::BRIGHTNESS_STEP]))
                now = Exposure(int(metadata["ExposureTime"]), float(metadata["AnalogueGain"]))
                self._dark = control.is_black(now, brightness)
                if count % EXPOSURE_PERIOD_FRAMES == 0 and (wanted := control.next(now, brightness)) is not None:
                    self._camera.set_controls({"ExposureTime": wanted.time_us, "AnalogueGain": wanted.gain})
                count += 1
                if not self._dark:
                    self._publish(image, metadata)
        except Exception as exc:  # whatever the camera stack throws ends this thread; capture() says so and reopens
            self._failure = f"the camera failed ({exc or type(exc).__name__}); trying to open it again"
            logger.warning("%s", self._failure)

    def _publish(self, image: Any, metadata: dict[str, Any]) -> None:
        import simplejpeg

        exposure_ns = int(metadata["ExposureTime"]) * 1000
        # SensorTimestamp: the first row's end of exposure, on CLOCK_BOOTTIME as libcamera has it.
        t_end_ns = int(metadata["SensorTimestamp"]) + boot_to_monotonic_ns()
        height, width = image.shape[:2]
        jpeg = simplejpeg.encode_jpeg(image, quality=self._settings.jpeg_quality, colorspace="BGR")
        self._frames.put(CapturedFrame(t_end_ns - exposure_ns // 2, exposure_ns, width, height, jpeg))


class _Errand:
    """A call in a thread of its own that may never return: whoever waits for it, and the program's end, need not."""

    def __init__(self, call: Callable[[], None]) -> None:
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(call,), name="camera-errand", daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float) -> bool:
        """Whether it has returned."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception as exc:  # told to whoever waits, whatever the camera stack throws
            self.error = exc


def boot_to_monotonic_ns() -> int:
    """monotonic - boottime: zero on a Pi that never slept."""
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return 0
    return time.monotonic_ns() - time.clock_gettime_ns(time.CLOCK_BOOTTIME)
