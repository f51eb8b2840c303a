"""A folder of images with `camera.yaml` or `camera-intrinsics.txt`, optional `*.pose.txt` (T_world_cam), and optional
`*.depth.png` with `depth-intrinsics.txt`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np

from shared.bounded import read_text
from shared.calibration import Calibration
from shared.errors import DataError
from shared.geometry import MAX_POSITION, FloatArray, orthonormal, se3
from shared.pictures import picture_size
from shared.recorded_files import FIRST_STAMP, depth_images, image_times_ns, images_in_order
from shared.sensor_yaml import CAMERA_FILES, read_folder_camera, read_folder_depth
from station.datasets.asl import read_image_file
from station.datasets.dataset import Dataset, Truth, choose_frames
from station.model.frames import DepthFrame, ImageFrame, decode_picture

UNKNOWN_RATE_HZ = 30.0


def open_image_folder(path: Path, first: int | None, last: int | None, step: int, needs_camera: bool = True) -> Dataset:
    """Open a folder of images. Times are frame number / rate from 0 on, or the stamps the images are named by.

    A depth picture has the time of the image of its number; `step` leaves none out.
    Without a camera there is no rate: images that are not named by stamps are then as if taken at UNKNOWN_RATE_HZ.
    """
    numbered = images_in_order(path)
    numbers, files = [number for number, _ in numbered], [file for _, file in numbered]
    if not files:
        raise DataError(f"{path} holds no mav0 folder and no *.jpg or *.png images; give a dataset")
    chosen = choose_frames(path, numbers, first, last, step)
    camera = None
    if needs_camera or any((path / name).exists() for name in CAMERA_FILES):
        camera = read_folder_camera(path, lambda: _image_size(numbered[chosen[0]][1]))
    elif numbers[0] < FIRST_STAMP:
        numbers = list(range(len(numbers)))
    files = [files[i] for i in chosen]
    rate_hz = UNKNOWN_RATE_HZ if camera is None else camera.rate_hz
    all_times = image_times_ns(numbers, rate_hz, path)
    times = np.array(all_times, dtype=np.int64)[chosen]
    depth = depth_images(path)
    time_of = {number: t for (number, _), t in zip(numbered, all_times, strict=True) if times[0] <= t <= times[-1]}
    taken_with = sorted(depth.keys() & time_of)
    sensor = read_folder_depth(path, lambda: _depth_size(depth[taken_with[0]])) if taken_with else None

    def read_frames() -> Iterator[ImageFrame]:
        for index, (t_ns, file) in enumerate(zip(times, files, strict=True)):
            yield ImageFrame(index, int(t_ns), 0, read_image_file(file), file.name)

    def read_depth() -> Iterator[DepthFrame]:
        if sensor is not None:
            for number in taken_with:
                file = depth[number]
                yield DepthFrame(time_of[number], read_image_file(file), sensor, file.name)

    poses = [read_pose(file) for file in files]
    has_pose = [i for i, pose in enumerate(poses) if pose is not None]
    truth = Truth(times[has_pose], np.stack([p for p in poses if p is not None])) if has_pose else None
    return Dataset(
        path=path,
        kind="images",
        calibration=Calibration(camera=camera, imu=None, depth=msgspec.UNSET if sensor is None else sensor),
        # Three by three numbers without distortion are a guess.
        intrinsics_known=camera is not None and camera.is_measured and (path / "camera.yaml").exists(),
        frame_times_ns=times,
        read_frames=read_frames,
        truth=truth,
        read_depth=None if sensor is None else read_depth,
    )


def _image_size(path: Path) -> tuple[int, int]:
    try:
        height, width = decode_picture(read_image_file(path), cv2.IMREAD_GRAYSCALE).shape[:2]  # turned as EXIF says
    except ValueError as exc:
        raise DataError(f"image {path} {exc}; remove it or copy it again") from exc
    return width, height


def _depth_size(path: Path) -> tuple[int, int]:
    try:
        return picture_size(read_image_file(path))
    except ValueError as exc:
        raise DataError(f"depth picture {path} {exc}; remove it or copy it again") from exc


def read_pose(image: Path) -> FloatArray | None:
    """T_world_cam (4, 4) from the `*.pose.txt` beside an image; None where there is none or tracking was lost."""
    stem = image.name.split(".")[0]
    path = image.with_name(f"{stem}.pose.txt")
    if not path.exists():
        return None
    try:
        T = np.loadtxt(io.StringIO(read_text(path)), dtype=np.float64, ndmin=2)
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); copy it again") from exc
    except ValueError as exc:
        raise DataError(f"{path} is not a 4x4 matrix of numbers; correct or remove it") from exc
    if T.shape != (4, 4):
        raise DataError(f"{path} is not a 4x4 matrix; correct or remove it")
    return se3(orthonormal(T[:3, :3]), T[:3, 3]) if (np.abs(T) < MAX_POSITION).all() else None
