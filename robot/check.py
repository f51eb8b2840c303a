"""`robot-server --check`: tests each part in turn and says in a sentence what is wrong."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import Awaitable, Callable
from itertools import pairwise

from robot.config import PiConfig
from robot.devices.ports import Battery, Camera, DeviceSet, Imu, ImuReading
from shared.errors import HardwareError, RobotSystemError

FRAMES, READINGS = 30, 450
GRAVITY_M_S2 = (9.3, 10.3)  # a resting accelerometer, its bias included


class CheckFailed(Exception):
    """A part answers, but not as it should."""


def say(part: str, works: bool, sentence: str) -> None:
    """One line per part."""
    print(f"{'ok  ' if works else 'FAIL'}  {part}: {sentence}", flush=True)


async def check_camera(camera: Camera) -> str:
    """Rate and picture."""
    frames = [await asyncio.wait_for(camera.capture(), 10.0) for _ in range(FRAMES)]
    span_s = (frames[-1].t_robot_ns - frames[0].t_robot_ns) * 1e-9
    if span_s <= 0:
        raise CheckFailed("the frames' times stand still; check the clock of the camera stack")
    size_kb = sum(len(f.jpeg) for f in frames) / len(frames) / 1000
    exposure_ms = frames[-1].exposure_ns * 1e-6
    return (
        f"{(FRAMES - 1) / span_s:.1f} frames/s of {frames[-1].width}x{frames[-1].height}, {size_kb:.0f} kB each,"
        f" exposure {exposure_ms:.1f} ms"
    )


async def check_imu(imu: Imu) -> str:
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
    if turning > 0.3:
        raise CheckFailed(f"it turns at {turning:.1f} rad/s; put the robot at rest and check again")
    if not GRAVITY_M_S2[0] <= force <= GRAVITY_M_S2[1]:
        raise CheckFailed(f"at rest it feels {force:.2f} m/s^2 instead of 9.8; check pi.accel_range_g")
    up = "xyz"[max(range(3), key=lambda i: abs(accel[i]))]
    return f"{rate_hz:.1f} samples/s, none lost, longest step {gap_ms:.1f} ms, gravity {force:.2f} m/s^2 along {up}"


async def check_battery(battery: Battery) -> str:
    """Voltage."""
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


async def run_check(part: str, check: Callable[[], Awaitable[str]]) -> bool:
    """One part; its failure is a sentence."""
    try:
        sentence = await check()
    except (CheckFailed, RobotSystemError) as exc:
        say(part, False, str(exc))
        return False
    except TimeoutError:
        say(part, False, "no answer within 10 s")
        return False
    say(part, True, sentence)
    return True


async def check_devices(devices: DeviceSet) -> bool:
    """Every part of an open robot; closes it."""
    works = True
    try:
        if devices.camera is not None:
            camera = devices.camera
            works &= await run_check("camera", lambda: check_camera(camera))
        if devices.imu is not None:
            imu = devices.imu
            works &= await run_check("imu", lambda: check_imu(imu))
        if devices.battery is not None:
            battery = devices.battery
            works &= await run_check("battery", lambda: check_battery(battery))
        if devices.motors is not None and sys.stdin.isatty():
            motors = devices.motors
            works &= await run_check("motors", lambda: check_motors(motors.drive, motors.stop))
    finally:
        if devices.motors is not None:
            devices.motors.close()
        for part in (devices.camera, devices.imu):
            if part is not None:
                await part.close()
    return works


async def check_motors(drive: Callable[[float, float], None], stop: Callable[[], None]) -> str:
    """Each side forward for half a second, only after somebody at the keyboard says that the wheels hang free."""
    answer = await asyncio.to_thread(input, "      Do the wheels hang free? Then type yes: ")
    if answer.strip().lower() != "yes":
        return "not turned"
    for side, angular in (("left", -1.0), ("right", 1.0)):
        print(f"      the {side} wheels turn forward now", flush=True)
        for _ in range(5):
            drive(0.12, angular)
            await asyncio.sleep(0.1)
        stop()
        await asyncio.sleep(0.5)
    answer = await asyncio.to_thread(input, "      Did left, then right turn forward? Type yes or no: ")
    if answer.strip().lower() != "yes":
        raise CheckFailed("swap a side's two motor wires, or set pi.invert_left, pi.invert_right")
    return "both sides obey"


def check_pi(config: PiConfig) -> bool:
    """The real robot's parts, each opened by itself, so that one that is missing hides no other."""
    from robot.devices.pi import adapter

    async def parts() -> bool:
        works = True
        if config.camera:
            works &= await run_check("camera", lambda: _camera_alone(config))
        if adapter.uses_mega(config) or "gpio" in (config.motors, config.pan_tilt) or config.battery != "none":
            import msgspec

            works &= await run_check("board", lambda: _set_alone(msgspec.structs.replace(config, camera=False)))
        return works

    return asyncio.run(parts())


async def _camera_alone(config: PiConfig) -> str:
    from robot.devices.pi import adapter

    camera = adapter.open_camera(config)
    try:
        return await check_camera(camera)
    finally:
        await camera.close()


async def _set_alone(config: PiConfig) -> str:
    from robot.devices.pi import adapter

    devices = adapter.open_pi(config)
    if not await check_devices(devices):
        raise CheckFailed("see above")
    return "Mega and what hangs on it answer"
