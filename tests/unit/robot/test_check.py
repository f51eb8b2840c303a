"""`robot-server --check`: what it turns, and what it says it did not test."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest

from robot import check
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.ports import CapturedDepth, CapturedFrame


class SlowCamera:
    """Ten frames a second."""

    def __init__(self) -> None:
        self._count = 0

    async def capture(self) -> CapturedFrame:
        self._count += 1
        return CapturedFrame(self._count * 100_000_000, 5_000_000, 640, 480, bytes(1000))

    async def close(self) -> None: ...


class ToldMotors:
    """Hands on what it is told."""

    def __init__(self, on_drive: Callable[[float, float, int], None]) -> None:
        self.drive = on_drive

    def stop(self) -> str:
        return ""

    def close(self) -> None: ...


async def test_one_side_turns_while_the_other_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    async def yes(_question: str) -> bool:
        return True

    monkeypatch.setattr(check, "_ask", yes)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    geometry, told = DriveGeometry(track_m=0.31), []
    await check.check_motors(ToldMotors(lambda v, w, _until_ns: told.append(geometry.duties(v, w))), geometry.track_m)
    assert all(left > 300 and right == 0 for left, right in told[:5])
    assert all(left == 0 and right > 300 for left, right in told[5:])


async def test_motors_without_a_terminal_are_named_as_not_tested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False)
    told: list[tuple[float, float]] = []
    sentence = await check.check_motors(ToldMotors(lambda v, w, _until_ns: told.append((v, w))), 0.25)
    assert "NOT TESTED" in sentence and told == []


async def test_a_slow_camera_fails() -> None:
    with pytest.raises(check.CheckFailed, match="instead of 30"):
        await check.check_camera(SlowCamera(), 30.0)
    assert "10.0 frames/s" in await check.check_camera(SlowCamera(), 10.0)


async def test_what_the_board_complains_of_fails() -> None:
    with pytest.raises(check.CheckFailed, match="hot"):
        await check.check_health(lambda: {"DRIVER_FAULT": "hot"})
    assert await check.check_health(dict)


class SteppingDepth:
    """A picture every so often."""

    def __init__(self, step_ns: int) -> None:
        self._step_ns = step_ns
        self._count = 0

    async def measure(self) -> CapturedDepth:
        self._count += 1
        return CapturedDepth(self._count * self._step_ns, bytes(2000))

    async def close(self) -> None: ...


async def test_a_depth_sensor_tells_its_rate_and_one_whose_clock_stands_still_fails() -> None:
    assert await check.check_depth(SteppingDepth(250_000_000)) == "4.0 depth pictures/s, 2.0 kB each"
    with pytest.raises(check.CheckFailed, match="times stand still"):
        await check.check_depth(SteppingDepth(0))
