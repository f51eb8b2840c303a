"""The robot: link, motors, camera head."""

from __future__ import annotations

import time
from typing import Literal, Self

from pydantic import Field, model_validator

from station.api.schema.base import Model, Number, Question
from station.model.calibration_fit import REMEDY, CalibrationFit
from station.robots.ahead import AheadWatch
from station.robots.session import RobotSession


class CapabilitiesModel(Model):
    camera: bool
    imu: bool
    drive: bool
    pan_tilt: bool
    battery: bool
    hijack: bool
    max_linear_m_s: float
    max_angular_rad_s: float


class RatesModel(Model):
    frames_hz: float
    imu_hz: float
    bytes_per_s: float


class LossesModel(Model):
    frames_skipped: int
    imu_gaps: int
    imu_lost: int
    imu_lost_in_sensor: int


class ClockModel(Model):
    offset_s: float | None = Field(description="t_station - t_robot")
    bound_ms: float | None = Field(description="by how much the offset may be wrong at most")
    drift_ppm: float | None
    rtt_ms: float | None


class NetworkModel(Model):
    """What a driver needs to know of the network between station and robot."""

    grade: Literal["none", "silent", "good", "slow", "bad"]
    sentence: str = Field(description="for a person")
    round_trip_ms: float | None = Field(description="of nine in ten heartbeats at most")
    picture_age_ms: float | None = Field(description="of nine in ten pictures at most, on arrival at the station")
    computer_busy: bool = Field(description="what is late is so by the station's computer, not by the network")


class BatteryModel(Model):
    voltage_v: float | None
    fraction: float | None


class AheadModel(Model):
    """How far the next thing ahead is, as the robot's depth sensor measures it. Nothing stops by it."""

    distance_m: float | None = Field(
        description="from the sensor; null: it measured nothing ahead, which is not to say that nothing is there",
        examples=[0.82],
    )
    age_s: float | None = Field(description="since it came to the station; null: nothing for 1.5 s")


class AppliedModel(Model):
    """What the motors were told."""

    linear: float
    angular: float


class CalibrationFitModel(Model):
    """What a drive says of the camera's calibration, with one standard deviation each."""

    verdict: Literal["fits", "does not fit", "not known yet"]
    sentence: str = Field(
        description="for a person",
        examples=[f"the calibration does not fit: the focal length seems 3.1% too long; {REMEDY}"],
    )
    focal_scale: float = Field(description="the focal length that the data want, over the told one")
    focal_sigma: float
    mounting_deg: list[float] = Field(description="the camera is turned by that about its axes right, down, forward")
    mounting_sigma_deg: list[float]
    time_shift_s: float = Field(description="to be added to the calibration's")
    time_shift_sigma_s: float


class RobotModel(Model):
    """Link, battery, rates, losses, clock, who drives."""

    connected: bool
    reason: str = Field(description="why not connected, in a sentence")
    host: str
    port: int
    robot_id: str | None
    name: str | None
    capabilities: CapabilitiesModel | None
    calibrated: bool
    calibration_fit: CalibrationFitModel | None = Field(
        description="of the last navigation since the robot connected that knows whether it fits, or of the last; "
        "null: none yet"
    )
    connections: int
    network: NetworkModel
    rates: RatesModel
    losses: LossesModel
    clock: ClockModel
    battery: BatteryModel | None
    temperatures_c: dict[str, float]
    cpu_percent: float | None = Field(description="of one core, robot-server")
    driver: str | None = Field(description="who drives through this station")
    robot_driver: str | None = Field(description="the station that drives, as the robot says")
    applied: AppliedModel | None
    ahead: AheadModel | None = Field(description="null: the robot has no depth sensor, or none is connected")
    head_must_rest: str = Field(description="why the camera head must look straight ahead; empty: it may turn")
    faults: list[str] = Field(description="what is wrong in the robot, or with the station's file of paired robots")


class DriveOrder(Question):
    """Hold this velocity, then stop."""

    linear: Number = Field(description="m/s, forward", examples=[0.2])
    angular: Number = Field(description="rad/s, left", examples=[0.0])
    ttl_ms: int = Field(default=250, ge=1, le=1000, description="stop after this, unless told again", examples=[250])


class PanTiltOrder(Question):
    pan: Number = Field(description="rad, left", examples=[0.3])
    tilt: Number = Field(description="rad, up", examples=[0.0])


class HijackOrder(Question):
    """Where to put it down; nothing at all: wherever the robot likes."""

    x: Number | None = Field(default=None, description="m, the simulated world's frame", examples=[1.0])
    y: Number | None = Field(default=None, examples=[2.0])
    yaw: Number = Field(default=0.0, description="rad", examples=[0.0])

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.x is None) != (self.y is None):
            raise ValueError("give both x and y, or neither for a spot of the robot's choice")
        return self

    @property
    def spot(self) -> tuple[float, float, float] | None:
        return None if self.x is None or self.y is None else (self.x, self.y, self.yaw)


class StopModel(Model):
    """It was sent."""

    ok: Literal[True] = True
    confirmed: bool = Field(description="the robot said that it has stopped; false: sent, not confirmed yet")


class DriverModel(Model):
    driver: str | None = Field(description="who drives through this station")
    you_drive: bool = Field(description="that is you, and the robot has not said that another station drives it")
    keeps_s: float = Field(description="so long the driver keeps the wheel without another word", examples=[6.0])


def calibration_fit_model(fit: CalibrationFit) -> CalibrationFitModel:
    return CalibrationFitModel.of(
        fit, mounting_deg=list(fit.mounting_deg), mounting_sigma_deg=list(fit.mounting_sigma_deg)
    )


def _ahead_model(watch: AheadWatch) -> AheadModel:
    newest = watch.newest
    if newest is None:
        return AheadModel(distance_m=None, age_s=None)
    distance_m = None if newest.distance_m is None else round(newest.distance_m, 3)
    return AheadModel(distance_m=distance_m, age_s=round((time.monotonic_ns() - newest.t_station_ns) * 1e-9, 2))


def robot_model(robot: RobotSession) -> RobotModel:
    state = robot.state
    hello, status = state.hello, state.status
    applied = robot.applied
    fit = robot.current_place.calibration_fit
    return RobotModel.of(
        state,
        robot_id=hello.robot_id if hello else None,
        name=hello.name if hello else None,
        capabilities=CapabilitiesModel.of(hello.capabilities) if hello else None,
        calibrated=hello is not None and hello.calibration.camera is not None,
        calibration_fit=None if fit is None else calibration_fit_model(fit),
        network=NetworkModel.of(state.network),
        rates=RatesModel(
            frames_hz=round(state.frame_rate_hz, 1),
            imu_hz=round(state.imu_rate_hz, 1),
            bytes_per_s=round(state.received_bytes_per_s),
        ),
        losses=LossesModel.of(state, imu_lost_in_sensor=status.imu_lost_in_sensor if status else 0),
        clock=ClockModel.of(
            state,
            offset_s=None if state.clock_offset_ns is None else state.clock_offset_ns * 1e-9,
            bound_ms=None if state.clock_bound_ns is None else state.clock_bound_ns * 1e-6,
            drift_ppm=state.clock_drift_ppm,
        ),
        battery=BatteryModel(voltage_v=status.battery_v, fraction=status.battery_fraction)
        if status and status.battery_v is not None
        else None,
        temperatures_c=dict(status.temperatures_c) if status else {},
        cpu_percent=status.cpu_percent if status else None,
        driver=robot.driving.driver,
        robot_driver=status.driver if status else None,
        applied=AppliedModel.of(applied) if applied and state.connected else None,
        ahead=_ahead_model(robot.ahead) if robot.ahead.has_sensor else None,
        head_must_rest=robot.head_must_rest,
        faults=list(robot.faults),
    )
