"""The calibration that a robot tells, and what it shall tell instead."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeVar

import msgspec
from pydantic import Field, model_validator

from shared.calibration import (
    AccelerometerCalibration,
    Calibration,
    CameraCalibration,
    ImuNoise,
    has_borrowed_mounting,
)
from shared.calibration_yaml import calibration_text
from shared.errors import ConfigError
from station.api.schema.base import Model, Number, Question
from station.api.schema.robot import CalibrationFitModel, calibration_fit_model
from station.calibration.guidance import WITHOUT_BOARD, GuidedKind
from station.calibration.target import Target
from station.errors import Conflict, NoRobot, OutOfRange
from station.robots.guided_calibration import CalibrationSession
from station.robots.session import RobotSession
from station.workers.calibration_interface import RECORDING, BoardSeen, PaperSize, PrintedBoard

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


class TargetOrder(Question):
    """The board that is shown: one that was printed here, or another one with its numbers."""

    kind: Literal["aprilgrid", "charuco", "chessboard"] = "aprilgrid"
    size: PaperSize | None = Field(default=None, description="of the paper it was printed on; else give the numbers")
    ruler_mm: float = Field(default=100.0, ge=90.0, le=110.0, description="what the printed page's ruler measures")
    columns: int | None = Field(default=None, ge=2, le=50, description="tags, or inner corners")
    rows: int | None = Field(default=None, ge=2, le=50)
    square_m: float | None = Field(default=None, ge=1e-3, le=2.0, description="side of a tag or square, measured")
    gap_m: float = Field(default=0.0, ge=0.0, le=2.0, description="between the tags of an AprilGrid")
    marker_m: float = Field(default=0.0, ge=0.0, le=2.0, description="side of a ChArUco board's markers")

    @model_validator(mode="after")
    def _is_one_board(self) -> Self:
        numbers = (self.columns, self.rows, self.square_m)
        if (None in numbers) == (self.size is None):
            raise ValueError("give the size of the paper, or columns, rows and square_m of another board")
        return self


class SessionOrder(Question):
    kind: GuidedKind = "camera"
    target: TargetOrder | None = Field(
        default=None, description="none for kinds imu and check", examples=[{"kind": "aprilgrid", "size": "A4"}]
    )

    @model_validator(mode="after")
    def _has_a_board(self) -> Self:
        if (self.target is None) != (self.kind in WITHOUT_BOARD):
            raise ValueError("give the board that is shown, or none for kinds imu and check")
        return self


class MeterModel(Model):
    """One quantity, and how well the views so far tell it."""

    name: str
    value: float
    sigma: float = Field(description="one standard deviation")
    wanted: float = Field(description="the sigma that is good enough")
    unit: str


class BoardSeenModel(Model):
    """What one picture shows of the board, and what to do next."""

    t_robot_ns: int
    corners_px: list[list[float]]
    instruction: str = Field(examples=["tilt it: its left edge nearer; move it to the lower edge of the picture"])
    is_taken: bool = Field(description="this view counts")
    num_views: int = Field(description="that count")
    cells: list[float] = Field(
        description="how full each of the 3x3 cells of the picture is, 0..1, by rows; only for kind camera"
    )
    poses: dict[str, float] = Field(
        description="how many of the wanted views of each pose there are, 0..1; for camera-imu tilt, turn, roll, "
        "distance and time: how much of each wanted motion; for wheels forth, back, left, right; for imu time at rest; "
        "for check roll, tilt, turn, time"
    )
    meter: list[MeterModel]
    may_finish: bool = Field(description="there may be enough to estimate from")
    is_enough: bool


class RejectedImage(Model):
    image: str
    reason: str


class CameraResult(Model):
    """What the estimate came to."""

    model: Lens | None = Field(description="null, as the numbers: there was too little to estimate anything")
    resolution: list[int]
    intrinsics: list[float] | None
    distortion: list[float] | None
    rms_px: float | None
    sigma: dict[str, float]
    images_used: int
    images_rejected: list[RejectedImage]
    coverage: float
    line_delay_s: float | None
    accepted: bool
    reasons: list[str]


class MountingSigma(Model):
    rotation_deg: list[float] = Field(description="about the camera's axes")
    translation_m: list[float]
    time_shift_s: float
    line_delay_s: float
    gravity: list[float]


class MountingResult(Model):
    """What the estimate of camera and IMU came to; numbers are null where there was too little to estimate anything."""

    T_body_cam: Pose | None
    time_shift_s: float | None
    line_delay_s: float | None
    gravity: list[float] | None = Field(description="m/s² in the target's axes")
    sigma: MountingSigma | None
    rms_px: float | None
    rms_gyro: float | None = Field(description="rad/s")
    rms_accel: float | None = Field(description="m/s²")
    model: Lens
    resolution: list[int]
    intrinsics: list[float] | None = Field(description="of the lens, a little refined")
    distortion: list[float] | None
    accepted: bool
    reasons: list[str]
    notes: list[str] = Field(description="what was not used of the recording")


class CheckResult(MountingResult):
    """What a recording without a board says of the calibration; the numbers are those told, or repaired."""

    notes: list[str] = Field(description="of each quantity whether it fits, or why this motion does not show it")
    fits: bool | None = Field(description="null: this motion does not show all of it")
    repairs: list[str] = Field(
        description="the quantities that the robot should tell otherwise", examples=[["rotation"]]
    )


class FactorResult(Model):
    """Achieved over commanded, from several moves."""

    value: float
    sigma: float
    scatter: float = Field(description="of a single move, relative")
    moves: int


class WheelsResult(Model):
    """What the wheels make of a command, as the robot drove when it began."""

    speed: FactorResult | None
    turn: FactorResult | None
    lag_s: float | None = Field(description="of two equal lags one after the other, motor and gear")
    lag_sigma_s: float | None
    accepted: bool
    reasons: list[str]


class FigureResult(Model, extra="ignore"):
    """One figure of the three axes together."""

    value: float | None = Field(description="null: only an upper limit is known")
    interval: list[float] = Field(description="95 %")
    unit: str


class UsedNoise(Model):
    gyro_noise_density: float
    gyro_random_walk: float
    accel_noise_density: float
    accel_random_walk: float
    rate_hz: float
    accel_scale: list[float] | None
    accel_misalignment: list[float] | None


class AccelerometerResult(Model, extra="ignore"):
    """By the rests on several sides. Scale and misalignment are told; the bias drifts, and is estimated on the way."""

    scale: list[float]
    misalignment: list[float] | None = Field(description="rad; null: too few sides")
    bias: list[float] = Field(description="m/s²")


class ImuResult(Model, extra="ignore"):
    """What a recording at rest came to; in `result.json` is all of it, axis by axis."""

    gyro_noise_density: FigureResult | None
    gyro_random_walk: FigureResult | None
    accel_noise_density: FigureResult | None
    accel_random_walk: FigureResult | None
    used: UsedNoise | None = Field(description="what the estimation is told")
    accelerometer: AccelerometerResult | None = Field(description="null: it did not lie on enough sides")
    duration_s: float
    accepted: bool
    reasons: list[str]
    notes: list[str] = Field(description="what it cannot tell, or what was cut out of it")


class CalibrationSessionModel(Model):
    """A guided calibration, as far as it is."""

    id: str
    kind: GuidedKind
    state: Literal["looking", "estimating", "done", "failed"]
    message: str = Field(description="why it failed, in a sentence")
    resolution: list[int] = Field(description="of the robot's pictures: width, height")
    seen: BoardSeenModel | None = Field(description="the newest picture that was looked at")
    job: str = Field(description="that estimates; empty: not yet")
    result: CameraResult | None = Field(description="of kind camera")
    mounting: MountingResult | None = Field(description="the result of kind camera-imu")
    check: CheckResult | None = Field(description="the result of kind check")
    wheels: WheelsResult | None = Field(description="the result of kind wheels")
    imu: ImuResult | None = Field(description="the result of kind imu")
    is_used: bool = Field(description="the robot tells this result now")
    recording: str = Field(description="the path of what was recorded")


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


def session_model(session: CalibrationSession, robot: RobotSession) -> CalibrationSessionModel:
    seen, camera, hello = session.seen, session.told.camera, robot.state.hello
    return CalibrationSessionModel.of(
        session,
        resolution=[] if camera is None else [camera.width, camera.height],
        seen=None if seen is None else _seen_model(seen),
        result=_result(session, CameraResult, "camera"),
        mounting=_result(session, MountingResult, "camera-imu"),
        check=_result(session, CheckResult, "check"),
        wheels=_result(session, WheelsResult, "wheels"),
        imu=_result(session, ImuResult, "imu"),
        is_used=hello is not None and is_used(session, hello.calibration),
        recording=f"/calibration/sessions/{session.id}/{RECORDING}",
    )


Result = TypeVar("Result", bound=Model)


def _result(session: CalibrationSession, model: type[Result], kind: GuidedKind) -> Result | None:
    """What a session of this kind came to."""
    return None if session.result is None or session.kind != kind else model.model_validate(session.result)


def _seen_model(seen: BoardSeen) -> BoardSeenModel:
    return BoardSeenModel.of(
        seen,
        corners_px=[list(corner) for corner in seen.corners_px],
        cells=list(seen.cells),
        meter=[MeterModel.of(reading) for reading in seen.meter],
    )


def ordered_board(order: TargetOrder) -> Target | PrintedBoard:
    """Raises OutOfRange: no such board."""
    if order.size is not None:
        return PrintedBoard(order.kind, order.size, order.ruler_mm)
    try:
        assert order.columns is not None and order.rows is not None and order.square_m is not None
        return Target(order.kind, order.columns, order.rows, order.square_m, gap_m=order.gap_m, marker_m=order.marker_m)
    except ConfigError as exc:
        raise OutOfRange(str(exc)) from exc


def is_used(session: CalibrationSession, told: Calibration) -> bool:
    """Whether using it would change nothing, by the words of the robot's file."""
    if session.result is None or not session.result["accepted"]:
        return False
    try:
        return calibration_text(ordered_calibration(told, order_of_result(session))) == calibration_text(told)
    except (Conflict, OutOfRange):
        return False


def calibration_by_result(session: CalibrationSession, told: Calibration) -> Calibration:
    """The told calibration with a session's result. Raises Conflict, OutOfRange."""
    ordered = ordered_calibration(told, order_of_result(session))
    parts = [part for part in ("camera", "imu", "wheels") if getattr(ordered, part) != getattr(told, part)]
    if any(getattr(told, part) != getattr(session.told, part) for part in parts):
        raise Conflict("the robot was told other numbers since this was recorded; undo these, or calibrate again")
    return ordered


def order_of_result(session: CalibrationSession) -> CalibrationOrder:
    """Raises Conflict: there is no result that may be used."""
    if session.result is None:
        raise Conflict(f"this calibration has no result ({session.message or session.state})")
    if not session.result["accepted"]:
        raise Conflict(f"this result is not good enough: {'; '.join(session.result['reasons'])}")
    if (lens := _result(session, CameraResult, "camera")) is not None:
        return CalibrationOrder(camera=_lens_order(lens))
    check = _result(session, CheckResult, "check")
    if check is not None and not check.repairs:
        raise Conflict("this check found nothing to repair; the robot's numbers stay as they are")
    if (mounting := check or _result(session, MountingResult, "camera-imu")) is not None:
        placed = {"T_body_cam": mounting.T_body_cam, "time_shift_s": mounting.time_shift_s}
        return CalibrationOrder(camera=_lens_order(mounting).model_copy(update=placed))
    if (wheels := _result(session, WheelsResult, "wheels")) is not None and wheels.speed and wheels.turn:
        before = session.told.wheel_factors  # what the robot drove with
        turn = before.turn * wheels.turn.value
        return CalibrationOrder(wheels=WheelsOrder(speed=before.speed * wheels.speed.value, turn=turn))
    if (imu := _result(session, ImuResult, "imu")) is not None and imu.used is not None:
        return CalibrationOrder(imu=ImuOrder(**imu.used.model_dump(exclude={"rate_hz"})))
    raise Conflict("this result holds no number that the robot could tell")


def _lens_order(found: CameraResult | MountingResult) -> CameraOrder:
    return CameraOrder(
        model=found.model,
        resolution=found.resolution,
        intrinsics=found.intrinsics,
        distortion=found.distortion,
        line_delay_s=found.line_delay_s,
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
