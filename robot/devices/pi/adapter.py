"""Opens the real robot's parts as the configuration names them. Each is imported only when it is used."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from robot.config import PiConfig
from robot.devices.pi.hc_sr04 import PERIOD, HcSr04, calibration_of
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaBattery, MegaImu, MegaMotors, MegaPanTilt
from robot.devices.pi.serial_line import PySerialLine
from robot.devices.ports import Battery, Camera, DeviceSet, Motors, PanTilt
from shared.calibration import REFERENCE_ROBOT, Calibration, CameraCalibration, ImuNoise
from shared.errors import ConfigError
from shared.serial_protocol import ACCEL_RANGES_G, GYRO_RANGES_DEG_S, ConfigImu, ConfigMotors

if TYPE_CHECKING:
    from robot.devices.pi.oak_d import OakD


def open_pi(config: PiConfig, own: Calibration | None = None) -> DeviceSet:
    """Open the real robot. `own`: the calibration that it keeps; None: none yet.

    Raises:
        DeviceUnavailable: a part that the configuration names does not answer; says which and what to do.
    """
    check(config)
    with contextlib.ExitStack() as undo:
        calibration = load_calibration(config, own)
        depth = _open_oak_d(config, undo) if config.depth == "oak-d" else None
        if depth is not None:
            calibration = msgspec.structs.replace(calibration, depth=depth.calibration)
        mega = _open_mega(config) if uses_mega(config) else None
        if mega is not None:
            undo.callback(mega.close)
        motors, pan_tilt = _open_motion(config, mega, undo)
        devices = DeviceSet(
            calibration=calibration,
            camera=open_camera(config) if config.camera else None,
            imu=MegaImu(mega) if mega is not None and config.imu else None,
            motors=motors,
            depth=HcSr04(mega) if mega is not None and config.depth == "hc-sr04" else depth,
            pan_tilt=pan_tilt,
            battery=_open_battery(config, mega),
            problems=dict if mega is None else mega.problems,
        )
        undo.pop_all()  # all parts are there: they stay open
    return devices


def check(config: PiConfig) -> None:
    """Raises ConfigError where settings contradict each other."""
    if config.battery_empty_v >= config.battery_full_v:
        raise ConfigError(
            f"pi.battery_empty_v {config.battery_empty_v} must be below pi.battery_full_v {config.battery_full_v}"
        )
    if len(set(config.gpio_pins)) != len(config.gpio_pins):
        raise ConfigError(f"pi.gpio_pins {config.gpio_pins} names a pin twice")


def uses_mega(config: PiConfig) -> bool:
    """Whether any part is wired to the Mega."""
    return config.imu or config.depth == "hc-sr04" or "mega" in (config.motors, config.pan_tilt, config.battery)


def _open_mega(config: PiConfig) -> Mega:
    range_sensor = PERIOD if config.depth == "hc-sr04" else None
    return Mega(lambda: PySerialLine(config.serial_port), *mega_settings(config), range_sensor=range_sensor)


def mega_settings(config: PiConfig) -> tuple[ConfigImu, ConfigMotors]:
    """What the firmware is told at its start."""
    imu = ConfigImu(
        gyro_scale=GYRO_RANGES_DEG_S.index(config.gyro_range_deg_s),
        accel_scale=ACCEL_RANGES_G.index(config.accel_range_g),
    )
    motors = ConfigMotors(
        slow_decay=config.slow_decay,
        ramp_up=max(1, round(1000 / config.ramp_ms)),
        ramp_down=10,  # 100 ms from full to rest: faster than any ramp up, slower than tipping over
        cutoff_mv=round(1000 * config.battery_empty_v) if config.battery == "mega" else 0,
    )
    return imu, motors


def load_calibration(config: PiConfig, own: Calibration | None = None) -> Calibration:
    """The robot's own calibration, else its camera.yaml and imu.yaml; what these lack is the reference robot's.

    Raises:
        ConfigError: it is of pictures of another size.
    """
    calibration = own or msgspec.structs.replace(REFERENCE_ROBOT, camera=_camera_of(config), imu=_imu_of(config))
    depth = calibration_of(config.depth_position_m) if config.depth == "hc-sr04" else msgspec.UNSET
    calibration = msgspec.structs.replace(calibration, head=REFERENCE_ROBOT.head, depth=depth)  # nobody measures these
    camera = calibration.camera
    if config.camera and camera is not None:
        size = (camera.width, camera.height)
        if size != (config.width, config.height):
            raise ConfigError(
                f"pi.width, pi.height {config.width}x{config.height} differ from the calibration's {size[0]}x{size[1]};"
                " calibrate at that size or set the calibrated one"
            )
    return calibration


def _camera_of(config: PiConfig) -> CameraCalibration:
    """As its camera.yaml says, else as the reference robot's."""
    folder = Path(config.calibration)
    # Who measured only the IMU has no camera.yaml; who has neither is told that it is missing.
    if config.calibration and ((folder / "camera.yaml").is_file() or not (folder / "imu.yaml").is_file()):
        return _read_own_camera(folder / "camera.yaml")
    assert REFERENCE_ROBOT.camera is not None
    return msgspec.structs.replace(REFERENCE_ROBOT.camera, is_measured=False)


def _imu_of(config: PiConfig) -> ImuNoise:
    """As its imu.yaml says, else the reference robot's. Readings end where the reference robot's do, at the latest."""
    from shared.calibration_yaml import read_imu

    path, reference = Path(config.calibration) / "imu.yaml", REFERENCE_ROBOT.imu
    assert reference is not None
    if not config.calibration or not path.is_file():
        return reference
    own = read_imu(path)
    return msgspec.structs.replace(
        own,
        gyro_range=min(own.gyro_range, reference.gyro_range),
        accel_range=min(own.accel_range, reference.accel_range),
    )


def _read_own_camera(path: Path) -> CameraCalibration:
    """The file's camera. How it is mounted and timed is the reference robot's where the file does not say."""
    from shared.sensor_yaml import read_camera, read_yaml

    content = read_yaml(path)
    camera, reference = read_camera(path, content), REFERENCE_ROBOT.camera
    assert reference is not None
    missing = [key for key in ("time_shift_s", "line_delay_s") if content.get(key) is None]
    if content.get("T_BS") is None and content.get("T_body_cam") is None:
        missing.append("T_body_cam")
    return msgspec.structs.replace(camera, **{key: getattr(reference, key) for key in missing})


def _open_motion(
    config: PiConfig, mega: Mega | None, undo: contextlib.ExitStack
) -> tuple[Motors | None, PanTilt | None]:
    geometry = DriveGeometry(
        config.full_speed_m_s, config.track_m, config.deadband, config.invert_left, config.invert_right
    )
    motors: Motors | None = None
    pan_tilt: PanTilt | None = None
    if mega is not None:
        motors = MegaMotors(mega, geometry) if config.motors == "mega" else None
        pan_tilt = MegaPanTilt(mega) if config.pan_tilt == "mega" else None
    if "gpio" in (config.motors, config.pan_tilt):
        from robot.devices.pi.gpio_parts import GpioMotors, GpioPanTilt, GpioProcess

        process = GpioProcess(config.gpio_pins)
        undo.callback(process.close)
        motors = GpioMotors(process, geometry) if config.motors == "gpio" else motors
        pan_tilt = GpioPanTilt(process) if config.pan_tilt == "gpio" else pan_tilt
    return motors, pan_tilt


def open_camera(config: PiConfig) -> Camera:
    from robot.devices.pi.camera import PiCamera

    return PiCamera(config)


def _open_oak_d(config: PiConfig, undo: contextlib.ExitStack) -> OakD:
    from robot.devices.pi.oak_d import OakD

    oak = OakD(config.depth_position_m, math.radians(config.depth_pitch_deg))
    undo.callback(oak.end)
    return oak


def _open_battery(config: PiConfig, mega: Mega | None) -> Battery | None:
    if config.battery == "mega" and mega is not None:
        return MegaBattery(mega, config.battery_empty_v, config.battery_full_v)
    if config.battery == "ina219":
        from robot.devices.pi.ina219 import Ina219Battery

        return Ina219Battery(config.ina219_bus, config.ina219_address, config.battery_empty_v, config.battery_full_v)
    return None
