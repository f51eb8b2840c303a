"""A video file with `camera.yaml` (or `<name>.yaml`) next to it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from shared.calibration import Calibration
from shared.errors import DataError
from shared.sensor_yaml import read_bare_camera
from station.datasets.dataset import Dataset, choose_frames
from station.model.frames import ImageFrame

JPEG_QUALITY = 95  # frames are decoded and encoded again: keep what the video kept
MAX_FRAMES = 1_000_000


def open_video(path: Path, first: int | None, last: int | None, step: int, needs_camera: bool = True) -> Dataset:
    """Open a video. Times are frame position / frame rate, from 0."""
    candidates = [path.with_suffix(".yaml"), path.with_name("camera.yaml")]
    yaml_path = next((p for p in candidates if p.exists()), None)
    if yaml_path is None and needs_camera:
        raise DataError(f"{path} has no camera.yaml next to it; write the camera's intrinsics there")
    camera = None if yaml_path is None else read_bare_camera(yaml_path)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # what fails is said below, and not by ffmpeg
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            raise DataError(f"{path} cannot be decoded as a video; convert it to MP4 (H.264)")
        rate = capture.get(cv2.CAP_PROP_FPS)
        total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    finally:
        capture.release()
    if not (0 < total <= MAX_FRAMES) or not rate > 0:
        raise DataError(f"{path} does not say how many frames it has; convert it to MP4 (H.264)")
    if camera is not None and size != (camera.width, camera.height):
        raise DataError(
            f"{path} is {size[0]}x{size[1]} but {yaml_path} says {camera.width}x{camera.height}; correct it"
        )
    chosen = choose_frames(path, range(total), first, last, step)
    times = np.array([round(i * 1e9 / rate) for i in chosen], dtype=np.int64)
    return Dataset(
        path=path,
        kind="video",
        calibration=Calibration(camera=camera, imu=None),
        intrinsics_known=camera is not None and camera.is_measured,
        frame_times_ns=times,
        read_frames=lambda: _read_frames(path, chosen, times.tolist()),
    )


def _read_frames(path: Path, chosen: list[int], times_ns: list[int]) -> Iterator[ImageFrame]:
    capture = cv2.VideoCapture(str(path))
    try:
        position = -1
        for index, (wanted, t_ns) in enumerate(zip(chosen, times_ns, strict=True)):
            while position < wanted:
                # Containers often promise a frame or two more than they hold: the end is simply the end.
                if not capture.grab():
                    return
                position += 1
            ok, image = capture.retrieve()
            if not ok:
                raise DataError(f"frame {wanted} of {path} cannot be decoded; convert the video again")
            _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            yield ImageFrame(index, t_ns, 0, encoded.tobytes(), f"{path.name} frame {wanted}")
    finally:
        capture.release()
