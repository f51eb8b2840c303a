"""What a recording holds: topic → schema, and the content of what the station decides (docs/recordings.md)."""

from __future__ import annotations

from typing import Any

import msgspec
from mcap.writer import Writer

from shared.mcap_recording import DEPTH_TOPIC, DRIVE_TOPIC, FRAME_TOPIC, HELLO_TOPIC, IMAGE_TOPIC, IMU_TOPIC
from station.events import Level, LogLine
from station.files.foxglove import CALIBRATION_SCHEMA_NAME, IMAGE_SCHEMA_NAME, image_schema, pose_of, time_of
from station.model.place_answer import PlaceCandidate, PlaceReport, RoomCandidate
from station.model.slam_update import SlamUpdate

LIBRARY = "sentinel-robot"  # what a recording says of its writer
CALIBRATION_TOPIC = "/camera/calibration"
COMMAND_TOPIC = "/drive/command"
STATUS_TOPIC = "/robot/status"
NOTICE_TOPIC = "/robot/notice"
GAP_TOPIC = "/link/imu_gap"
LINK_TOPIC = "/link/connection"
STATE_TOPIC = "/slam/state"
POSE_TOPIC = "/slam/pose"
ANSWER_TOPIC = "/place/answer"
LOG_TOPIC = "/station/log"

_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_ROTATION = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_INTEGER, _NUMBER, _TEXT, _YES_NO = {"type": "integer"}, {"type": "number"}, {"type": "string"}, {"type": "boolean"}
_LOG_LEVELS: dict[Level, int] = {"info": 2, "warning": 3, "error": 4}  # foxglove.Log's numbers


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_PLACE = _object(id=_TEXT, name=_TEXT, probability=_NUMBER)
# topic → (schema name, JSON schema). Their order numbers the channels of the files on disk: new ones come last.
JSON_CHANNELS: dict[str, tuple[str, dict[str, Any]]] = {
    HELLO_TOPIC: ("sentinel.Hello", _object(robot_id=_TEXT, name=_TEXT, session_id=_TEXT, msgpack_base64=_TEXT)),
    FRAME_TOPIC: (
        "sentinel.Frame",
        _object(
            timestamp=_TIME,
            seq=_INTEGER,
            exposure_ns=_INTEGER,
            width=_INTEGER,
            height=_INTEGER,
            skipped=_INTEGER,
            quality=_INTEGER,
        ),
    ),
    CALIBRATION_TOPIC: (CALIBRATION_SCHEMA_NAME, _object(timestamp=_TIME, frame_id=_TEXT)),
    IMU_TOPIC: ("sentinel.Imu", _object(timestamp=_TIME, sequence=_INTEGER, gyro=_VECTOR, accel=_VECTOR)),
    COMMAND_TOPIC: (
        "sentinel.DriveCommand",
        _object(driver=_TEXT, linear=_NUMBER, angular=_NUMBER, ttl_ms=_INTEGER),
    ),
    DRIVE_TOPIC: (
        "sentinel.DriveApplied",
        _object(timestamp=_TIME, linear=_NUMBER, angular=_NUMBER, pan=_NUMBER, tilt=_NUMBER),
    ),
    STATUS_TOPIC: ("sentinel.Status", _object(timestamp=_TIME, battery_v=_NUMBER, driver=_TEXT)),
    NOTICE_TOPIC: ("sentinel.Notice", _object(code=_TEXT, message=_TEXT)),
    GAP_TOPIC: ("sentinel.ImuGap", _object(num_samples=_INTEGER)),
    LINK_TOPIC: ("sentinel.Connection", _object(connected=_YES_NO, reason=_TEXT)),
    STATE_TOPIC: (
        "sentinel.SlamState",
        _object(timestamp=_TIME, state=_TEXT, message=_TEXT, landmarks=_INTEGER, is_keyframe=_YES_NO, segment=_INTEGER),
    ),
    POSE_TOPIC: (
        "foxglove.PoseInFrame",
        _object(timestamp=_TIME, frame_id=_TEXT, pose=_object(position=_VECTOR, orientation=_ROTATION)),
    ),
    ANSWER_TOPIC: (
        "sentinel.PlaceAnswer",
        _object(
            timestamp=_TIME,
            map=_TEXT,
            state=_TEXT,
            place=_PLACE,
            distance=_NUMBER,
            position_map=_VECTOR,
            inliers=_INTEGER,
            alternatives={"type": "array", "items": _PLACE},
            reason=_TEXT,
            attempt=_TEXT,
            room=_PLACE,
            room_alternatives={"type": "array", "items": _PLACE},
            doorway=_TEXT,
        ),
    ),
    LOG_TOPIC: ("foxglove.Log", _object(timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT)),
}


def register_channels(writer: Writer) -> dict[str, int]:
    """Name the channels to a new file, the same numbers each time. Returns topic → number."""
    image = writer.register_schema(IMAGE_SCHEMA_NAME, "protobuf", image_schema())
    channels = {IMAGE_TOPIC: writer.register_channel(IMAGE_TOPIC, "protobuf", image)}
    for topic, (name, json_schema) in JSON_CHANNELS.items():
        schema = writer.register_schema(name, "jsonschema", msgspec.json.encode(json_schema))
        channels[topic] = writer.register_channel(topic, "json", schema)
    channels[DEPTH_TOPIC] = writer.register_channel(DEPTH_TOPIC, "protobuf", image)
    return channels


def slam_state(update: SlamUpdate) -> dict[str, Any]:
    """What SLAM says of one frame."""
    return {
        "timestamp": time_of(update.t_robot_ns),
        "state": update.state,
        "message": update.message,
        "landmarks": update.num_landmarks,
        "is_keyframe": update.is_keyframe,
        "segment": update.segment,
    }


def slam_pose(update: SlamUpdate) -> dict[str, Any] | None:
    """Where SLAM says the body is; None while it does not know."""
    T = update.T_world_body
    if T is None:
        return None
    return {"timestamp": time_of(update.t_robot_ns), "frame_id": "world", "pose": pose_of(T)}


def place_answer(report: PlaceReport) -> dict[str, Any]:
    """The current place and why; what is not known is left out."""
    answer = report.answer
    content: dict[str, Any] = {
        "timestamp": time_of(answer.t_robot_ns),
        "map": report.map_id,
        "state": answer.state,
        "inliers": answer.inliers,
        "alternatives": [_place(candidate) for candidate in answer.alternatives],
        "reason": answer.reason,
        "attempt": report.attempt,
        "room_alternatives": [_place(candidate) for candidate in answer.room_alternatives],
    }
    if answer.room is not None:
        content["room"] = _place(answer.room)
    if answer.doorway is not None:
        content["doorway"] = answer.doorway
    if answer.place is not None:
        content["place"] = _place(answer.place)
    if answer.distance is not None:
        content["distance"] = float(answer.distance)
    if answer.position_map is not None:
        content["position_map"] = dict(zip("xyz", answer.position_map.tolist(), strict=True))
    return content


def log_line(line: LogLine) -> dict[str, Any]:
    """A sentence of the station."""
    return {
        "timestamp": time_of(round(line.t_wall_s * 1e9)),
        "level": _LOG_LEVELS[line.level],
        "message": line.text,
        "name": line.topic,
    }


def _place(candidate: PlaceCandidate | RoomCandidate) -> dict[str, Any]:
    return {"id": candidate.id, "name": candidate.name, "probability": float(candidate.probability)}
