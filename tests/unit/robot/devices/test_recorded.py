"""Recordings played as a robot: every datum, in order, with its own time."""

from __future__ import annotations

import asyncio
import logging
import os
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from robot.devices.ports import DeviceSet, EndOfRecording, ImuReading
from robot.devices.recorded import open_recorded
from robot.devices.recorded.images import read_size, to_jpeg
from shared.calibration import REFERENCE_ROBOT
from shared.errors import DataError, DeviceLost
from shared.messages import CameraFrame, Capabilities, Hello, ImuBatch, ImuSample
from station.recordings.recorder import Recorder

START_NS = 1_403_715_283_262_142_976
CAMERA_YAML = """%YAML:1.0
T_BS: {cols: 4, rows: 4, data: [1,0,0,0.1, 0,1,0,0, 0,0,1,0, 0,0,0,1]}
rate_hz: 20
resolution: [64, 48]
intrinsics: [60.0, 60.0, 32.0, 24.0]
distortion_model: radial-tangential
distortion_coefficients: [0.1, 0.0, 0.0, 0.0]
"""
IMU_YAML = "rate_hz: 200\ngyroscope_noise_density: 1.0e-4\n"


def picture(number: int, suffix: str) -> bytes:
    image = np.full((48, 64, 3), number * 10 % 256, np.uint8)
    return bytes(cv2.imencode(suffix, image)[1])


def write_asl(root: Path, frames: int = 5, samples: int = 40, suffix: str = ".png") -> Path:
    """A flight of some frames at 20 Hz and samples at 200 Hz, the IMU 50 ms earlier."""
    cam, imu = root / "mav0" / "cam0", root / "mav0" / "imu0"
    (cam / "data").mkdir(parents=True)
    imu.mkdir()
    (cam / "sensor.yaml").write_text(CAMERA_YAML)
    (imu / "sensor.yaml").write_text(IMU_YAML)
    times = [START_NS + 50_000_000 * (k + 1) for k in range(frames)]
    (cam / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{t},{t}{suffix}\n" for t in times))
    for k, t in enumerate(times):
        (cam / "data" / f"{t}{suffix}").write_bytes(picture(k, suffix))
    rows = [f"{START_NS + 5_000_000 * k},0.1,0.2,{k},0,0,9.81\n" for k in range(samples)]
    (imu / "data.csv").write_text("#timestamp [ns],wx,wy,wz,ax,ay,az\n" + "".join(rows))
    return root


async def play(devices: DeviceSet) -> tuple[list[int], list[ImuReading]]:
    """All frame times and samples until the end."""

    async def frames() -> list[int]:
        times: list[int] = []
        assert devices.camera is not None
        try:
            while True:
                times.append((await devices.camera.capture()).t_robot_ns)
        except EndOfRecording:
            return times

    async def readings() -> list[ImuReading]:
        found: list[ImuReading] = []
        assert devices.imu is not None
        try:
            while True:
                found += await devices.imu.read()
        except EndOfRecording:
            return found

    return await asyncio.gather(frames(), readings())


async def test_every_frame_and_sample_comes_once_with_its_own_time(tmp_path: Path) -> None:
    devices = open_recorded(write_asl(tmp_path), speed=100)
    times, readings = await play(devices)
    assert times == [START_NS + 50_000_000 * (k + 1) for k in range(5)]
    assert [r.sequence for r in readings] == list(range(40))
    assert [r.t_robot_ns for r in readings] == [START_NS + 5_000_000 * k for k in range(40)]
    assert readings[7].gyro_imu == (0.1, 0.2, 7.0)


async def test_data_come_at_their_time_on_the_recordings_clock(tmp_path: Path) -> None:
    now_ns = [500]
    devices = open_recorded(write_asl(tmp_path), now_ns=lambda: now_ns[0])
    assert devices.imu is not None
    assert devices.clock() == START_NS
    assert len(await devices.imu.read()) == 1
    now_ns[0] += 102_000_000
    assert devices.clock() == START_NS + 102_000_000
    assert [r.sequence for r in await devices.imu.read()] == list(range(1, 21))


async def test_a_loop_goes_on_with_increasing_times_and_numbers(tmp_path: Path) -> None:
    devices = open_recorded(write_asl(tmp_path), speed=100, at_end="loop")
    assert devices.camera is not None and devices.imu is not None
    times = [(await devices.camera.capture()).t_robot_ns for _ in range(15)]
    readings: list[ImuReading] = []
    while len(readings) < 120:
        readings += await devices.imu.read()
    stamps = [r.t_robot_ns for r in readings]
    assert times[:5] == [START_NS + 50_000_000 * (k + 1) for k in range(5)]
    assert all(b > a for a, b in pairwise(times))
    assert all(b > a for a, b in pairwise(stamps))
    assert times[5] - times[0] == stamps[40] - stamps[0]  # both sensors begin anew together
    assert [r.sequence for r in readings] == list(range(len(readings)))


async def test_png_is_sent_as_a_good_jpeg_and_jpeg_as_it_is(tmp_path: Path) -> None:
    png = open_recorded(write_asl(tmp_path / "png"), speed=100)
    jpg = open_recorded(write_asl(tmp_path / "jpg", suffix=".jpg"), speed=100)
    assert png.camera is not None and jpg.camera is not None
    frame = await png.camera.capture()
    assert frame.jpeg.startswith(b"\xff\xd8") and (frame.width, frame.height) == (64, 48)
    assert (await jpg.camera.capture()).jpeg == picture(0, ".jpg")


def test_jpeg_sizes_are_read_from_any_header() -> None:
    image = np.zeros((33, 77), np.uint8)
    for flags in ([], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 4]):
        assert read_size(bytes(cv2.imencode(".jpg", image, flags)[1]), Path("x")) == (77, 33)
    for broken in (b"", b"\xff\xd8", b"\xff\xd8\xff\xe0\x00\x10", b"GIF89a", b"\xff\xd8\xff\xff\xff\xff"):
        with pytest.raises(DataError, match="not a readable JPEG or PNG"):
            read_size(broken, Path("x"))


def test_a_png_that_cannot_be_decoded_is_named() -> None:
    with pytest.raises(DataError, match=r"broken\.png is not a readable"):
        to_jpeg(b"\x89PNG\r\n\x1a\n" + bytes(40), Path("broken.png"))


async def test_a_broken_image_is_passed_over_and_named(tmp_path: Path) -> None:
    root = write_asl(tmp_path)
    broken = sorted((root / "mav0" / "cam0" / "data").iterdir())[1]
    broken.write_bytes(b"no image")
    devices = open_recorded(root, speed=100)
    assert devices.camera is not None
    first = await devices.camera.capture()
    with pytest.raises(DeviceLost, match=broken.name):
        await devices.camera.capture()
    assert (await devices.camera.capture()).t_robot_ns == first.t_robot_ns + 100_000_000


def test_calibration_comes_from_the_recording(tmp_path: Path) -> None:
    calibration = open_recorded(write_asl(tmp_path)).calibration
    assert calibration.camera is not None and calibration.imu is not None
    assert (calibration.camera.width, calibration.camera.fx) == (64, 60.0)
    assert calibration.camera.T_body_cam[3] == pytest.approx(0.1)
    assert calibration.imu.gyro_density == 1e-4


def test_missing_images_or_imu_are_said_and_the_rest_is_played(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    root = write_asl(tmp_path / "imu_only")
    for image in (root / "mav0" / "cam0" / "data").iterdir():
        image.unlink()
    devices = open_recorded(root)
    assert devices.camera is None and devices.imu is not None
    assert "holds no images" in caplog.text
    root = write_asl(tmp_path / "images_only")
    (root / "mav0" / "imu0" / "data.csv").unlink()
    devices = open_recorded(root)
    assert devices.camera is not None and devices.imu is None
    assert "holds no IMU samples" in caplog.text


async def test_a_folder_of_images_is_played_at_its_rate(tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(CAMERA_YAML)
    for k in (2, 10, 4):
        (tmp_path / f"frame-{k:06d}.color.jpg").write_bytes(picture(k, ".jpg"))
    devices = open_recorded(tmp_path, speed=100)
    assert devices.camera is not None and devices.imu is None
    times = [(await devices.camera.capture()).t_robot_ns for _ in range(3)]
    assert times == [100_000_000, 200_000_000, 500_000_000]
    with pytest.raises(EndOfRecording):
        await devices.camera.capture()


async def test_each_frame_keeps_the_exposure_that_was_recorded(tmp_path: Path) -> None:
    root = write_asl(tmp_path)
    table = root / "mav0" / "cam0" / "data.csv"
    head, *lines = table.read_text().splitlines()
    table.write_text("\n".join([head, *(f"{line},{1000 * k}" for k, line in enumerate(lines))]) + "\n")
    devices = open_recorded(root, speed=100)
    assert devices.camera is not None
    assert [(await devices.camera.capture()).exposure_ns for _ in range(3)] == [0, 1000, 2000]


async def test_images_named_by_their_stamps_are_played_at_these_times(tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(CAMERA_YAML)
    for k in range(2):
        (tmp_path / f"{START_NS + 1000 * k}.jpg").write_bytes(picture(k, ".jpg"))
    devices = open_recorded(tmp_path, speed=100)
    assert devices.camera is not None
    assert [(await devices.camera.capture()).t_robot_ns for _ in range(2)] == [START_NS, START_NS + 1000]


def test_sixteen_bit_images_keep_their_brightness() -> None:
    dark, bright = np.full((48, 64), 40 << 8, np.uint16), np.full((48, 64, 3), 200 << 8, np.uint16)
    for image, value in ((dark, 40), (bright, 200)):
        png = bytes(cv2.imencode(".png", image)[1])
        shown = cv2.imdecode(np.frombuffer(to_jpeg(png, Path("x.png")), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert abs(float(shown.mean()) - value) < 2


async def test_a_stations_recording_is_played_as_the_robot_it_was_made_of(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(
        Hello(
            protocol=2, robot_id="r", name="R", session_id="s", calibration=REFERENCE_ROBOT,
            capabilities=Capabilities(
                camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False
            ),
        )
    )  # fmt: skip
    samples = tuple(ImuSample(START_NS + 5_000_000 * k, (0.1, 0.2, float(k)), (0.0, 0.0, 9.81)) for k in range(20))
    recorder.on_imu(ImuBatch(first_sequence=0, samples=samples))
    for k in range(3):
        stamp = START_NS + 50_000_000 * k
        recorder.on_frame(
            CameraFrame(
                seq=k, t_robot_ns=stamp, exposure_ns=7 + k, width=64, height=48, skipped=0, jpeg=picture(k, ".jpg")
            ),
            k,
        )
    recorder.close()
    devices = open_recorded(path, speed=100, at_end="loop")
    assert devices.calibration == REFERENCE_ROBOT and devices.camera is not None and devices.imu is not None
    frames = [await devices.camera.capture() for _ in range(4)]
    assert [frame.jpeg for frame in frames] == [picture(k % 3, ".jpg") for k in range(4)]
    assert [frame.exposure_ns for frame in frames] == [7, 8, 9, 7]
    assert [frame.t_robot_ns - START_NS for frame in frames[:3]] == [0, 50_000_000, 100_000_000]
    assert (await devices.imu.read())[0].gyro_imu == (0.1, 0.2, 0.0)


async def test_a_video_is_played_at_its_rate(tmp_path: Path) -> None:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for value in (40, 120, 200):
        writer.write(np.full((48, 64, 3), value, np.uint8))
    writer.release()
    with pytest.raises(DataError, match=r"no camera\.yaml"):
        open_recorded(path)
    (tmp_path / "camera.yaml").write_text(CAMERA_YAML)
    devices = open_recorded(path, speed=100, at_end="loop")
    assert devices.camera is not None and devices.imu is None
    frames = [await devices.camera.capture() for _ in range(5)]
    assert [frame.t_robot_ns for frame in frames] == [50_000_000 * k for k in range(5)]
    brightness = [cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE).mean() for frame in frames]
    assert np.allclose(brightness, [40, 120, 200, 40, 120], atol=6)


def test_files_that_are_no_recording_are_named(tmp_path: Path) -> None:
    for name, said in (("x.mcap", "not an MCAP file"), ("x.avi", "cannot be decoded")):
        (tmp_path / "camera.yaml").write_text(CAMERA_YAML)
        (tmp_path / name).write_bytes(b"something else")
        with pytest.raises(DataError, match=said):
            open_recorded(tmp_path / name)


def break_nothing_there(root: Path) -> Path:
    return root / "nowhere"


def break_a_file(root: Path) -> Path:
    (root / "x.txt").write_text("")
    return root / "x.txt"


def break_empty(root: Path) -> Path:
    (root / "empty").mkdir()
    return root / "empty"


def break_no_sensors(root: Path) -> Path:
    (root / "mav0").mkdir()
    return root


def break_no_yaml(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "cam0" / "sensor.yaml").unlink()
    return root


def break_yaml(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "cam0" / "sensor.yaml").write_text("intrinsics: [1, 2\n")
    return root


def break_missing_image(root: Path) -> Path:
    write_asl(root)
    next((root / "mav0" / "cam0" / "data").iterdir()).unlink()
    return root


def break_imu_numbers(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "imu0" / "data.csv").write_text("5,a,b,c,d,e,f\n")
    return root


def break_imu_columns(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "imu0" / "data.csv").write_text("5,1,2\n")
    return root


def break_order(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "imu0" / "data.csv").write_text("5,1,2,3,4,5,6\n5,1,2,3,4,5,6\n")
    return root


def break_binary(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "imu0" / "data.csv").write_bytes(bytes(range(128, 256)))
    return root


def break_imu_finite(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "imu0" / "data.csv").write_text("5,1,2,nan,4,5,6\n")
    return root


def break_rate(root: Path) -> Path:
    (root / "camera.yaml").write_text(CAMERA_YAML.replace("rate_hz: 20", "rate_hz: 0"))
    (root / "1.jpg").write_bytes(picture(1, ".jpg"))
    return root


def break_stamps(root: Path) -> Path:
    write_asl(root)
    (root / "mav0" / "imu0" / "data.csv").write_text(f"{10**19},1,2,3,4,5,6\n")
    return root


def break_yaml_into_a_pipe(root: Path) -> Path:
    write_asl(root)
    path = root / "mav0" / "cam0" / "sensor.yaml"
    path.unlink()
    os.mkfifo(path)
    return root


def break_list_into_a_device(root: Path) -> Path:
    write_asl(root)
    path = root / "mav0" / "cam0" / "data.csv"
    path.unlink()
    path.symlink_to("/dev/zero")
    return root


@pytest.mark.parametrize(
    ("breaking", "said"),
    [
        (break_yaml_into_a_pipe, r"cam0/sensor\.yaml cannot be read \(it is a pipe, no file\)"),
        (break_list_into_a_device, r"cam0/data\.csv cannot be read \(it is a device, no file\)"),
        (break_nothing_there, "does not exist"),
        (break_a_file, "is a file, but neither"),
        (break_empty, "holds no mav0 folder and no"),
        (break_no_sensors, "holds neither images"),
        (break_no_yaml, "sensor.yaml is missing"),
        (break_yaml, "not readable YAML"),
        (break_missing_image, "which is not in data/"),
        (break_imu_numbers, "line 1 does not hold numbers"),
        (break_imu_columns, "has 3 columns, needs 7"),
        (break_order, "line 2 is not later"),
        (break_binary, "cannot be read"),
        (break_imu_finite, "not finite"),
        (break_rate, "rate_hz is 0"),
        (break_stamps, "no time in ns"),
    ],
)
def test_a_dataset_that_cannot_be_played_is_one_sentence(tmp_path: Path, breaking: object, said: str) -> None:
    assert callable(breaking)
    with pytest.raises(DataError, match=said) as caught:
        open_recorded(breaking(tmp_path))
    assert "\n" not in str(caught.value)
