"""A guided calibration: what it is asked, how far it is, what it came to."""

from __future__ import annotations

from typing import Literal, Self, TypeVar

from pydantic import Field, model_validator

from shared.calibration import (
    Calibration,
)
from shared.calibration_yaml import calibration_text
from shared.errors import ConfigError
from station.api.schema.base import Model, Question
from station.api.schema.calibration import (
    CalibrationOrder,
    CameraOrder,
    ImuOrder,
    Lens,
    Pose,
    WheelsOrder,
    ordered_calibration,
)
from station.calibration.guidance import WITHOUT_BOARD, GuidedKind
from station.calibration.target import Target
from station.errors import Conflict, OutOfRange
from station.robots.guided_calibration import CalibrationSession
from station.robots.session import RobotSession
from station.workers.calibration_interface import RECORDING, BoardSeen, PaperSize, PrintedBoard


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
