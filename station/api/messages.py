"""Messages of the WebSockets (docs/api.md). The page's TypeScript types are generated from these classes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from station.api.schema.base import Model, Number, Question
from station.api.schema.calibration_session import CalibrationSessionModel
from station.api.schema.jobs import JobModel
from station.api.schema.navigations import NavigationModel
from station.api.schema.places import CurrentPlace, VisitModel
from station.api.schema.robot import RobotModel
from station.api.schema.slam import SlamModel
from station.api.schema.station import LogModel


class RobotMessage(Model):
    type: Literal["robot"] = "robot"
    robot: RobotModel


class DriverMessage(Model):
    type: Literal["driver"] = "driver"
    driver: str | None


class PoseMessage(Model):
    type: Literal["pose"] = "pose"
    slam: SlamModel


class LandmarksMessage(Model):
    """There are new landmarks: fetch GET /landmarks?since=."""

    type: Literal["landmarks"] = "landmarks"
    navigation: str | None
    source: str | None = Field(description="the cloud: X-Source of GET /landmarks")
    total: int


class NavigationMessage(Model):
    """A navigation changed; null: one was deleted."""

    type: Literal["navigation"] = "navigation"
    navigation: NavigationModel | None


class MapMessage(Model):
    """The list of maps, the active one or a name in it changed."""

    type: Literal["map"] = "map"
    active: str | None
    revision: int = Field(description="another one: the active map is another, or its places or rooms are")
    has_plan: bool = Field(description="GET /floorplan has something to show")


class JobMessage(Model):
    type: Literal["job"] = "job"
    job: JobModel


class PlaceMessage(Model):
    type: Literal["place"] = "place"
    place: CurrentPlace
    visit: VisitModel | None


class BinMessage(Model):
    """Something was deleted or restored: fetch GET /bin."""

    type: Literal["bin"] = "bin"


class CalibrationMessage(Model):
    """The guided calibration, a few times a second while a board is looked at; null: there is none."""

    type: Literal["calibration"] = "calibration"
    session: CalibrationSessionModel | None


class LogMessage(Model):
    type: Literal["log"] = "log"
    line: LogModel


EventMessage = Annotated[
    RobotMessage
    | DriverMessage
    | PoseMessage
    | LandmarksMessage
    | NavigationMessage
    | MapMessage
    | JobMessage
    | PlaceMessage
    | BinMessage
    | CalibrationMessage
    | LogMessage,
    Field(discriminator="type"),
]


# /ws/drive, page to station


class DriveCommand(Question):
    type: Literal["drive"] = "drive"
    seq: int = Field(ge=0, le=2**53)
    linear: Number
    angular: Number
    ttl_ms: int = Field(default=250, ge=1, le=1000)
    heard_ms: int | None = Field(default=None, ge=0, le=2**53, description="t_ms of the newest `time` heard before")


class StopCommand(Question):
    """Motors off, and why: the log shows it."""

    type: Literal["stop"] = "stop"
    reason: str = Field(default="", max_length=100)


class PanTiltCommand(Question):
    type: Literal["pan_tilt"] = "pan_tilt"
    pan: Number
    tilt: Number


class TakeOverCommand(Question):
    type: Literal["take_over"] = "take_over"


class ReleaseCommand(Question):
    type: Literal["release"] = "release"


DriveRequest = Annotated[
    DriveCommand | StopCommand | PanTiltCommand | TakeOverCommand | ReleaseCommand, Field(discriminator="type")
]
drive_request: TypeAdapter[DriveRequest] = TypeAdapter(DriveRequest)


# /ws/drive, station to page


class DriveAccepted(Model):
    """The newest command went to the robot."""

    type: Literal["accepted"] = "accepted"
    seq: int


class DriveRefused(Model):
    """The command was refused, and why."""

    type: Literal["refused"] = "refused"
    problem: str = Field(description="the kind of problem, as in problem documents", examples=["not-driver"])
    text: str


class DriveReply(Model):
    """Who drives; sent at the start and at every change."""

    type: Literal["driver"] = "driver"
    driver: str | None
    you_drive: bool


class TimeReply(Model):
    """The station's clock, twenty times a second. A drive command that repeats it shows by it that it is not old."""

    type: Literal["time"] = "time"
    t_ms: int


DriveAnswer = Annotated[DriveAccepted | DriveRefused | DriveReply | TimeReply, Field(discriminator="type")]
