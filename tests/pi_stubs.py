"""Stand-ins for the Pi's vendor modules that obey the real ones' rules. They are put into sys.modules by the tests."""

from __future__ import annotations

import sys
import threading
import time
from types import ModuleType
from typing import Any

import cv2
import numpy as np


class StubRequest:
    """A captured frame; its buffer is in use until `release`."""

    def __init__(self, camera: StubPicamera2, image: np.ndarray[Any, Any], metadata: dict[str, Any]) -> None:
        self._camera, self._image, self._metadata, self._released = camera, image, metadata, False

    def make_array(self, name: str) -> np.ndarray[Any, Any]:
        assert name == "main" and not self._released
        return self._image

    def get_metadata(self) -> dict[str, Any]:
        assert not self._released
        return self._metadata

    def release(self) -> None:
        assert not self._released, "a request is released once"
        self._released = True
        self._camera.free.release()


class StubPicamera2:
    """One camera: opened once at a time, configured before it starts, four buffers, controls by their names."""

    in_use: StubPicamera2 | None = None
    present = True
    lens_cap = False
    broken = False
    hangs = False

    def __init__(self) -> None:
        if not StubPicamera2.present:
            raise IndexError("list index out of range")
        if StubPicamera2.in_use is not None:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        StubPicamera2.in_use = self
        names = "AeEnable AwbEnable ColourGains ExposureTime AnalogueGain FrameDurationLimits"
        self.camera_controls = dict.fromkeys(names.split(), (0, 1, 0))
        self.controls: dict[str, Any] = {}
        self.started = False
        self._config: dict[str, Any] | None = None

    def create_video_configuration(self, main: dict[str, Any], buffer_count: int, controls: dict[str, Any]) -> Any:
        return {"main": main, "buffer_count": buffer_count, "controls": controls}

    def configure(self, config: dict[str, Any]) -> None:
        assert not self.started
        self._config = config
        self.free = threading.Semaphore(config["buffer_count"])
        self.set_controls(config["controls"])

    def set_controls(self, controls: dict[str, Any]) -> None:
        for name in controls:
            if name not in self.camera_controls:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        self.controls |= controls

    def start(self) -> None:
        assert self._config is not None, "configure first"
        self.started = True

    def capture_request(self, wait: float | None = None) -> StubRequest:
        assert self.started and self._config is not None
        if StubPicamera2.hangs:
            time.sleep(1e6 if wait is None else wait)
            raise TimeoutError
        assert self.free.acquire(timeout=5), "all buffers are held: somebody forgot to release"
        period_s = self.controls["FrameDurationLimits"][0] * 1e-6
        time.sleep(period_s)
        if StubPicamera2.broken:
            self.free.release()
            raise RuntimeError("Camera frontend has timed out!")
        width, height = self._config["main"]["size"]
        light = 0.0 if StubPicamera2.lens_cap else 1.0
        exposure, gain = self.controls["ExposureTime"], self.controls["AnalogueGain"]
        level = min(255.0, light * exposure * gain / 200.0)
        image = np.full((height, width, 3), level, np.uint8)
        t_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns()
        metadata = {
            "SensorTimestamp": t_ns,
            "ExposureTime": exposure,
            "AnalogueGain": gain,
            "ColourGains": (1.5, 1.7),
        }
        return StubRequest(self, image, metadata)

    def close(self) -> None:
        self.started = False
        StubPicamera2.in_use = None


def encode_jpeg(image: np.ndarray[Any, Any], quality: int, colorspace: str) -> bytes:
    assert colorspace == "BGR"
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def install() -> None:
    """Put the stubs where imports find them, in their initial state."""
    StubPicamera2.in_use, StubPicamera2.present = None, True
    StubPicamera2.lens_cap = StubPicamera2.broken = StubPicamera2.hangs = False
    for name, content in (("picamera2", {"Picamera2": StubPicamera2}), ("simplejpeg", {"encode_jpeg": encode_jpeg})):
        module = ModuleType(name)
        module.__dict__.update(content)
        sys.modules[name] = module


def uninstall() -> None:
    for name in ("picamera2", "simplejpeg"):
        sys.modules.pop(name, None)
