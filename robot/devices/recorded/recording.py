"""What lies in a recording on disk: frames, inertial samples, calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec

from robot.devices.ports import ImuReading
from robot.devices.recorded.images import JPEG_QUALITY, read_size
from shared.advice import install
from shared.bounded import MAX_PICTURE_BYTES, read_file
from shared.calibration import Calibration, CameraCalibration, ImuNoise
from shared.errors import DataError, DeviceUnavailable
from shared.geometry import inverse
from shared.recorded_files import (
    VIDEO_SUFFIXES,
    asl_numbers,
    asl_rows,
    check_readable,
    depth_images,
    exposures_ns,
    image_times_ns,
    images_in_order,
)
from shared.sensor_yaml import (
    number,
    read_bare_camera,
    read_camera,
    read_exposure_ns,
    read_folder_camera,
    read_folder_depth,
    read_imu_noise,
    read_mounting,
    read_rig,
    read_yaml,
)

MAX_VIDEO_FRAMES = 1_000_000


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """An image on disk and the sensor time it was taken at."""

    t_robot_ns: int
    path: Path  # the image, or the file it is in
    exposure_ns: int = 0  # 0: not known
    read: Callable[[], bytes] | None = None  # None: the file is the image

    def encoded(self) -> bytes:
        """The image, JPEG or PNG. Raises DataError naming the file that cannot be read."""
        if self.read is not None:
            return self.read()
        try:
            return read_file(self.path, MAX_PICTURE_BYTES)
        except OSError as exc:
            raise DataError(f"image {self.path} cannot be read ({exc.strerror}); copy it again") from exc


@dataclass(frozen=True, slots=True)
class Recording:
    """One recorded drive. Frames or samples may be absent, not both."""

    path: Path
    calibration: Calibration
    frames: tuple[RecordedFrame, ...]
    samples: tuple[ImuReading, ...]
    remarks: tuple[str, ...]  # what is missing, in sentences
    depth: tuple[RecordedFrame, ...] = ()  # PNG files, as the calibration's depth sensor made them

    @property
    def first_ns(self) -> int:
        return min(times[0] for times in self._times() if times)

    @property
    def period_ns(self) -> int:
        """After which the recording may begin anew: its length and one step of its slower sensor."""
        steps = [(times[-1] - times[0]) // (len(times) - 1) for times in self._times() if len(times) > 1]
        last_ns = max(times[-1] for times in self._times() if times)
        return last_ns - self.first_ns + max(steps, default=33_000_000)

    def _times(self) -> tuple[list[int], list[int]]:
        return [f.t_robot_ns for f in self.frames], [s.t_robot_ns for s in self.samples]


def open_recording(path: Path) -> Recording:
    """Open an ASL folder (`mav0/...`), a folder of images or a video with `camera.yaml`, or an MCAP recording.

    Raises:
        DataError: names the file and the remedy.
    """
    if not path.exists():
        raise DataError(f"{path} does not exist; give the folder or file of a recorded drive to --dataset")
    if not path.is_dir():
        return _open_file(path)
    if (path / "mav0").is_dir():
        return _open_asl(path)
    if path.name == "mav0":
        return _open_asl(path.parent)
    return _open_images(path)


def _open_file(path: Path) -> Recording:
    check_readable(path)
    suffix = path.suffix.lower()
    if suffix != ".mcap" and suffix not in VIDEO_SUFFIXES:
        raise DataError(
            f"{path} is a file, but neither an .mcap recording nor a video ({', '.join(sorted(VIDEO_SUFFIXES))}); "
            "--dataset needs one of these, an ASL folder or a folder of images"
        )
    try:  # files need libraries that folders do not
        return _open_mcap(path) if suffix == ".mcap" else _open_video(path)
    except ImportError as exc:
        extra = "station" if suffix == ".mcap" else "simulation"
        raise DeviceUnavailable(
            f"this kind of recording needs {exc.name}, which is not installed; run: {install(extra)}"
        ) from exc


def _open_asl(path: Path) -> Recording:
    mav, remarks = path / "mav0", []
    camera_yaml, imu_yaml = mav / "cam0" / "sensor.yaml", mav / "imu0" / "sensor.yaml"
    has_camera = camera_yaml.exists()
    content = read_yaml(camera_yaml) if has_camera else {}
    frames = tuple(_read_frames(mav / "cam0", read_exposure_ns(content, camera_yaml)))
    samples = tuple(_read_samples(mav / "imu0" / "data.csv"))
    if not frames and not samples:
        raise DataError(f"{path} holds neither images (mav0/cam0/data) nor IMU samples (mav0/imu0); nothing to play")
    if not frames:
        remarks.append(f"{path} holds no images; only its IMU is played")
    if not samples:
        remarks.append(f"{path} holds no IMU samples; only its images are played")
    if frames and not has_camera:
        raise DataError(f"{camera_yaml} is missing; the camera's intrinsics belong there")
    camera, imu = read_camera(camera_yaml, content) if has_camera else None, None
    gravity, kind = number(content, "gravity", 9.81, camera_yaml), str(content.get("robot_kind", "generic"))
    if samples:
        imu, camera = _place_on_imu(imu_yaml, camera)
    rig = read_rig(content, camera_yaml)
    calibration = Calibration(camera=camera, imu=imu, robot_kind=kind, gravity=gravity, rig=rig)
    return Recording(path, calibration, frames, samples, tuple(remarks))


def _place_on_imu(path: Path, camera: CameraCalibration | None) -> tuple[ImuNoise, CameraCalibration | None]:
    """IMU noise, and the camera's pose relative to the IMU: our body is the IMU, the file's may be elsewhere."""
    content = read_yaml(path) if path.exists() else {}
    if camera is not None:
        T_imu_cam = inverse(read_mounting(content, path)) @ camera.T_body_cam_matrix
        camera = msgspec.structs.replace(camera, T_body_cam=tuple(T_imu_cam.ravel().tolist()))
    return read_imu_noise(path, content), camera


def _read_frames(folder: Path, default_exposure_ns: int) -> Iterator[RecordedFrame]:
    """Nothing where there is no list, or no image at all (only the trajectory was kept)."""
    data = folder / "data"
    if not (folder / "data.csv").exists() or not data.is_dir() or not any(data.iterdir()):
        return
    path = folder / "data.csv"
    rows = list(asl_rows(path, 1))
    exposures = exposures_ns(path, ((line, cells) for line, _, cells in rows), default_exposure_ns)
    for (line_number, t_ns, cells), exposure_ns in zip(rows, exposures, strict=True):
        image = data / cells[0].strip()
        if not image.is_file():
            raise DataError(f"{path} line {line_number} names {cells[0].strip()}, which is not in data/")
        yield RecordedFrame(t_ns, image, exposure_ns)


def _read_samples(path: Path) -> Iterator[ImuReading]:
    if not path.exists():
        return
    for sequence, (t_ns, values) in enumerate(asl_numbers(path, 6)):
        wx, wy, wz, ax, ay, az = values
        yield ImuReading(sequence, t_ns, (wx, wy, wz), (ax, ay, az))


def _open_images(path: Path) -> Recording:
    numbered = images_in_order(path)
    if not numbered:
        raise DataError(f"{path} holds no mav0 folder and no *.jpg or *.png images; give a recorded drive to --dataset")
    an_image = RecordedFrame(0, numbered[0][1])
    camera = read_folder_camera(path, lambda: read_size(an_image.encoded(), an_image.path))
    times = image_times_ns([number for number, _ in numbered], camera.rate_hz, path)
    frames = tuple(RecordedFrame(t_ns, image) for t_ns, (_, image) in zip(times, numbered, strict=True))
    pictures = depth_images(path)
    depth = tuple(
        RecordedFrame(t_ns, pictures[number])
        for t_ns, (number, _) in zip(times, numbered, strict=True)
        if number in pictures
    )
    sensor = read_folder_depth(path, lambda: read_size(depth[0].encoded(), depth[0].path)) if depth else None
    remarks = (f"{path} holds no IMU samples; only its images are played",)
    if sensor is None:
        return Recording(path, Calibration(camera=camera, imu=None), frames, (), remarks)
    return Recording(path, Calibration(camera=camera, imu=None, depth=sensor), frames, (), remarks, depth)


def _open_mcap(path: Path) -> Recording:
    """Open an MCAP recording. Raises DataError where it is not one of ours, or holds nothing to play."""
    from shared.mcap_recording import HELLO_TOPIC, McapContent, mcap_depth, mcap_images

    content = McapContent(path)
    if content.hello is None:
        raise DataError(f"{path} holds no {HELLO_TOPIC}; only recordings made by a station can be played")
    if not content.frames and not content.samples:
        raise DataError(f"{path} holds neither images nor IMU samples; nothing to play")
    images = _InOrder(lambda: mcap_images(path))
    frames = tuple(
        RecordedFrame(t_ns, path, exposure_ns, partial(images.read, number))
        for number, (t_ns, exposure_ns) in enumerate(content.frames)
    )
    pictures = _InOrder(lambda: mcap_depth(path))
    depth = tuple(
        RecordedFrame(t_ns, path, 0, partial(pictures.read, number)) for number, t_ns in enumerate(content.depth_times)
    )
    samples = tuple(
        ImuReading(sequence, t_ns, (wx, wy, wz), (ax, ay, az))
        for sequence, (t_ns, (wx, wy, wz, ax, ay, az)) in enumerate(content.samples)
    )
    remarks = [f"{content.unusable_samples} IMU samples of {path} are no numbers and are left out"]
    return Recording(
        path, content.hello.calibration, frames, samples, tuple(remarks if content.unusable_samples else ()), depth
    )


def _open_video(path: Path) -> Recording:
    """Open a video; frame k is taken k / rate after 0. Raises DataError naming the file and the remedy."""
    import cv2

    yaml_path = next((p for p in (path.with_suffix(".yaml"), path.with_name("camera.yaml")) if p.exists()), None)
    if yaml_path is None:
        raise DataError(f"{path} has no camera.yaml next to it; write the camera's intrinsics there")
    camera = read_bare_camera(yaml_path)
    video = cv2.VideoCapture(str(path))
    rate_hz, count = video.get(cv2.CAP_PROP_FPS), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    size = (int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    video.release()
    if not (0 < count <= MAX_VIDEO_FRAMES and rate_hz > 0):
        raise DataError(f"{path} cannot be decoded as a video; convert it to MP4 (H.264)")
    if size != (camera.width, camera.height):
        raise DataError(
            f"{path} is {size[0]}x{size[1]} but {yaml_path} says {camera.width}x{camera.height}; correct it"
        )
    images = _InOrder(lambda: _video_images(path))
    frames = tuple(RecordedFrame(round(k * 1e9 / rate_hz), path, 0, partial(images.read, k)) for k in range(count))
    remarks = (f"{path} holds no IMU samples; only its images are played",)
    return Recording(path, Calibration(camera=camera, imu=None), frames, (), remarks)


def _video_images(path: Path) -> Iterator[bytes]:
    import cv2

    video = cv2.VideoCapture(str(path))
    try:
        while True:
            ok, image = video.read()
            if not ok:
                return
            yield bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])
    finally:
        video.release()


class _InOrder:
    """Images by number from a source that only gives them in order: cheap where numbers rise."""

    def __init__(self, begin: Callable[[], Iterator[bytes]]) -> None:
        self._begin = begin
        self._images = begin()
        self._next = 0

    def read(self, number: int) -> bytes:
        """The image of this number, from 0. Raises DataError where the source ends before it."""
        if number < self._next:
            self._images, self._next = self._begin(), 0
        for encoded in self._images:
            self._next += 1
            if self._next > number:
                return encoded
        raise DataError(f"image {number} is missing at the recording's end; record again")
