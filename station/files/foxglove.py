"""Message formats of our recordings that Foxglove knows by name, so that a recording opens there as it is.

Images are protobuf: the JPEG stays as it came. The one message needs no protobuf library: it is four fields, and its
description (a `FileDescriptorSet`, which MCAP wants as schema) is put together here. Everything else is JSON.
Source: foxglove.CompressedImage and foxglove.CameraCalibration; protobuf's wire format and descriptor.proto.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shared.calibration import CameraCalibration
from shared.mcap_recording import NANO

_VARINT, _LENGTH = 0, 2  # wire types
_STRING, _MESSAGE, _BYTES, _INT64, _INT32 = 9, 11, 12, 3, 5  # FieldDescriptorProto.Type
_OPTIONAL = 1  # FieldDescriptorProto.Label
IMAGE_SCHEMA_NAME = "foxglove.CompressedImage"
CALIBRATION_SCHEMA_NAME = "foxglove.CameraCalibration"


def encode_image(t_robot_ns: int, jpeg: bytes) -> bytes:
    """A foxglove.CompressedImage in protobuf."""
    seconds, nanos = divmod(t_robot_ns, NANO)
    timestamp = _number(1, seconds) + _number(2, nanos)
    return _blob(1, timestamp) + _blob(4, b"camera") + _blob(3, b"jpeg") + _blob(2, jpeg)


def image_schema() -> bytes:
    """FileDescriptorSet of foxglove.CompressedImage and the timestamp it uses."""
    timestamp = _file(
        "google/protobuf/timestamp.proto",
        "google.protobuf",
        _message("Timestamp", _field("seconds", 1, _INT64), _field("nanos", 2, _INT32)),
    )
    image = _file(
        "foxglove/CompressedImage.proto",
        "foxglove",
        _message(
            "CompressedImage",
            _field("timestamp", 1, _MESSAGE, ".google.protobuf.Timestamp"),
            _field("frame_id", 4, _STRING),
            _field("data", 2, _BYTES),
            _field("format", 3, _STRING),
        ),
        dependency="google/protobuf/timestamp.proto",
    )
    return _blob(1, timestamp) + _blob(1, image)


def camera_calibration(camera: CameraCalibration, t_robot_ns: int) -> dict[str, Any]:
    """A foxglove.CameraCalibration as JSON content."""
    P = np.hstack([camera.K, np.zeros((3, 1))])
    return {
        "timestamp": time_of(t_robot_ns),
        "frame_id": "camera",
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "plumb_bob" if camera.model == "radtan" else "kannala_brandt",
        "D": [*camera.distortion, *([0.0] if camera.model == "radtan" else [])],
        "K": camera.K.ravel().tolist(),
        "R": np.eye(3).ravel().tolist(),
        "P": P.ravel().tolist(),
    }


def time_of(t_ns: int) -> dict[str, int]:
    """Foxglove's JSON time. Two integers, because JavaScript's numbers cannot hold 64-bit nanoseconds."""
    seconds, nanos = divmod(t_ns, NANO)
    return {"sec": seconds, "nsec": nanos}


# Protobuf's wire format: https://protobuf.dev/programming-guides/encoding/


def _varint(value: int) -> bytes:
    value &= (1 << 64) - 1  # negative numbers are sent in two's complement
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3 | _VARINT) + _varint(value)


def _blob(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | _LENGTH) + _varint(len(value)) + value


# descriptor.proto's field numbers


def _field(name: str, number: int, kind: int, type_name: str = "") -> bytes:
    described = _blob(1, name.encode()) + _number(3, number) + _number(4, _OPTIONAL) + _number(5, kind)
    return described + (_blob(6, type_name.encode()) if type_name else b"")


def _message(name: str, *fields: bytes) -> bytes:
    return _blob(1, name.encode()) + b"".join(_blob(2, field) for field in fields)


def _file(name: str, package: str, message: bytes, dependency: str = "") -> bytes:
    head = _blob(1, name.encode()) + _blob(2, package.encode())
    depends = _blob(3, dependency.encode()) if dependency else b""
    return head + depends + _blob(4, message) + _blob(12, b"proto3")
