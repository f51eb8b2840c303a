"""`robot-server --check`: tests each part in turn and says in a sentence what is wrong."""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import Awaitable, Callable
from itertools import pairwise
from typing import TypeVar

import msgspec

from robot.config import PiConfig
from robot.devices.ports import Battery, Camera, DepthSensor, DeviceSet, Imu, ImuReading, Motors, PanTilt
from shared.errors import HardwareError, RobotSystemError

FRAMES, READINGS, DEPTH_PICTURES = 30, 450, 5
LEAST_RATE = 0.9  # of the rate a part should have
CHECK_TTL_NS = 300_000_000  # of a motor command that is repeated every 100 ms
GRAVITY_M_S2 = (9.3, 10.3)  # a resting accelerometer, its bias included


Part = TypeVar("Part")


class CheckFailed(Exception):
    """A part answers, but not as it should."""


async def check_camera(camera: Camera, expected_hz: float | None = None) -> str:
    frames = [await asyncio.wait_for(camera.capture(), 10.0) for _ in range(FRAMES)]
    span_s = (frames[-1].t_robot_ns - frames[0].t_robot_ns) * 1e-9
    if span_s <= 0:
        raise CheckFailed("the frames' times stand still; check the clock of the camera stack")
    rate_hz = (FRAMES - 1) / span_s
    if expected_hz is not None and rate_hz < LEAST_RATE * expected_hz:
        raise CheckFailed(
            f"{rate_hz:.1f} frames/s instead of {expected_hz:.0f}; end other programs, or lower pi.rate_hz"
        )
    size_kb = sum(len(f.jpeg) for f in frames) / len(frames) / 1000
    exposure_ms = frames[-1].exposure_ns * 1e-6
    return (
        f"{rate_hz:.1f} frames/s of {frames[-1].width}x{frames[-1].height}, {size_kb:.0f} kB each,"
        f" exposure {exposure_ms:.1f} ms"
    )


async def check_depth(depth: DepthSensor) -> str:
    pictures = [await asyncio.wait_for(depth.measure(), 10.0) for _ in range(DEPTH_PICTURES)]
    span_s = (pictures[-1].t_robot_ns - pictures[0].t_robot_ns) * 1e-9
    if span_s <= 0:
        raise CheckFailed("the depth pictures' times stand still; check the sensor's clock")
    size_kb = sum(len(p.png) for p in pictures) / len(pictures) / 1000
    return f"{(DEPTH_PICTURES - 1) / span_s:.1f} depth pictures/s, {size_kb:.1f} kB each"


async def check_imu(imu: Imu, expected_hz: float | None = None) -> str:
    """Rate, losses, and whether a resting robot feels gravity and no rotation."""
    readings: list[ImuReading] = []
    while len(readings) < READINGS:
        readings += await asyncio.wait_for(imu.read(), 10.0)
    lost = readings[-1].sequence - readings[0].sequence + 1 - len(readings)
    rate_hz = (len(readings) - 1) / ((readings[-1].t_robot_ns - readings[0].t_robot_ns) * 1e-9)
    accel = [sum(r.accel_imu[i] for r in readings) / len(readings) for i in range(3)]
    turning = max(math.hypot(*r.gyro_imu) for r in readings)
    force = math.hypot(*accel)
    gap_ms = max(b.t_robot_ns - a.t_robot_ns for a, b in pairwise(readings)) * 1e-6
    if lost > 0:
        raise CheckFailed(f"{lost} of {len(readings)} samples were lost; check the wires to INT, SDA and SCL")
    if expected_hz is not None and rate_hz < LEAST_RATE * expected_hz:
        raise CheckFailed(
            f"{rate_hz:.1f} samples/s instead of {expected_hz:.0f}; check the wire from INT to Mega pin 2"
        )
    if turning > 0.3:
        raise CheckFailed(f"it turns at {turning:.1f} rad/s; put the robot at rest and check again")
    if not GRAVITY_M_S2[0] <= force <= GRAVITY_M_S2[1]:
        raise CheckFailed(f"at rest it feels {force:.2f} m/s^2 instead of 9.8; check pi.accel_range_g")
    up = "xyz"[max(range(3), key=lambda i: abs(accel[i]))]
    return f"{rate_hz:.1f} samples/s, none lost, longest step {gap_ms:.1f} ms, gravity {force:.2f} m/s^2 along {up}"


async def check_battery(battery: Battery) -> str:
    for _ in range(20):  # the first report may still be on its way
        try:
            state = battery.read()
            break
        except HardwareError:
            await asyncio.sleep(0.1)
    else:
        state = battery.read()
    if state.fraction <= 0.0:
        raise CheckFailed(f"{state.voltage_v:.2f} V is empty; charge it")
    return f"{state.voltage_v:.2f} V, {100 * state.fraction:.0f} %"


async def run_check(name: str, part: Part | None, check: Callable[[Part], Awaitable[str]]) -> bool:
    """One part, where the robot has it; prints one line. Its failure is a sentence."""
    if part is None:
        return True
    works = False
    try:
        sentence = await check(part)
        works = True
    except (CheckFailed, RobotSystemError) as exc:
        sentence = str(exc)
    except TimeoutError:
        sentence = "no answer within 10 s"
    print(f"{'ok  ' if works else 'FAIL'}  {name}: {sentence}", flush=True)
    return works


async def check_health(problems: Callable[[], dict[str, str]]) -> str:
    """Driver fault, I2C, magnetometer, damaged frames: what the board itself complains of."""
    if found := problems():
        raise CheckFailed("; ".join(found.values()))
    return "the board complains of nothing"


async def check_devices(devices: DeviceSet, track_m: float = PiConfig().track_m) -> bool:
    """Every part of an open robot; closes it. `track_m` is the distance between its left and right wheels."""
    works, noise = True, devices.calibration.imu
    try:
        works &= await run_check("camera", devices.camera, check_camera)
        works &= await run_check("depth", devices.depth, check_depth)
        works &= await run_check("imu", devices.imu, lambda imu: check_imu(imu, noise.rate_hz if noise else None))
        works &= await run_check("battery", devices.battery, check_battery)
        works &= await run_check("motors", devices.motors, lambda motors: check_motors(motors, track_m))
        works &= await run_check("pan-tilt", devices.pan_tilt, check_pan_tilt)
        # Last: what went wrong while all the others were tested.
        works &= await run_check("health", devices.problems, check_health)
    finally:
        await devices.close()
    return works


async def _ask(question: str) -> bool:
    answer = await asyncio.to_thread(input, f"      {question} Type yes or no: ")
    return answer.strip().lower() == "yes"


async def check_motors(motors: Motors, track_m: float) -> str:
    """Each side forward for half a second, only after somebody at the keyboard says that the wheels hang free."""
    if not sys.stdin.isatty():
        return "NOT TESTED: run the check at a terminal, somebody must watch the wheels"
    if not await _ask("Do the wheels hang free?"):
        return "NOT TESTED: the wheels do not hang free"
    for side, angular in (("left", -1.0), ("right", 1.0)):
        print(f"      the {side} wheels alone turn forward now", flush=True)
        try:
            for _ in range(5):
                # The other side rests exactly: its part of the turn is taken back by going forward.
                motors.drive(abs(angular) * track_m / 2, angular, time.monotonic_ns() + CHECK_TTL_NS)
                await asyncio.sleep(0.1)
        finally:
            motors.stop()
        await asyncio.sleep(0.5)
    if not await _ask("Did first only the left, then only the right wheels turn forward?"):
        raise CheckFailed("swap a side's two motor wires, or set pi.invert_left, pi.invert_right")
    return "both sides obey"


async def check_pan_tilt(pan_tilt: PanTilt) -> str:
    """Left, right, up, down, ahead; somebody must watch."""
    if not sys.stdin.isatty():
        return "NOT TESTED: run the check at a terminal, somebody must watch the camera head"
    for pan, tilt in ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.4), (0.0, -0.4), (0.0, 0.0)):
        pan_tilt.point(pan, tilt)
        await asyncio.sleep(0.7)
    if not await _ask("Did the camera look left, right, up, down and ahead?"):
        raise CheckFailed("check the servos' power and signal wires")
    return "it looks where it is told"


def check_pi(config: PiConfig) -> bool:
    """The real robot's parts, each opened by itself, so that one that is missing hides no other."""
    from robot.devices.pi import adapter

    async def parts() -> bool:
        works = True
        if config.camera:
            works &= await run_check("camera", config, _camera_alone)
        if adapter.uses_mega(config) or "gpio" in (config.motors, config.pan_tilt) or config.battery != "none":
            works &= await run_check("board", msgspec.structs.replace(config, camera=False), _set_alone)
        return works

    return asyncio.run(parts())


async def _camera_alone(config: PiConfig) -> str:
    from robot.devices.pi import adapter

    camera = adapter.open_camera(config)
    try:
        return await check_camera(camera, config.rate_hz)
    finally:
        await camera.close()


async def _set_alone(config: PiConfig) -> str:
    from robot.devices.pi import adapter

    devices = adapter.open_pi(config)
    if not await check_devices(devices, config.track_m):
        raise CheckFailed("see above")
    return "all of it answers"
