"""A navigation in formats that other tools read."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from shared.calibration_yaml import camera_sensor_text
from shared.geometry import FloatArray, quat_from_rotation
from station.files.foxglove import pose_of, time_of
from station.files.ply import cloud_columns, write_ply
from station.model.navigation import Navigation, Trajectory

FLOAT32 = 7  # foxglove.PackedElementField's number for it


def export_ply(nav: Navigation, path: Path) -> None:
    """Landmarks as a coloured cloud."""
    write_ply(path, cloud_columns(nav.landmarks.p_world, nav.landmarks.rgb))


def export_euroc(nav: Navigation, folder: Path) -> None:
    """An ASL folder: keyframes as cam0, the estimated trajectory where EuRoC has its ground truth.

    Poses are those of the body at the IMU's time; frame stamps are the camera's own, as in a recording.
    """
    camera = nav.calibration.camera
    images = folder / "mav0" / "cam0" / "data"
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    images.mkdir(parents=True)
    truth.mkdir(parents=True)
    rows = ["#timestamp [ns],filename"]
    for t_ns, encoded in zip(nav.keyframes.t_robot_ns.tolist(), nav.keyframes.encoded, strict=True):
        if encoded:
            name = f"{t_ns}{'.png' if encoded.startswith(b'PNG', 1) else '.jpg'}"
            (images / name).write_bytes(encoded)
            rows.append(f"{t_ns},{name}")
    (images.parent / "data.csv").write_text("\n".join(rows) + "\n")
    if camera is not None:
        more = {"robot_kind": nav.calibration.robot_kind, "rig": nav.calibration.rig}
        (images.parent / "sensor.yaml").write_text(camera_sensor_text(camera, **more))
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    (truth / "data.csv").write_text("\n".join([header, *(_asl_pose(t, T) for t, T in _poses(nav.trajectory))]) + "\n")


def export_mcap(nav: Navigation, path: Path) -> None:
    """Poses, keyframes and the cloud as Foxglove messages."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start(profile="", library="sentinel")
        channels = {
            topic: writer.register_channel(
                topic, "json", writer.register_schema(schema, "jsonschema", b'{"type": "object"}')
            )
            for topic, schema in (
                ("/navigation/pose", "foxglove.PoseInFrame"),
                ("/navigation/keyframe", "foxglove.CompressedImage"),
                ("/navigation/landmarks", "foxglove.PointCloud"),
            )
        }

        def put(topic: str, t_ns: int, content: dict[str, Any]) -> None:
            data = json.dumps({"timestamp": time_of(t_ns), "frame_id": "world", **content}).encode()
            writer.add_message(channels[topic], t_ns, data, t_ns)

        for t_ns, T in _poses(nav.trajectory):
            put("/navigation/pose", t_ns, {"pose": pose_of(T)})
        for t_ns, encoded in zip(nav.keyframes.t_robot_ns.tolist(), nav.keyframes.encoded, strict=True):
            image_format = "png" if encoded.startswith(b"PNG", 1) else "jpeg"
            put("/navigation/keyframe", t_ns, {"format": image_format, "data": base64.b64encode(encoded).decode()})
        if len(nav.trajectory):
            put("/navigation/landmarks", int(nav.trajectory.t_robot_ns[0]), _cloud(nav))
        writer.finish()


def _poses(trajectory: Trajectory) -> list[tuple[int, FloatArray]]:
    return list(zip(trajectory.t_robot_ns.tolist(), trajectory.T_world_body, strict=True))


def _asl_pose(t_ns: int, T: FloatArray) -> str:
    values = [*T[:3, 3], *quat_from_rotation(T[:3, :3])]
    return ",".join([str(t_ns), *(f"{value:.9g}" for value in values)])


def _cloud(nav: Navigation) -> dict[str, Any]:
    packed = np.ascontiguousarray(nav.landmarks.p_world, dtype="<f4").tobytes()
    return {
        "pose": pose_of(np.eye(4)),
        "point_stride": 12,
        "fields": [{"name": axis, "offset": 4 * i, "type": FLOAT32} for i, axis in enumerate("xyz")],
        "data": base64.b64encode(packed).decode(),
    }
