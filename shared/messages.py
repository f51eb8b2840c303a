"""Every message robot and station exchange: a tagged union per direction, msgpack on the wire (docs/protocol.md)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
from msgspec import Meta
from msgspec.structs import force_setattr

from shared.calibration import Calibration, Side
from shared.text import PRINTABLE, SEEN_WHOLE, is_unseen, printable

PROTOCOL_VERSION = 2  # 2: headers with checksums

# Limits of what a message may hold. A peer that exceeds one broke the rules and is told which.
MAX_NAME_LENGTH = 64
MAX_SENTENCE_LENGTH = 1000
MAX_IMU_SAMPLES_PER_BATCH = 256
MAX_FRAMES_IN_FLIGHT = 8  # and no more bytes than the link holds, beside one picture (robot/video.py)
MAX_REPORTED_PICTURES = 8
MAX_DEPTH_BYTES = 2**20  # a depth camera's picture of 640x480 has 100 to 300 kB
MAX_IMU_IN_FLIGHT = 1024  # samples: 4.5 s at 225 Hz
MAX_LIST_LENGTH = 32
MAX_LINEAR_M_S = 3.0  # a robot in a home is slower; its own limits travel in the hello
MAX_ANGULAR_RAD_S = 12.0
MAX_DRIVE_TTL_MS = 250  # silence must stop the motors within 300 ms: 50 ms are left for threads and the serial line
MAX_POSITION_M = 1000.0
MAX_COUNT = 2**53  # a page's numbers are exact up to here
MAX_TIME_NS = 2**62  # 146 years: a sum of two times still fits 64 bits

Name = Annotated[str, Meta(min_length=1, max_length=MAX_NAME_LENGTH, pattern=PRINTABLE)]
Id = Annotated[str, Meta(min_length=1, max_length=MAX_NAME_LENGTH, pattern=SEEN_WHOLE)]
Digest = Annotated[str, Meta(max_length=64, pattern=PRINTABLE)]
Sentence = Annotated[str, Meta(max_length=MAX_SENTENCE_LENGTH)]  # whoever holds a message finds it printable
Count = Annotated[int, Meta(ge=0, le=MAX_COUNT)]
NextSequence = Annotated[int, Meta(ge=-1, le=MAX_COUNT)]  # -1: none yet
Time = Annotated[int, Meta(ge=-MAX_TIME_NS, le=MAX_TIME_NS)]  # ns
Port = Annotated[int, Meta(ge=0, le=65535)]
Proof = Annotated[bytes, Meta(min_length=32, max_length=32)]
Key = Annotated[bytes, Meta(min_length=32, max_length=32)]
PakeMessage = Annotated[bytes, Meta(min_length=33, max_length=33)]


def _require(name: str, value: float, limit: float) -> None:
    if not (math.isfinite(value) and abs(value) <= limit):
        raise ValueError(f"{name} {value} is outside -{limit}..{limit}")


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


class _Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", gc=False):
    """Base of all messages. Unknown fields are ignored, so that a later release may add some."""

    def __str__(self) -> str:
        return type(self).__name__


class Capabilities(msgspec.Struct, frozen=True, kw_only=True):
    camera: bool
    imu: bool
    drive: bool
    pan_tilt: bool
    battery: bool
    hijack: bool  # only simulated robots can be picked up by a message
    max_linear_m_s: float = 0.5
    max_angular_rad_s: float = 2.0

    def __post_init__(self) -> None:
        _require("max_linear_m_s", self.max_linear_m_s, MAX_LINEAR_M_S)
        _require("max_angular_rad_s", self.max_angular_rad_s, MAX_ANGULAR_RAD_S)


class CalibrationOrigin(msgspec.Struct, frozen=True, kw_only=True):
    """Where the calibration that a robot tells comes from, and what a station can do about it."""

    source: Sentence  # as in "its calibration.yaml"
    can_undo: bool = False  # the one before it is kept
    fixed: Sentence = ""  # why the robot takes no other one; empty: it does

    def __post_init__(self) -> None:
        force_setattr(self, "source", printable(self.source))
        force_setattr(self, "fixed", printable(self.fixed))


class Hello(_Message, frozen=True, kw_only=True, tag="hello"):
    """Robot's first message: who it is and what is known of its sensors."""

    protocol: Count
    robot_id: Id
    name: Name
    session_id: Name  # new at every start of robot-server: sequence numbers are comparable only within one
    capabilities: Capabilities
    calibration: Calibration
    challenge: Annotated[bytes, Meta(max_length=64)] = b""  # to be answered by `Prove`; empty: no access control
    calibration_origin: CalibrationOrigin | None = None  # None: an older robot, whose calibration is a file on it
    datagram_port: Port = 0  # where it takes `AskDatagrams`' datagrams; 0: it sends none

    def __post_init__(self) -> None:
        if is_unseen(self.name) or is_unseen(self.robot_id):
            raise ValueError(
                "the robot's name or id has no character that is seen; write one under [identity] on the robot"
            )


class Prove(_Message, frozen=True, kw_only=True, tag="prove"):
    """Station's first message to a robot with access control: the answer to the challenge (shared/access.py)."""

    token_id: Name
    proof: Proof

    def __repr__(self) -> str:
        return f"Prove({self.token_id})"


class PairRequest(_Message, frozen=True, kw_only=True, tag="pair_request"):
    """Station's first message when it has no token yet but a code: its part of the exchange (shared/pairing.py)."""

    protocol: Count
    station_name: Name
    message: PakeMessage


class PairReply(_Message, frozen=True, kw_only=True, tag="pair_reply"):
    """The robot's part."""

    message: PakeMessage


class PairProof(_Message, frozen=True, kw_only=True, tag="pair_proof"):
    """Shows that the station knew the code, and sees the robot's own certificate."""

    mac: Proof


class Paired(_Message, frozen=True, kw_only=True, tag="paired"):
    """Shows that the robot knew the code, and gives the station its token; then the robot closes."""

    mac: Proof
    token: Annotated[str, Meta(max_length=128, pattern=PRINTABLE)]

    def __repr__(self) -> str:
        return "Paired()"  # the token is for nobody's log


class Join(_Message, frozen=True, kw_only=True, omit_defaults=True, tag="join"):
    """Station's first message. It may continue the IMU stream where an earlier connection ended."""

    protocol: Count
    station_name: Name
    resume_session_id: Annotated[str, Meta(max_length=MAX_NAME_LENGTH, pattern=PRINTABLE)] = ""
    next_imu_sequence: NextSequence = -1  # the first sample not yet received; -1: from now on
    knows_calibration_changed: bool = False  # False: an older station, whose connection that message would end
    knows_depth: bool = False  # likewise
    # Of one run of a station's program, the same in all its connections; "": an older station.
    station_id: Annotated[str, Meta(max_length=MAX_NAME_LENGTH, pattern=PRINTABLE)] = ""


class Welcome(_Message, frozen=True, kw_only=True, tag="welcome"):
    """The robot takes the station in."""

    client_id: Count


class Refusal(_Message, frozen=True, kw_only=True, tag="refusal"):
    """The robot does not take the station in, and closes."""

    reason: Sentence

    def __post_init__(self) -> None:
        force_setattr(self, "reason", printable(self.reason))


class Heartbeat(_Message, frozen=True, kw_only=True, tag="heartbeat"):
    """Station to robot, several times a second: I am here, and this is my time."""

    seq: Count
    t_station_ns: Time
    # True: somebody handles the robot, and no station may drive it while this one says so. Left out otherwise.
    must_stand: bool | msgspec.UnsetType = msgspec.UNSET


class HeartbeatReply(_Message, frozen=True, kw_only=True, omit_defaults=True, tag="heartbeat_reply"):
    """Answer to one heartbeat, with the robot's clock at its arrival and at the answer's departure."""

    seq: Count
    t_station_ns: Time  # as received
    t_robot_received_ns: Time
    t_robot_sent_ns: Time
    took_stop: bool = True  # False: the motors have not taken the last stop, so that this confirms none


class Received(_Message, frozen=True, kw_only=True, omit_defaults=True, tag="received"):
    """What the station has taken in, after each frame and with each heartbeat.

    The robot lets only MAX_FRAMES_IN_FLIGHT and MAX_IMU_IN_FLIGHT be on the way: a stalled station or network must not
    fill the kernels' buffers with the past. From bytes and times it learns what the link carries.
    """

    frame_seq: NextSequence  # of the newest frame; -1: none yet
    next_imu_sequence: NextSequence  # the first sample not yet received; -1: none yet
    num_bytes: NextSequence = -1  # of this connection, within TLS; -1: an older station, which does not count them
    held_ns: Count = 0  # since the last of them was read
    t_station_ns: Time = 0  # when that was; 0: an older station, which does not say


class AskDatagrams(_Message, frozen=True, kw_only=True, tag="ask_datagrams"):
    """Send pictures by datagrams to this port of ours where that is better; only to a robot that has such a port."""

    port: Port


class Datagrams(_Message, frozen=True, kw_only=True, tag="datagrams"):
    """The robot's answer: what datagrams are sealed with (shared/datagrams.py). New for each `AskDatagrams`."""

    session: Annotated[int, Meta(ge=0, le=2**32 - 1)]
    key_to_station: Key
    key_to_robot: Key

    def __repr__(self) -> str:
        return f"Datagrams({self.session})"  # the keys are for nobody's log


class PictureArrival(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Which pieces of a picture have come, and when."""

    picture: Count
    count: Count
    first_piece: Count  # the one that came first
    first_held_ns: Count  # before this report was made
    last_piece: Count
    last_held_ns: Count


class DatagramReport(_Message, frozen=True, kw_only=True, tag="datagram_report"):
    """From the station, as a datagram: what has come of the robot's. The robot answers with a `HeartbeatReply`."""

    seq: Count
    t_station_ns: Time
    newest: NextSequence  # number of a datagram; -1: none has come
    pictures: Annotated[tuple[PictureArrival, ...], Meta(max_length=MAX_REPORTED_PICTURES)]  # the newest, in order


class CameraFrame(_Message, frozen=True, kw_only=True, omit_defaults=True, tag="frame"):
    """One camera image. Newest wins: frames the connection had no time for are skipped and counted."""

    seq: Count  # counts every frame the camera made
    t_robot_ns: Time  # mid-exposure of the first image row
    exposure_ns: Count  # 0 where unknown
    width: Side
    height: Side
    skipped: Count  # frames skipped for this station since the one sent before
    quality: Annotated[int, Meta(ge=0, le=100)] = 0  # of a JPEG made smaller for a thin link; 0: as the camera made it
    jpeg: bytes

    def __str__(self) -> str:
        size = f"{self.width}x{self.height}, {len(self.jpeg)} bytes"
        return f"CameraFrame(seq={self.seq}, t_robot_ns={self.t_robot_ns}, {size})"


class Depth(_Message, frozen=True, kw_only=True, tag="depth"):
    """What the depth sensor of the calibration measured. Newest wins; sent a few times a second at most."""

    seq: Count  # counts every picture the sensor made
    t_robot_ns: Time  # the IMU's clock
    png: Annotated[bytes, Meta(max_length=MAX_DEPTH_BYTES)]  # 16 bit grey, mm along the axis; 0 or 65535: nothing

    def __str__(self) -> str:
        return f"Depth(seq={self.seq}, t_robot_ns={self.t_robot_ns}, {len(self.png)} bytes)"


class ImuSample(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One inertial reading as the sensor gave it."""

    t_robot_ns: Time
    gyro_imu: tuple[float, float, float]  # rad/s
    accel_imu: tuple[float, float, float]  # m/s^2, specific force: +9.81 along up at rest


class ImuBatch(_Message, frozen=True, kw_only=True, tag="imu"):
    """Consecutive samples: number `first_sequence`, +1, +2, ... A hole in the sensor's count starts a new batch."""

    first_sequence: Count
    samples: Annotated[tuple[ImuSample, ...], Meta(min_length=1, max_length=MAX_IMU_SAMPLES_PER_BATCH)]

    @property
    def next_sequence(self) -> int:
        """The number the sample after this batch must have."""
        return self.first_sequence + len(self.samples)

    def __str__(self) -> str:
        return f"ImuBatch(first_sequence={self.first_sequence}, {len(self.samples)} samples)"


class Drive(_Message, frozen=True, kw_only=True, tag="drive"):
    """Hold this velocity for `ttl_ms`, then stop. Repeated while the joystick is held."""

    seq: Count  # increasing within one connection; an older one is ignored
    t_station_ns: Time
    linear: float  # m/s, forward
    angular: float  # rad/s, left
    ttl_ms: Annotated[int, Meta(ge=1, le=MAX_DRIVE_TTL_MS)]

    def __post_init__(self) -> None:
        _require("linear", self.linear, MAX_LINEAR_M_S)
        _require("angular", self.angular, MAX_ANGULAR_RAD_S)


class Stop(_Message, frozen=True, kw_only=True, tag="stop"):
    """Motors off now. Any station may say it, also one that does not drive."""

    seq: Count


class PanTilt(_Message, frozen=True, kw_only=True, tag="pan_tilt"):
    """Point the camera head; angles from straight ahead, positive left and up."""

    pan: float  # rad
    tilt: float  # rad

    def __post_init__(self) -> None:
        _require("pan", self.pan, math.pi)
        _require("tilt", self.tilt, math.pi)


class Hijack(_Message, frozen=True, kw_only=True, omit_defaults=True, tag="hijack"):
    """Pick the robot up and put it down elsewhere (simulated robots only)."""

    x: float  # m, the simulated world's frame
    y: float  # m
    yaw: float  # rad
    # To a free spot of the robot's choice, in another room where there is one: x, y, yaw are idle.
    anywhere: bool = False

    def __post_init__(self) -> None:
        _require("x", self.x, MAX_POSITION_M)
        _require("y", self.y, MAX_POSITION_M)
        _require("yaw", self.yaw, 2 * math.pi)


class UseCalibration(_Message, frozen=True, kw_only=True, tag="use_calibration"):
    """Tell this calibration from now on. The robot keeps the present one, and answers with `CalibrationChanged`."""

    calibration: Calibration
    # calibration_digest of what the robot told when this was made of it; left out: whatever it tells.
    instead_of: Digest | msgspec.UnsetType = msgspec.UNSET


class UndoCalibration(_Message, frozen=True, kw_only=True, tag="undo_calibration"):
    """Tell the calibration before the present one again. Said twice, the present one is back."""

    instead_of: Digest | msgspec.UnsetType = msgspec.UNSET


class CalibrationChanged(_Message, frozen=True, kw_only=True, tag="calibration_changed"):
    """To every station: from now on this stands in the place of what the hello told."""

    calibration: Calibration
    origin: CalibrationOrigin
    # To the station that gave the order True, to others False; left out by an older robot.
    is_answer: bool | msgspec.UnsetType = msgspec.UNSET


class DriveApplied(_Message, frozen=True, kw_only=True, omit_defaults=True, tag="drive_applied"):
    """What motors and head were told, on each change of the motors and 20 times a second while driving or not."""

    t_robot_ns: Time
    linear: float  # m/s
    angular: float  # rad/s
    pan: float = 0.0  # rad, positive left: what the servos are told at this time, on the way to where they shall look
    tilt: float = 0.0  # rad, positive up

    def __post_init__(self) -> None:
        if not (math.isfinite(self.linear) and math.isfinite(self.angular)):
            raise ValueError(f"({self.linear} m/s, {self.angular} rad/s) is no motion")
        _require("pan", self.pan, math.pi)
        _require("tilt", self.tilt, math.pi)


class Status(_Message, frozen=True, kw_only=True, tag="status"):
    """How the robot is, once a second. Counts run since robot-server started. What is no number is not known."""

    t_robot_ns: Time
    uptime_s: float
    battery_v: float | None = None
    battery_fraction: float | None = None  # 0..1
    temperatures_c: Annotated[dict[Name, float], Meta(max_length=MAX_LIST_LENGTH)] = {}
    cpu_percent: float | None = None  # of one core, robot-server itself
    frames_captured: Count = 0
    frames_skipped: Count = 0  # for this station
    imu_samples: Count = 0
    imu_lost_in_sensor: Count = 0  # holes in the sensor's own count
    imu_lost_in_backlog: Count = 0  # for this station: it was away or slow for longer than the backlog holds
    messages_dropped: Count = 0  # for this station: drive reports and notices that found its queue full
    stations: Count = 0
    driver: Name | None = None  # name of the station that drives
    you_drive: bool = False
    watchdog_stops: Count = 0  # the watchdog stopped moving motors because commands went silent
    commands_refused: Count = 0
    faults: Annotated[tuple[Sentence, ...], Meta(max_length=MAX_LIST_LENGTH)] = ()  # what does not work, in sentences

    def __post_init__(self) -> None:
        force_setattr(self, "faults", tuple(map(printable, self.faults)))
        if not math.isfinite(self.uptime_s):
            force_setattr(self, "uptime_s", 0.0)
        for name in ("battery_v", "battery_fraction", "cpu_percent"):
            force_setattr(self, name, _finite(getattr(self, name)))
        warm = {name: value for name, value in self.temperatures_c.items() if math.isfinite(value)}
        force_setattr(self, "temperatures_c", warm)


ErrorCode = Literal[
    "protocol",
    "not_driver",
    "not_capable",
    "not_allowed",
    "out_of_range",
    "device",
    "end_of_recording",
    "shutdown",
    "silent",
]


class ErrorNotice(_Message, frozen=True, kw_only=True, tag="error"):
    """Something was refused or failed. After a fatal one the sender closes the connection."""

    code: ErrorCode
    message: Sentence
    fatal: bool = False
    about: Literal["hijack", "calibration"] | msgspec.UnsetType = (
        msgspec.UNSET
    )  # what was asked, where an answer is waited for

    def __post_init__(self) -> None:
        force_setattr(self, "message", printable(self.message))


RobotMessage = (
    Hello
    | Welcome
    | Refusal
    | PairReply
    | Paired
    | HeartbeatReply
    | CameraFrame
    | Datagrams
    | Depth
    | ImuBatch
    | DriveApplied
    | CalibrationChanged
    | Status
    | ErrorNotice
)
StationMessage = (
    Join
    | Prove
    | PairRequest
    | PairProof
    | Heartbeat
    | Received
    | AskDatagrams
    | Drive
    | Stop
    | PanTilt
    | Hijack
    | UseCalibration
    | UndoCalibration
    | ErrorNotice
)
Message = RobotMessage | StationMessage
StationDatagram = DatagramReport | Drive | Stop  # commands are copies of those on the connection
