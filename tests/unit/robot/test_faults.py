"""What the robot tells of parts that fail or work badly."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from robot.config import PiConfig
from robot.devices.pi import camera as camera_module
from robot.devices.pi.camera import PiCamera
from robot.sensors import Faults
from shared.errors import DeviceLost
from tests.support import pi_stubs


def test_a_devices_problems_are_told_once_and_taken_back() -> None:
    told: list[str] = []
    faults = Faults(lambda device, _sentence: told.append(device))
    faults.set("camera", "no frames")
    faults.keep("robot", {"DRIVER_FAULT": "hot", "rx_bad": "damaged"})
    faults.keep("robot", {"DRIVER_FAULT": "hot"})
    assert told == ["camera", "robot DRIVER_FAULT", "robot rx_bad"]
    assert faults.sentences() == ("no frames", "hot")
    faults.keep("robot", {})
    assert faults.sentences() == ("no frames",)


@pytest.fixture
def _stubs() -> Iterator[None]:
    pi_stubs.install()
    yield
    pi_stubs.uninstall()


async def frame_after_failures(camera: PiCamera) -> int:
    while True:
        try:
            return (await camera.capture()).width
        except DeviceLost:
            await asyncio.sleep(0.01)


async def captures_until_failure(camera: PiCamera) -> None:
    while True:
        await camera.capture()


@pytest.mark.usefixtures("_stubs")
async def test_a_camera_that_hung_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_module, "SILENCE_S", 0.1)
    camera = PiCamera(PiConfig())
    try:
        pi_stubs.StubPicamera2.hangs = True
        with pytest.raises(DeviceLost):
            await captures_until_failure(camera)
        pi_stubs.StubPicamera2.hangs = False
        assert await asyncio.wait_for(frame_after_failures(camera), 30) == 640
    finally:
        await camera.close()


@pytest.mark.usefixtures("_stubs")
async def test_a_camera_whose_software_never_returns_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its thread hangs in the call, whatever the call's time-out: the robot says so, and ends when it is told to."""
    monkeypatch.setattr(camera_module, "SILENCE_S", 0.1)
    camera = PiCamera(PiConfig())
    pi_stubs.StubPicamera2.stuck.clear()
    try:
        with pytest.raises(DeviceLost, match="no frame"):
            await captures_until_failure(camera)
        await asyncio.wait_for(camera.close(), 30)
    finally:
        pi_stubs.StubPicamera2.stuck.set()


@pytest.mark.usefixtures("_stubs")
async def test_a_camera_that_failed_and_cannot_be_opened_anew_is_asked_until_it_can(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(camera_module, "SILENCE_S", 0.1)
    camera = PiCamera(PiConfig())
    pi_stubs.StubPicamera2.broken = True
    with pytest.raises(DeviceLost):
        await captures_until_failure(camera)
    pi_stubs.StubPicamera2.stuck.clear()
    with pytest.raises(DeviceLost, match="software hangs"):
        await captures_until_failure(camera)
    pi_stubs.StubPicamera2.broken = False
    pi_stubs.StubPicamera2.stuck.set()
    assert await asyncio.wait_for(frame_after_failures(camera), 30) == 640
    await camera.close()
