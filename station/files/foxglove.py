"""Message formats of our recordings that Foxglove knows by name, so that a recording opens there as it is.

Images are protobuf: the JPEG stays as it came. Everything else is JSON.
Source: foxglove.CompressedImage and foxglove.CameraCalibration.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap_protobuf.schema import build_file_descriptor_set

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, quat_from_rotation

IMAGE_SCHEMA_NAME: str = CompressedImage.DESCRIPTOR.full_name
CALIBRATION_SCHEMA_NAME = "foxglove.CameraCalibration"
NANO = 1_000_000_000


def encode_image(t_robot_ns: int, encoded: bytes, frame_id: str = "camera", kind: str = "jpeg") -> bytes:
    """A foxglove.CompressedImage in protobuf."""
    message = CompressedImage(frame_id=frame_id, format=kind, data=encoded)
    message.timestamp.seconds, message.timestamp.nanos = divmod(t_robot_ns, NANO)
    return message.SerializeToString()


def image_schema() -> bytes:
    """FileDescriptorSet of foxglove.CompressedImage and the timestamp it uses."""
    return build_file_descriptor_set(CompressedImage).SerializeToString()


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


def pose_of(T: FloatArray) -> dict[str, dict[str, float]]:
    """A foxglove.Pose as JSON content."""
    w, x, y, z = quat_from_rotation(T[:3, :3]).tolist()
    return {
        "position": dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
        "orientation": {"x": x, "y": y, "z": z, "w": w},
    }
