"""A video with `camera.yaml` (or `<name>.yaml`) next to it, played as a robot's camera. It has no IMU."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import cv2

from robot.devices.recorded.images import JPEG_QUALITY
from robot.devices.recorded.recording import RecordedFrame, Recording, read_bare_camera
from shared.calibration import Calibration
from shared.errors import DataError
from shared.mcap_recording import InOrder

MAX_FRAMES = 1_000_000


def open_file(path: Path) -> Recording:
    """Open a video; frame k is taken k / rate after 0. Raises DataError naming the file and the remedy."""
    yaml_path = next((p for p in (path.with_suffix(".yaml"), path.with_name("camera.yaml")) if p.is_file()), None)
    if yaml_path is None:
        raise DataError(f"{path} has no camera.yaml next to it; write the camera's intrinsics there")
    camera = read_bare_camera(yaml_path)
    video = cv2.VideoCapture(str(path))
    rate_hz, count = video.get(cv2.CAP_PROP_FPS), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    size = (int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    video.release()
    if not (0 < count <= MAX_FRAMES and rate_hz > 0):
        raise DataError(f"{path} cannot be decoded as a video; convert it to MP4 (H.264)")
    if size != (camera.width, camera.height):
        raise DataError(
            f"{path} is {size[0]}x{size[1]} but {yaml_path} says {camera.width}x{camera.height}; correct it"
        )
    images = InOrder(lambda: _images(path))
    frames = tuple(RecordedFrame(round(k * 1e9 / rate_hz), path, 0, partial(images.read, k)) for k in range(count))
    remarks = (f"{path} holds no IMU samples; only its images are played",)
    return Recording(path, Calibration(camera=camera, imu=None), frames, (), remarks)


def _images(path: Path) -> Iterator[bytes]:
    video = cv2.VideoCapture(str(path))
    try:
        while True:
            ok, image = video.read()
            if not ok:
                return
            yield bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])
    finally:
        video.release()
