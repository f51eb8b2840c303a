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
    hangs = False  # no more frames come: `capture_request` waits
    stuck = threading.Event()  # not set: no call returns, whatever its time-out, as in a driver that hangs
    floods = False  # frames of noise, as fast as they are taken

    def __init__(self) -> None:
        StubPicamera2.stuck.wait()
        if not StubPicamera2.present:
            raise IndexError("list index out of range")
        if StubPicamera2.in_use is not None:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        StubPicamera2.in_use = self
        names = "AeEnable AwbEnable ColourGains ExposureTime AnalogueGain FrameDurationLimits"
        self.camera_controls = dict.fromkeys(names.split(), (0, 1, 0))
        self.controls: dict[str, Any] = {}
        self.started = False
        self.waiting_job = False
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

    def capture_request(
        self, wait: bool | float | None = None, signal_function: Any = None, flush: Any = None
    ) -> StubRequest:
        """`wait`: None and True wait for ever, a number of seconds ends in TimeoutError (picamera2 0.3.36)."""
        assert self.started and self._config is not None and signal_function is None and flush is None
        assert wait is not False, "that gives a job, no request"
        assert not self.waiting_job, "the job before still stands in the queue"
        StubPicamera2.stuck.wait()
        until_s = time.monotonic() + (1e6 if wait in (None, True) else float(wait or 0.0))
        self.waiting_job = True
        while StubPicamera2.hangs:
            if time.monotonic() > until_s:
                raise TimeoutError
            time.sleep(0.005)
        self.waiting_job = False
        assert self.free.acquire(timeout=5), "all buffers are held: somebody forgot to release"
        period_s = self.controls["FrameDurationLimits"][0] * 1e-6
        time.sleep(0.0 if StubPicamera2.floods else period_s)
        if StubPicamera2.broken:
            self.free.release()
            raise RuntimeError("Camera frontend has timed out!")
        width, height = self._config["main"]["size"]
        light = 0.0 if StubPicamera2.lens_cap else 1.0
        exposure, gain = self.controls["ExposureTime"], self.controls["AnalogueGain"]
        level = min(255.0, light * exposure * gain / 200.0)
        image = np.full((height, width, 3), level, np.uint8)
        if StubPicamera2.floods:
            image = np.random.default_rng().integers(0, 256, (height, width, 3), np.uint8)
        t_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns()
        metadata = {
            "SensorTimestamp": t_ns,
            "ExposureTime": exposure,
            "AnalogueGain": gain,
            "ColourGains": (1.5, 1.7),
        }
        return StubRequest(self, image, metadata)

    def cancel_all_and_flush(self) -> None:
        self.waiting_job = False

    def close(self) -> None:
        StubPicamera2.stuck.wait()
        assert not self.waiting_job, "close would wait for ever behind the job that timed out"
        self.started = False
        StubPicamera2.in_use = None


def encode_jpeg(image: np.ndarray[Any, Any], quality: int, colorspace: str) -> bytes:
    assert colorspace == "BGR"
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


class StubIna219:
    """The chip's registers (SBOS448G, 8.6): most significant byte first, so an SMBus word shows them swapped."""

    voltage_v = 7.4

    def __init__(self) -> None:
        self._configuration = 0x399F  # after power on: 32 V range, shunt and bus continuously

    def read(self, register: int) -> int:
        """A register as the datasheet draws it."""
        converted, overflow = 1 << 1, 0
        registers = {0x00: self._configuration, 0x02: round(self.voltage_v / 0.004) << 3 | converted | overflow}
        return registers.get(register, 0)


class StubSMBus:
    """I2C bus 1 of the Pi with an INA219 at 0x40."""

    connected = True

    def __init__(self, bus: int) -> None:
        if bus != 1:
            raise FileNotFoundError(2, "No such file or directory", f"/dev/i2c-{bus}")
        self._chip = StubIna219()

    def read_word_data(self, i2c_addr: int, register: int, force: bool | None = None) -> int:
        if not StubSMBus.connected or i2c_addr != 0x40:
            raise OSError(121, "Remote I/O error")
        word = self._chip.read(register)
        return (word & 0xFF) << 8 | word >> 8


MODULES: dict[str, dict[str, Any]] = {
    "picamera2": {"Picamera2": StubPicamera2},
    "simplejpeg": {"encode_jpeg": encode_jpeg},
    "smbus2": {"SMBus": StubSMBus},
}


def install() -> None:
    """Put the stubs where imports find them, in their initial state."""
    StubPicamera2.in_use, StubPicamera2.present = None, True
    StubPicamera2.lens_cap = StubPicamera2.broken = StubPicamera2.hangs = StubPicamera2.floods = False
    StubPicamera2.stuck.set()
    StubSMBus.connected, StubIna219.voltage_v = True, 7.4
    for name, content in MODULES.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        sys.modules[name] = module


def uninstall() -> None:
    for name in MODULES:
        sys.modules.pop(name, None)
