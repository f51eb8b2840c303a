"""The API's answers and questions as JSON; the page's types are generated from these (docs/api.md)."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from station.config import MAX_ACTIVE_MAPS

Number = Annotated[float, Field(allow_inf_nan=False)]


def _not_blank(name: str) -> str:
    if not name.strip():
        raise ValueError("a name needs a character that is no space")
    return name


Name = Annotated[str, Field(max_length=80, json_schema_extra={"pattern": r"\S"}), AfterValidator(_not_blank)]


class Model(BaseModel):
    """Base of all: questions with unknown fields are refused, so that a typing error is seen."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Question(Model):
    """Base of what is asked: no value is taken for another kind, so that `true` is no speed."""

    model_config = ConfigDict(strict=True)


class Problem(BaseModel):
    """What went wrong (RFC 9457)."""

    type: str = Field(examples=["/problems/not-driver"])
    title: str = Field(examples=["Another one drives"])
    status: int = Field(examples=[409])
    detail: str = Field(examples=["anna drives; take over with POST /drive/take-over"])
    instance: str = Field(examples=["/drive"])


# Place


class PlaceName(Model):
    id: str = Field(examples=["place-5a1c09"])
    name: str = Field(examples=["Kitchen"])


class PlaceProbability(PlaceName):
    probability: float = Field(
        description="that it is the nearest one or within 10 % of that: several may sum to more than 1", examples=[0.07]
    )
    map: str = Field(description="id of the active map that it is a place of", examples=["map-0a1b"])


class Evidence(Model):
    """Why: the running picture and the map's picture that shows the same landmarks."""

    query_image: str | None = Field(examples=["/place/current/images/812345678901.jpg"])
    map_image: str | None = Field(examples=["/maps/map-0a1b/images/17.jpg"])
    inliers: int = Field(description="landmarks of the map found where they belong", examples=[84])
    age_s: float | None = Field(description="since the picture that was recognised", examples=[0.4])


class CurrentPlace(Model):
    """Which place the robot is at. `place` is null unless the state is "known"."""

    state: Literal["known", "unknown", "lost"]
    place: PlaceName | None
    probability: float = Field(
        description="that `place` is the nearest one or within 10 % of that; of the likeliest one while none is known",
        examples=[0.97],
    )
    distance_m: float | None = Field(description="robot to the place's centroid; null without a metric map")
    position_map: list[float] | None = Field(description="x, y, z of the robot in `map`", examples=[[1.2, 0.4, 0.1]])
    age_s: float | None = Field(description="since the picture the answer is about was taken", examples=[0.2])
    map: str | None = Field(
        description="id of the active map that place, position and evidence are of; while there are none, the first",
        examples=["map-0a1b"],
    )
    alternatives: list[PlaceProbability]
    evidence: Evidence
    preparing: float | None = Field(
        description="0..1 while the map is prepared for answers; else null", examples=[None]
    )
    reason: str = Field(description="in a sentence", examples=["84 landmarks of the map were recognised 0.2 s ago"])
    t_robot_ns: int | None = Field(description="sensor time the answer is about, robot clock")
    pose_map: list[float] | None = Field(
        description="T_map_cam of the newest picture, row-major 4x4; null when it was not recognised in `map`"
    )


class VisitModel(Model):
    """A stretch of time with one answer."""

    state: Literal["known", "unknown", "lost"]
    place: PlaceName | None
    start_unix_s: float
    end_unix_s: float


class PlaceModel(Model):
    """A place of the active map."""

    id: str
    name: str
    centroid_map: list[float]
    radius: float = Field(description="RMS distance of its landmarks from the centroid, map units")
    landmarks: int
    images: int = Field(description="keyframes that saw it")
    quality: float = Field(description="0..1, how clearly it stands out, and of how many landmarks")
    representative_image: str | None
    mean_image: str | None
    deviation_image: str | None = Field(description="how much the brightness of its pictures differs")
    colour: int = Field(
        description="its number in GET /maps/{id}/landmarks; neighbours differ in the remainder by 12", examples=[5]
    )
    hidden: bool = Field(description="by a person: never the current place, and not in the graph")
    named: bool = Field(description="a person gave it its name")


class PlaceChange(Question):
    """What is to be otherwise; what is left out or null stays, and one thing must be said."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    name: Name | None = Field(default=None, examples=["Kitchen"])
    hidden: bool | None = Field(default=None, examples=[False])

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.name is None and self.hidden is None:
            raise ValueError("nothing is to be changed: give name or hidden")
        return self


class PlaceMerge(Question):
    """Which places are one; it keeps id and name of the first."""

    places: list[str] = Field(min_length=2, max_length=50, examples=[["place-5a1c09", "place-77d0e2"]])


class PlacesChangeModel(Model):
    """What a person made of the places: renamed, hidden, merged."""

    version: int = Field(description="of the map, that the change led to", examples=[4])
    why: str = Field(examples=["Kitchen and Place 3 are one"])
    unix_s: float


class UndoOrder(Question):
    """What to take back."""

    version: int | None = Field(
        default=None,
        ge=1,
        le=2**53,
        description="only if this is the newest change; null: whatever it is",
        examples=[4],
    )


class EdgeModel(Model):
    a: str
    b: str
    bearing_rad: float = Field(description="a to b in the ground plane, from +x towards +y")
    distance: float = Field(description="between centroids, map units")
    kind: Literal["seen together", "driven between", "nearest"]


class GraphModel(Model):
    """The topological map."""

    map: str
    metric: bool = Field(description="distances are metres; false: of unknown scale")
    nodes: list[PlaceModel]
    edges: list[EdgeModel]


class RouteModel(Model):
    """The shortest way along the graph's edges."""

    map: str
    metric: bool = Field(description="distances are metres; false: of unknown scale")
    places: list[PlaceName] = Field(description="from start to goal")
    legs: list[EdgeModel] = Field(description="from each place to the next one")
    length: float = Field(description="of all legs, map units", examples=[4.9])


# Maps, navigations, jobs


class MapModel(Model):
    id: str
    name: str
    places: int
    active: bool = Field(description="robots are looked for in it")
    first: bool = Field(description="it is the active map whose places GET /places and GET /graph show")
    damaged: str = Field(description="a sentence, where the map cannot be read", examples=[""])


class MapOrder(Question):
    """What to build a map from."""

    navigations: list[str] = Field(min_length=1, max_length=20, examples=[["nav-20260105-101500"]])
    name: str = Field(default="", max_length=80, examples=["Flat"])
    mode: Literal["default", "thesis"] | None = None
    activate: bool = Field(default=True, description="use the map as soon as it is built")


class NewName(Question):
    """What it shall be called."""

    name: Name = Field(examples=["Ground floor"])


class MapChoice(Question):
    """Where robots are looked for."""

    id: str | None = Field(description="null: no map", examples=["map-0a1b"])
    also: list[str] = Field(
        default_factory=list,
        max_length=MAX_ACTIVE_MAPS - 1,
        description="further maps, of other rooms; their order means nothing",
        examples=[["map-7c2d"]],
    )

    @model_validator(mode="after")
    def _has_a_first(self) -> Self:
        if self.id is None and self.also:
            raise ValueError("no map is to be in use, and yet others also: name one of them as id")
        return self


class NavigationModel(Model):
    """One recorded drive and what SLAM made of it."""

    id: str = Field(examples=["nav-20260105-101500"])
    name: str
    state: Literal["recording", "finishing", "ready", "failed"]
    message: str
    robot: str = Field(description="its name in GET /robots when it drove; empty: an old drive")
    started_unix_s: float
    duration_s: float
    backend: str
    frames: int
    frames_skipped: int = Field(description="by live SLAM; the recording has them")
    imu_samples: int
    imu_lost: int
    slam_failures: int = Field(description="pictures or samples that SLAM refused; the message quotes it")
    landmarks: int
    scale: Literal["metric", "arbitrary", ""]
    recording: str | None = Field(description="where to download the MCAP file")


class ReprocessOrder(Question):
    """How to run SLAM over a recording again."""

    backend: Literal["sfm", "ukf"] | None = Field(default=None, description="null: the station's own")


class ReplayModel(Model):
    """Where the camera was during a recorded navigation; the pictures come by /ws/replay."""

    navigation: str
    start_ns: int = Field(description="robot clock, of the first pose")
    t_s: list[float] = Field(description="since start_ns, increasing; at most `limit` poses")
    T_world_cam: list[list[float]] = Field(description="row-major 4x4 each")


class ComparisonOrder(Question):
    """Which navigations to compare: places are made of the first one and looked for in the second."""

    first: str = Field(examples=["nav-20260105-101500"])
    second: str = Field(examples=["nav-20260106-090000"])


class ComparisonModel(Model):
    """Two navigations compared; the report has the pictures."""

    id: str = Field(examples=["cmp-20260106-091200"])
    name: str
    first: str
    second: str
    made_unix_s: float
    places: int = Field(description="of the first navigation")
    locations: int = Field(description="of the second one")
    matches: int
    accepted: bool = Field(description="the registration")
    reasons: list[str] = Field(description="why it was refused")
    T_first_second: list[float] | None = Field(description="row-major 4x4, may carry a scale")
    report: str = Field(examples=["/comparisons/cmp-20260106-091200/report.html"])


class NavigationStart(Question):
    name: str = Field(default="", max_length=80, examples=["Tuesday, all rooms"])


class JobModel(Model):
    """Work in the background."""

    id: str
    kind: str
    title: str
    state: Literal["running", "done", "failed", "cancelled"]
    progress: float = Field(description="0..1")
    message: str
    result: dict[str, str | int | float | None] | None


class BinModel(Model):
    """Something deleted that can still be restored."""

    kind: Literal["navigation", "map"]
    id: str = Field(examples=["nav-20260105-101500"])
    name: str
    deleted_unix_s: float
    gone_unix_s: float = Field(description="when it is deleted for good, at the latest")


# SLAM


class SlamModel(Model):
    """The running SLAM, or the last one."""

    navigation: str | None
    state: Literal["none", "initialising", "tracking", "lost", "finishing", "finished"]
    message: str = Field(examples=["not initialised yet: move the robot sideways"])
    landmarks: int
    frames: int
    t_robot_ns: int | None
    T_world_body: list[float] | None = Field(description="row-major 4x4; null while there is no pose")
    T_world_cam: list[float] | None = Field(description="the same for the camera")
    segment: int


class TrajectoryModel(Model):
    """Poses so far, oldest first; thinned to `limit` poses."""

    navigation: str | None
    source: str | None = Field(description="the cloud it belongs to: X-Source of GET /landmarks")
    total: int
    t_robot_ns: list[int]
    p_world: list[list[float]] = Field(description="body positions, (N, 3)")


# Robot


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
    drift_ppm: float | None
    rtt_ms: float | None


class BatteryModel(Model):
    voltage_v: float | None
    fraction: float | None


class AppliedModel(Model):
    """What the motors were told."""

    linear: float
    angular: float


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
    connections: int
    rates: RatesModel
    losses: LossesModel
    clock: ClockModel
    battery: BatteryModel | None
    temperatures_c: dict[str, float]
    cpu_percent: float | None = Field(description="of one core, robot-server")
    driver: str | None = Field(description="who drives through this station")
    robot_driver: str | None = Field(description="the station that drives, as the robot says")
    applied: AppliedModel | None
    head_must_rest: str = Field(description="why the camera head must look straight ahead; empty: it may turn")
    faults: list[str]


class RobotEntry(Model):
    """One of the station's robots, and where it is."""

    name: str = Field(description="in this station", examples=["robot-1"])
    path: str = Field(description="put before a call to ask for this robot", examples=["/robots/robot-1"])
    navigation: str | None = Field(description="id of the drive that is being recorded")
    state: Literal["known", "unknown", "lost"]
    place: PlaceName | None
    robot: RobotModel


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


class DriverModel(Model):
    driver: str | None
    you_drive: bool
    keeps_s: float = Field(description="so long the driver keeps the wheel without another word", examples=[6.0])


class Accepted(Model):
    """Done."""

    ok: Literal[True] = True


class LogModel(Model):
    """Something a person may want to know."""

    number: int
    unix_s: float
    level: Literal["info", "warning", "error"]
    topic: str
    text: str


class HealthModel(Model):
    status: Literal["ok"]
    version: str
    uptime_s: float
    robot_connected: bool
    localisation: str = Field(description="in words")


class SessionModel(Model):
    """Who asks."""

    controlled: bool = Field(description="false: everybody who reaches this station is admin")
    name: str
    role: Literal["watch", "drive", "admin"]
