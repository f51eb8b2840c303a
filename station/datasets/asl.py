"""EuRoC/ASL folders: `mav0/cam0`, `mav0/imu0`, `mav0/state_groundtruth_estimate0`, and our `mav0/drive0`.

Format: Burri et al., The EuRoC micro aerial vehicle datasets, IJRR 2016. `drive0/data.csv` is ours:
`#timestamp [ns],linear [m/s],angular [rad/s],pan [rad],tilt [rad]`, the velocities the motors were told to hold from
that time on, and the angles that the servos of the camera's head were told then; the last two may be absent.
`drive0/head.yaml` tells where the head's axes are.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from shared.bounded import MAX_PICTURE_BYTES, read_file
from shared.calibration import Calibration, HeadCalibration
from shared.errors import ConfigError, DataError
from shared.geometry import FloatArray, IntArray, inverse, poses
from shared.recorded_files import asl_numbers, asl_rows, exposures_ns
from shared.sensor_yaml import number, read_camera, read_exposure_ns, read_imu_noise, read_mounting, read_rig, read_yaml
from shared.text import explain
from station.datasets.dataset import Dataset, Truth, choose_frames, cut_to_frames
from station.model.frames import DriveSample, ImageFrame, ImuBatch


def open_asl(path: Path, first: int | None, last: int | None, step: int, needs_camera: bool = True) -> Dataset:
    """Open an ASL folder; images, IMU, drive commands and truth may each be absent."""
    mav = path / "mav0"
    imu_csv, camera_csv = mav / "imu0" / "data.csv", mav / "cam0" / "data.csv"
    if not imu_csv.exists() and not camera_csv.exists():
        raise DataError(f"{mav} holds neither cam0/data.csv nor imu0/data.csv; give a complete ASL folder")

    camera = None
    camera_yaml: dict[str, object] = {}
    if camera_csv.exists() or (mav / "cam0" / "sensor.yaml").exists():
        yaml_path = mav / "cam0" / "sensor.yaml"
        if yaml_path.exists():
            camera_yaml = read_yaml(yaml_path)
            camera = read_camera(yaml_path, camera_yaml)
        elif needs_camera:
            raise DataError(f"{yaml_path} is missing; the camera's intrinsics belong there")

    imu, noise, T_body_imu = None, None, np.eye(4)
    if imu_csv.exists():
        imu = _read_imu(imu_csv)
        yaml_path = mav / "imu0" / "sensor.yaml"
        content = read_yaml(yaml_path) if yaml_path.exists() else {}
        noise = read_imu_noise(yaml_path, content)
        T_body_imu = read_mounting(content, yaml_path)
    drive = _read_drive(mav / "drive0" / "data.csv")
    head = _read_head(mav / "drive0" / "head.yaml", drive)

    # Our body is the IMU; without IMU and drive commands nothing but the camera is left to be the body.
    T_ours_file = inverse(T_body_imu)
    if camera is not None:
        T_file_cam = camera.T_body_cam_matrix
        if imu is None and not drive:
            T_ours_file = inverse(T_file_cam)
        camera = msgspec.structs.replace(camera, T_body_cam=tuple((T_ours_file @ T_file_cam).ravel().tolist()))
    truth = _read_truth(mav / "state_groundtruth_estimate0" / "data.csv", inverse(T_ours_file))

    default_exposure_ns = read_exposure_ns(camera_yaml, mav / "cam0" / "sensor.yaml")
    times, names, exposures = np.empty(0, np.int64), list[str](), list[int]()
    if camera_csv.exists():
        times, names, exposures = _read_frame_list(camera_csv, default_exposure_ns)
    chosen = choose_frames(camera_csv, range(len(times)), first, last, step)
    times, names, exposures = times[chosen], [names[i] for i in chosen], [exposures[i] for i in chosen]
    if len(times) and (first is not None or last is not None):
        imu, drive = cut_to_frames(imu, drive, times)
    image_folder = mav / "cam0" / "data"
    has_images = bool(names) and image_folder.is_dir() and any(image_folder.iterdir())
    if not has_images and imu is None:
        raise DataError(f"{path} holds neither images (mav0/cam0/data) nor IMU samples (mav0/imu0); nothing to use")

    gravity = number(camera_yaml, "gravity", 9.81, mav / "cam0" / "sensor.yaml")
    kind = str(camera_yaml.get("robot_kind", "sentinel" if drive else "generic"))  # only ours record commands
    rig = read_rig(camera_yaml, mav / "cam0" / "sensor.yaml")

    def read_frames() -> Iterator[ImageFrame]:
        for index, (t_ns, name, exposure_ns) in enumerate(zip(times, names, exposures, strict=True)):
            yield ImageFrame(index, int(t_ns), exposure_ns, read_image_file(image_folder / name), name)

    return Dataset(
        path=path,
        kind="asl",
        calibration=Calibration(camera=camera, imu=noise, robot_kind=kind, gravity=gravity, rig=rig, head=head),
        intrinsics_known=not bool(camera_yaml.get("approximate", False)),
        frame_times_ns=times,
        read_frames=read_frames if has_images else None,
        imu=imu,
        drive=drive,
        truth=truth,
    )


def read_image_file(path: Path) -> bytes:
    """The bytes of an image file. Raises DataError where it is missing or empty."""
    try:
        encoded = read_file(path, MAX_PICTURE_BYTES)
    except OSError as exc:
        raise DataError(f"image {path} cannot be read ({exc.strerror}); restore it or take it off the list") from exc
    if not encoded:
        raise DataError(f"image {path} is empty; remove it or copy it again")
    return encoded


def _read_table(path: Path, columns: int) -> tuple[IntArray, FloatArray]:
    """Times (N,) ns and the next `columns` columns (N, columns). Times need all 64 bits, so they are parsed apart."""
    times, values = array("q"), array("d")  # an eighth of what lists take: hours of an IMU have millions of rows
    for t_ns, row in asl_numbers(path, columns):
        times.append(t_ns)
        values.extend(row)
    return np.array(times, dtype=np.int64), np.array(values, dtype=np.float64).reshape(-1, columns)


def _read_imu(path: Path) -> ImuBatch | None:
    t, table = _read_table(path, 6)
    if not len(t):
        return None
    return ImuBatch(t, np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3:]))


def _read_drive(path: Path) -> tuple[DriveSample, ...]:
    if not path.exists():
        return ()
    first = next(asl_rows(path, 2), None)
    has_head = first is not None and len(first[2]) >= 4
    t, table = _read_table(path, 4 if has_head else 2)
    return tuple(DriveSample(int(ns), *row) for ns, row in zip(t, table.tolist(), strict=True))


def _read_head(path: Path, drive: tuple[DriveSample, ...]) -> HeadCalibration | None:
    """The head that carries the camera; None where none was turned, or nothing is known of one."""
    if not path.exists() or not any(d.pan_rad or d.tilt_rad for d in drive):
        return None
    try:
        return msgspec.convert(read_yaml(path), HeadCalibration)
    except (msgspec.ValidationError, ConfigError) as exc:
        raise DataError(f"{path}: {explain(exc)}; correct it") from exc


def _read_truth(path: Path, T_file_ours: FloatArray) -> Truth | None:
    """Columns: t, p (3), q wxyz (4), and in EuRoC's own v (3), gyro bias (3), accel bias (3)."""
    if not path.exists():
        return None
    t, table = _read_table(path, 7)
    if not len(t):
        return None
    try:
        T = poses(table[:, :3], table[:, 3:7]) @ T_file_ours
    except ValueError as exc:
        raise DataError(f"{path}: {exc}; correct it") from exc
    try:
        _, states = _read_table(path, 16)
    except DataError:
        return Truth(t, T)  # poses only
    return Truth(t, T, states[:, 7:10], states[:, 10:13], states[:, 13:16])


def _read_frame_list(path: Path, default_exposure_ns: int) -> tuple[IntArray, list[str], list[int]]:
    """Times (F,), file names and exposures (ns)."""
    rows = list(asl_rows(path, 1))
    exposures = exposures_ns(path, ((line, cells) for line, _, cells in rows), default_exposure_ns)
    times = np.array([t_ns for _, t_ns, _ in rows], dtype=np.int64)
    return times, [cells[0].strip() for _, _, cells in rows], exposures
