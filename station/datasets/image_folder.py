"""A folder of images with `camera.yaml` or `camera-intrinsics.txt`, optional `*.pose.txt` (T_world_cam)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.errors import DataError
from shared.geometry import FloatArray, orthonormal, se3
from shared.recorded_files import image_times_ns, images_in_order
from shared.sensor_yaml import read_camera, read_intrinsics_text, read_yaml
from station.datasets.asl import read_image_file
from station.datasets.dataset import Dataset, Truth, choose_frames
from station.model.frames import ImageFrame

DEFAULT_RATE_HZ = 30.0  # 7-Scenes: Kinect at 30 Hz; frames are numbered, so gaps keep their length


def open_image_folder(path: Path, first: int | None, last: int | None, step: int) -> Dataset:
    """Open a folder of images. Times are frame number / rate from 0 on, or the stamps the images are named by."""
    numbered = images_in_order(path)
    numbers, files = [number for number, _ in numbered], [file for _, file in numbered]
    if not files:
        raise DataError(f"{path} holds no mav0 folder and no *.jpg or *.png images; give a dataset")
    chosen = choose_frames(path, numbers, first, last, step)
    camera, known = _read_calibration(path, files[chosen[0]])
    files = [files[i] for i in chosen]
    times = np.array(image_times_ns(numbers, camera.rate_hz, path), dtype=np.int64)[chosen]

    def read_frames() -> Iterator[ImageFrame]:
        for index, (t_ns, file) in enumerate(zip(times, files, strict=True)):
            yield ImageFrame(index, int(t_ns), 0, read_image_file(file), file.name)

    poses = [read_pose(file) for file in files]
    has_pose = [i for i, pose in enumerate(poses) if pose is not None]
    truth = Truth(times[has_pose], np.stack([p for p in poses if p is not None])) if has_pose else None
    return Dataset(
        path=path,
        kind="images",
        calibration=Calibration(camera=camera, imu=None),
        intrinsics_known=known,
        frame_times_ns=times,
        read_frames=read_frames,
        truth=truth,
    )


def _read_calibration(path: Path, an_image: Path) -> tuple[CameraCalibration, bool]:
    """Camera, and whether its intrinsics can be trusted. Without IMU the body is the camera: no mounting."""
    yaml_path, text_path = path / "camera.yaml", path / "camera-intrinsics.txt"
    if yaml_path.is_file():
        return read_bare_camera(yaml_path)
    if not text_path.is_file():
        raise DataError(f"{path} has no camera.yaml (or camera-intrinsics.txt); write the camera's intrinsics there")
    K = read_intrinsics_text(text_path)
    image = cv2.imdecode(np.frombuffer(read_image_file(an_image), np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise DataError(f"image {an_image} is not a readable JPEG or PNG; remove it or copy it again")
    height, width = image.shape[:2]
    camera = CameraCalibration(
        width=width, height=height, fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2], rate_hz=DEFAULT_RATE_HZ
    )
    return camera, False  # three by three numbers without distortion are a guess


def read_bare_camera(yaml_path: Path) -> tuple[CameraCalibration, bool]:
    """A camera that is itself the body, and whether its intrinsics can be trusted (no `approximate: true`)."""
    content = read_yaml(yaml_path)
    unmounted = {key: value for key, value in content.items() if key not in ("T_BS", "T_body_cam")}
    return read_camera(yaml_path, unmounted), not bool(content.get("approximate", False))


def read_pose(image: Path) -> FloatArray | None:
    """T_world_cam (4, 4) from the `*.pose.txt` beside an image; None where there is none or tracking was lost."""
    stem = image.name.split(".")[0]
    path = image.with_name(f"{stem}.pose.txt")
    if not path.is_file():
        return None
    try:
        T = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (OSError, ValueError) as exc:
        raise DataError(f"{path} is not a 4x4 matrix of numbers; correct or remove it") from exc
    if T.shape != (4, 4):
        raise DataError(f"{path} is not a 4x4 matrix; correct or remove it")
    return se3(orthonormal(T[:3, :3]), T[:3, 3]) if np.isfinite(T).all() else None
