"""The calibration that a robot tells, and what it shall tell instead."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import msgspec
from pydantic import Field, model_validator

from shared.calibration import (
    AccelerometerCalibration,
    Calibration,
    CameraCalibration,
    ImuNoise,
    has_borrowed_mounting,
)
from shared.errors import ConfigError
from station.api.schema.base import Model, Number, Question
from station.api.schema.robot import CalibrationFitModel, calibration_fit_model
from station.errors import NoRobot, OutOfRange
from station.robots.session import RobotSession

Four = Annotated[list[Number], Field(min_length=4, max_length=4)]


Pose = Annotated[list[Four], Field(min_length=4, max_length=4)]


Density = Annotated[float, Field(gt=0, allow_inf_nan=False)]


Lens = Literal["radtan", "equidistant"]


class CameraModel(Model):
    """The centre of the first pixel is (0, 0)."""

    model: Lens
    resolution: list[int] = Field(description="width, height", examples=[[640, 480]])
    intrinsics: list[float] = Field(description="fx, fy, cx, cy in px")
    distortion: list[float] = Field(description="radtan: k1 k2 p1 p2; equidistant: k1 k2 k3 k4")
    T_body_cam: list[list[float]] = Field(description="4x4, camera to body (= IMU) coordinates, m")
    time_shift_s: float = Field(description="t_imu = t_cam + time_shift_s")
    line_delay_s: float = Field(description="row v is exposed line_delay_s * v after row 0; 0: all at once")
    is_measured: bool = Field(description="false: another robot's numbers, for want of its own")
    is_mounting_measured: bool = Field(
        description="false: where it sits and when it sees are the reference robot's, for want of its own"
    )


class ImuModel(Model):
    """Continuous-time noise, in SI units as kalibr has it."""

    gyro_noise_density: float
    gyro_random_walk: float
    accel_noise_density: float
    accel_random_walk: float
    rate_hz: float
    accel_scale: list[float] | None = Field(
        description="force = T (scale * reading), along x, y, z; null: not measured"
    )
    accel_misalignment: list[float] | None = Field(description="rad, of T: y to x, z to x, z to y")


class WheelsModel(Model):
    """What the motors make of a command by themselves; the robot asks them for that much more."""

    speed: float = Field(description="m/s over ground for each commanded one")
    turn: float = Field(description="rad/s likewise")


class CalibrationModel(Model):
    """What the robot tells of its sensors now, where that comes from, and whether it fits what was driven."""

    camera: CameraModel | None
    imu: ImuModel | None
    wheels: WheelsModel = Field(description="1 and 1: not measured")
    rig: Literal["wheels", "hand-held", "unknown"]
    source: str = Field(description="where the robot has it from", examples=["its calibration.yaml"])
    can_undo: bool = Field(description="the one before it is kept: POST /calibration/undo")
    fixed: str = Field(description="why the robot takes no other one, in a sentence; empty: it does")
    fit: CalibrationFitModel | None = Field(description="of the last navigation with this calibration; null: none yet")


class CameraOrder(Question):
    """What is left out stays as the robot tells it now."""

    model: Lens | None = None
    resolution: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None
    intrinsics: Four | None = Field(default=None, description="fx, fy, cx, cy in px")
    distortion: Four | None = None
    T_body_cam: Pose | None = None
    time_shift_s: Number | None = None
    line_delay_s: Number | None = None


class ImuOrder(Question):
    """What is left out stays as the robot tells it now."""

    gyro_noise_density: Density | None = None
    gyro_random_walk: Density | None = None
    accel_noise_density: Density | None = None
    accel_random_walk: Density | None = None
    accel_scale: Annotated[list[Number], Field(min_length=3, max_length=3)] | None = None
    accel_misalignment: Annotated[list[Number], Field(min_length=3, max_length=3)] | None = None

    @model_validator(mode="after")
    def _has_a_scale(self) -> Self:
        if self.accel_misalignment is not None and self.accel_scale is None:
            raise ValueError("give accel_scale as well: a misalignment belongs to the scale it was measured with")
        return self


class WheelsOrder(Question):
    """What is left out stays as the robot tells it now; 1 where it tells nothing."""

    speed: Number | None = None
    turn: Number | None = None


class CalibrationOrder(Question):
    """In the fields and units that a calibration's result has."""

    camera: CameraOrder | None = None
    imu: ImuOrder | None = None
    wheels: WheelsOrder | None = None
    session: str | None = Field(default=None, max_length=100, description="the result of this guided calibration")

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        parts = [part for part in (self.camera, self.imu, self.wheels) if part is not None]
        has_numbers = any(value is not None for part in parts for _, value in part)
        if has_numbers == (self.session is not None):
            raise ValueError("give at least one number of camera, IMU or wheels, or else a session")
        return self


def calibration_model(robot: RobotSession) -> CalibrationModel:
    """Raises NoRobot: none was ever connected."""
    hello = robot.state.hello
    if hello is None:
        raise NoRobot("no robot is connected; there is no calibration to show")
    told, origin, fit = hello.calibration, hello.calibration_origin, robot.current_place.calibration_fit
    return CalibrationModel(
        camera=None if told.camera is None else _camera_model(told.camera),
        imu=None if told.imu is None else _imu_model(told.imu),
        wheels=WheelsModel.of(told.wheel_factors),
        rig=told.rig,
        source="its own settings" if origin is None else origin.source,
        can_undo=origin is not None and origin.can_undo,
        fixed=robot.why_calibration_fixed,
        fit=None if fit is None else calibration_fit_model(fit),
    )


def _camera_model(camera: CameraCalibration) -> CameraModel:
    return CameraModel.of(
        camera,
        resolution=[camera.width, camera.height],
        intrinsics=[camera.fx, camera.fy, camera.cx, camera.cy],
        distortion=list(camera.distortion),
        T_body_cam=camera.T_body_cam_matrix.tolist(),
        is_mounting_measured=not has_borrowed_mounting(camera),
    )


def _imu_model(imu: ImuNoise) -> ImuModel:
    return ImuModel(
        gyro_noise_density=imu.gyro_density,
        gyro_random_walk=imu.gyro_walk,
        accel_noise_density=imu.accel_density,
        accel_random_walk=imu.accel_walk,
        rate_hz=imu.rate_hz,
        **_accelerometer_fields(imu.accelerometer),
    )


def _accelerometer_fields(known: AccelerometerCalibration | msgspec.UnsetType) -> dict[str, list[float] | None]:
    if not isinstance(known, AccelerometerCalibration):
        return {"accel_scale": None, "accel_misalignment": None}
    return {"accel_scale": list(known.scale), "accel_misalignment": list(known.misalignment)}


def ordered_calibration(told: Calibration, order: CalibrationOrder) -> Calibration:
    """The told calibration with what was ordered. Raises OutOfRange."""
    camera, imu, wheels = told.camera, told.imu, told.wheels
    if (order.camera is not None and camera is None) or (order.imu is not None and imu is None):
        raise OutOfRange("the robot has no such sensor; GET /calibration shows those it has")
    try:
        if order.camera is not None and camera is not None:
            if order.camera.model not in (None, camera.model) and order.camera.distortion is None:
                raise OutOfRange(f"give the distortion too: that of a {camera.model} lens means another thing")
            camera = msgspec.structs.replace(camera, **_camera_changes(order.camera))
        if order.imu is not None and imu is not None:
            imu = msgspec.structs.replace(imu, **_imu_changes(order.imu))
        if order.wheels is not None:
            given = order.wheels.model_dump(exclude_none=True)
            wheels = msgspec.structs.replace(told.wheel_factors, **given)
    except ConfigError as exc:
        raise OutOfRange(str(exc)) from exc
    return msgspec.structs.replace(told, camera=camera, imu=imu, wheels=wheels)


def _camera_changes(order: CameraOrder) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    if order.resolution is not None:
        changes |= zip(("width", "height"), order.resolution, strict=True)
    if order.intrinsics is not None:
        changes |= zip(("fx", "fy", "cx", "cy"), order.intrinsics, strict=True)
        changes["is_measured"] = True
    if order.distortion is not None:
        changes["distortion"] = tuple(order.distortion)
    if order.T_body_cam is not None:
        changes["T_body_cam"] = tuple(value for row in order.T_body_cam for value in row)
    given = {name: getattr(order, name) for name in ("model", "time_shift_s", "line_delay_s")}
    return changes | {name: value for name, value in given.items() if value is not None}


def _imu_changes(order: ImuOrder) -> dict[str, Any]:
    given: dict[str, Any] = {
        "gyro_density": order.gyro_noise_density,
        "gyro_walk": order.gyro_random_walk,
        "accel_density": order.accel_noise_density,
        "accel_walk": order.accel_random_walk,
    }
    if order.accel_scale is not None:
        scale, angles = order.accel_scale, order.accel_misalignment or [0.0, 0.0, 0.0]
        given["accelerometer"] = AccelerometerCalibration(
            scale=(scale[0], scale[1], scale[2]), misalignment=(angles[0], angles[1], angles[2])
        )
    return {name: value for name, value in given.items() if value is not None}
