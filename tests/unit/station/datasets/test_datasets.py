"""Datasets of every kind give the same data, and each damage gets one sentence."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from shared.calibration import Calibration
from shared.errors import DataError
from station.datasets import open_dataset
from station.model.frames import DepthFrame, DriveSample, ImageFrame, ImuBatch
from tests.support.datasets import frames_of, imu_of

CAMERA_YAML = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0, 0, 1, 0.1,  -1, 0, 0, 0,  0, -1, 0, 0.2,  0, 0, 0, 1]
rate_hz: 20
resolution: [64, 48]
intrinsics: [50.0, 51.0, 31.5, 23.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.01, 0.0, 0.0]
time_shift_s: -0.04
line_delay_s: 0.00003
noise: whatever
"""
IMU_YAML = "%YAML:1.0\nrate_hz: 100\ngyroscope_noise_density: 1.0e-04\n"
T0_NS = 1403715273262142976  # more digits than a float holds


def picture(value: int, suffix: str = ".jpg") -> bytes:
    image = np.full((48, 64, 3), value, np.uint8)
    return cv2.imencode(suffix, image)[1].tobytes()


@pytest.fixture
def asl(tmp_path: Path) -> Path:
    """Five frames 50 ms apart, IMU every 10 ms, one drive command at 45 ms, truth."""
    mav = tmp_path / "mav0"
    for folder in ("cam0/data", "imu0", "drive0", "state_groundtruth_estimate0"):
        (mav / folder).mkdir(parents=True)
    (mav / "cam0" / "sensor.yaml").write_text(CAMERA_YAML)
    (mav / "imu0" / "sensor.yaml").write_text(IMU_YAML)
    lines = ["#timestamp [ns],filename"]
    for i in range(5):
        name = f"{i}.jpg"
        (mav / "cam0" / "data" / name).write_bytes(picture(40 * i))
        lines.append(f"{T0_NS + i * 50_000_000},{name}")
    (mav / "cam0" / "data.csv").write_text("\n".join(lines) + "\n")
    imu = [f"{T0_NS + i * 10_000_000},0.1,0.2,0.3,0,0,9.81" for i in range(25)]
    (mav / "imu0" / "data.csv").write_text("#timestamp\n" + "\n".join(imu) + "\n")
    (mav / "drive0" / "data.csv").write_text(
        f"#timestamp [ns],linear [m/s],angular [rad/s]\n{T0_NS + 45_000_000},0.2,0.1\n"
    )
    (mav / "state_groundtruth_estimate0" / "data.csv").write_text(f"#t\n{T0_NS},1,2,3,1,0,0,0\n")
    return tmp_path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for n in (0, 2, 4, 10):
        (tmp_path / f"frame-{n:06d}.color.jpg").write_bytes(picture(n))
        np.savetxt(tmp_path / f"frame-{n:06d}.pose.txt", np.eye(4))
    (tmp_path / "frame-000000.depth.png").write_bytes(picture(0, ".png"))
    (tmp_path / "camera-intrinsics.txt").write_text("525 0 32\n0 525 24\n0 0 1\n")
    return tmp_path


def tipped(asl: Path, accel: str, rig: str = "wheels") -> Path:
    """What carries it is this, and every sample of its accelerometer."""
    csv, yaml = asl / "mav0" / "imu0" / "data.csv", asl / "mav0" / "cam0" / "sensor.yaml"
    csv.write_text(csv.read_text().replace("0,0,9.81", accel))
    yaml.write_text(yaml.read_text() + f"rig: {rig}\n")
    return asl


@pytest.mark.parametrize(("accel", "degrees"), [("9.81,0,0", 90), ("0,0,-9.81", 180), ("0,-8,3", 69)])
def test_wheels_whose_imu_does_not_stand_upright_are_refused(asl: Path, accel: str, degrees: int) -> None:
    with pytest.raises(DataError, match=f"z axis is {degrees} degrees from up") as refused:
        open_dataset(tipped(asl, accel))
    assert "x points forward, y left and z up" in str(refused.value) and "rig: hand-held" in str(refused.value)


@pytest.mark.parametrize(
    ("accel", "rig"), [("3,0,9.3", "wheels"), ("0,0,0", "wheels"), ("1e9,0,0", "wheels"), ("9.81,0,0", "hand-held")]
)
def test_ramps_sensors_that_measure_nothing_and_hands_are_not_refused(asl: Path, accel: str, rig: str) -> None:
    assert open_dataset(tipped(asl, accel, rig)).calibration.rig == rig


def test_asl_folder_gives_everything_with_exact_times(asl: Path) -> None:
    data = open_dataset(asl)
    assert data.frame_times_ns.tolist() == [T0_NS + i * 50_000_000 for i in range(5)]
    camera = data.calibration.camera
    assert camera is not None and (camera.fx, camera.cy) == (50.0, 23.5)
    assert (camera.time_shift_s, camera.line_delay_s) == (-0.04, 0.00003)
    np.testing.assert_allclose(camera.T_body_cam_matrix[:3, 3], [0.1, 0, 0.2])
    assert data.calibration.imu is not None and data.calibration.imu.gyro_density == 1e-4
    assert imu_of(data).t_robot_ns[1] == T0_NS + 10_000_000
    assert data.drive == (DriveSample(T0_NS + 45_000_000, 0.2, 0.1),)
    truth = data.truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_body[0, :3, 3], [1, 2, 3])


def test_events_come_in_sensor_time_order_and_lose_nothing(asl: Path) -> None:
    last, frames, samples, commands = 0, 0, 0, 0
    for event in open_dataset(asl).events():
        begin = int(event.t_robot_ns[0]) if isinstance(event, ImuBatch) else event.t_robot_ns
        assert begin >= last
        last = int(event.t_robot_ns[-1]) if isinstance(event, ImuBatch) else event.t_robot_ns
        frames += isinstance(event, ImageFrame)
        commands += isinstance(event, DriveSample)
        samples += len(event) if isinstance(event, ImuBatch) else 0
    assert (frames, samples, commands) == (5, 25, 1)


@pytest.mark.parametrize("shift_ms", [-40, 0, 25])
def test_a_frame_comes_after_what_was_measured_until_it_was_taken(asl: Path, shift_ms: int) -> None:
    """Also of a camera whose stamps are early: without the IMU up to its exposure nobody can say where it was then."""
    data = open_dataset(asl)
    camera = data.calibration.camera
    times = imu_of(data).t_robot_ns
    assert camera is not None
    shifted = msgspec.structs.replace(camera, time_shift_s=shift_ms / 1e3, line_delay_s=0.0)
    data = replace(data, calibration=msgspec.structs.replace(data.calibration, camera=shifted))
    heard = 0
    for event in data.events():
        if isinstance(event, ImuBatch):
            heard += len(event)
        elif isinstance(event, ImageFrame):
            until = event.t_robot_ns + max(shift_ms, 0) * 1_000_000
            assert heard == np.count_nonzero(times <= until)


def test_range_cuts_frames_and_keeps_inertial_margin(asl: Path) -> None:
    data = open_dataset(asl, first=1, last=3, step=2)
    assert [frame.name for frame in frames_of(data)] == ["1.jpg", "3.jpg"]
    assert [frame.index for frame in frames_of(data)] == [0, 1]
    assert len(imu_of(data)) == 25


def test_images_may_be_absent(asl: Path) -> None:
    for image in (asl / "mav0" / "cam0" / "data").iterdir():
        image.unlink()
    data = open_dataset(asl)
    assert not data.has_images and len(data.frame_times_ns) == 5


def test_imu_may_be_absent(asl: Path) -> None:
    (asl / "mav0" / "imu0" / "data.csv").unlink()
    data = open_dataset(asl)
    assert data.imu is None


def test_without_imu_and_drive_the_camera_is_the_body(asl: Path) -> None:
    (asl / "mav0" / "imu0" / "data.csv").unlink()
    (asl / "mav0" / "drive0" / "data.csv").unlink()
    data = open_dataset(asl)
    truth = data.truth
    assert data.calibration.camera is not None and truth is not None
    np.testing.assert_array_equal(data.calibration.camera.T_body_cam_matrix, np.eye(4))
    np.testing.assert_allclose(truth.T_world_body[0, :3, 3], [1.1, 2, 3.2])


def test_image_folder_uses_the_numbers_in_the_names(folder: Path) -> None:
    data = open_dataset(folder, first=2, last=10)
    assert [f.name for f in frames_of(data)] == [f"frame-{n:06d}.color.jpg" for n in (2, 4, 10)]
    assert data.frame_times_ns.tolist() == [round(n / 30 * 1e9) for n in (2, 4, 10)]
    assert not data.intrinsics_known
    truth = data.truth
    assert truth is not None and len(truth) == 3
    assert data.calibration.camera is not None and data.calibration.camera.width == 64


def test_images_named_by_their_stamps_have_these_times(tmp_path: Path) -> None:
    for k in range(3):
        (tmp_path / f"{T0_NS + k * 50_000_000}.png").write_bytes(picture(k, ".png"))
    (tmp_path / "camera-intrinsics.txt").write_text("525 0 32\n0 525 24\n0 0 1\n")
    assert open_dataset(tmp_path).frame_times_ns.tolist() == [T0_NS + k * 50_000_000 for k in range(3)]
    (tmp_path / f"{10**25}.png").write_bytes(picture(9, ".png"))
    with pytest.raises(DataError, match="give no times"):
        open_dataset(tmp_path)


def test_images_without_numbers_of_their_own_come_by_name(tmp_path: Path) -> None:
    for name in ("b_1", "a_2", "a_1", "b_2"):
        (tmp_path / f"{name}.png").write_bytes(picture(9, ".png"))
    (tmp_path / "camera-intrinsics.txt").write_text("525 0 32\n0 525 24\n0 0 1\n")
    data = open_dataset(tmp_path)
    assert [frame.name for frame in frames_of(data)] == ["a_1.png", "a_2.png", "b_1.png", "b_2.png"]
    assert data.frame_times_ns.tolist() == [round(n / 30 * 1e9) for n in range(4)]


def test_each_frame_keeps_the_exposure_that_was_recorded(asl: Path) -> None:
    lines = [f"{T0_NS + i * 50_000_000},{i}.jpg" + (f",{1000 * i}" if i else "") for i in range(5)]
    (asl / "mav0" / "cam0" / "data.csv").write_text("\n".join(lines) + "\n")
    (asl / "mav0" / "cam0" / "sensor.yaml").write_text(CAMERA_YAML + "exposure_s: 0.008\n")
    frames = list(frames_of(open_dataset(asl, first=0, last=4, step=2)))
    assert [frame.exposure_ns for frame in frames] == [8_000_000, 2000, 4000]


def test_video_gives_its_frames(tmp_path: Path) -> None:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for value in range(0, 200, 20):
        writer.write(np.full((48, 64, 3), value, np.uint8))
    writer.release()
    with pytest.raises(DataError, match=r"camera\.yaml"):
        open_dataset(path)
    (tmp_path / "camera.yaml").write_text(CAMERA_YAML)
    frames = list(frames_of(open_dataset(path, first=2, step=3)))
    assert [f.t_robot_ns for f in frames] == [80_000_000, 200_000_000, 320_000_000]
    assert abs(float(frames[0].grey().mean()) - 40) < 6


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [
        ("cam0/sensor.yaml", "resolution: [64, 48\n", "not readable YAML"),
        ("cam0/sensor.yaml", "just words", "no `key: value` lines"),
        ("cam0/sensor.yaml", "resolution: [64, 48]\n", "intrinsics must be 4 numbers"),
        ("cam0/sensor.yaml", CAMERA_YAML.replace("50.0", "-50.0"), "focal length"),
        ("cam0/sensor.yaml", CAMERA_YAML.replace("radial-tangential", "magic"), "distortion_model"),
        ("imu0/data.csv", "1,2,3\n", "line 1"),
        ("imu0/data.csv", "1,a,3,4,5,6,7\n", "line 1"),
        ("imu0/data.csv", "2,1,1,1,1,1,1\n1,1,1,1,1,1,1\n", "sort"),
        ("imu0/data.csv", "1,nan,1,1,1,1,1\n", "not finite"),
        ("cam0/data.csv", "no time,a.jpg\n", "line 1"),
        ("cam0/data.csv", "1,a.jpg,soon\n", "exposure"),
        ("cam0/data.csv", "1,a.jpg,-5\n", "exposure"),
        ("cam0/data.csv", f"{2**63},a.jpg\n", "no time in ns"),
        ("cam0/sensor.yaml", CAMERA_YAML.replace("rate_hz: 20", "rate_hz: 0"), "rate_hz is 0"),
        ("cam0/sensor.yaml", CAMERA_YAML.replace("rate_hz: 20", "rate_hz: 1" + 400 * "0"), "rate_hz must be"),
        ("cam0/sensor.yaml", CAMERA_YAML.replace("-0.04", "40"), "time_shift_s"),
        ("cam0/sensor.yaml", CAMERA_YAML.replace("0.00003", "3"), "line_delay_s"),
        ("cam0/sensor.yaml", CAMERA_YAML + "exposure_s: 1.0e300\n", "exposure_s"),
        ("cam0/sensor.yaml", "date: 2021-13-45\n", "not readable YAML"),
        ("cam0/sensor.yaml", "a: " + "[" * 5000, "not readable YAML"),
        ("imu0/data.csv", "\0" * 200_000, "cannot be read"),
        ("imu0/data.csv", "1," + "1" * 100_000, "more than 65536 characters"),
        ("cam0/sensor.yaml", "a: &a [1, 1]\nresolution: *a\n", "alias"),
        ("state_groundtruth_estimate0/data.csv", "1,nan,0,0,1,0,0,0\n", "not finite"),
        ("state_groundtruth_estimate0/data.csv", "1,0,0,0,0,0,0,0\n", "is no pose"),
        ("state_groundtruth_estimate0/data.csv", "1,0,-1e308,0,1,0,0,0\n", "is no pose"),
        ("imu0/data.csv", f"{10**19},1,1,1,1,1,1\n", "no time in ns"),
    ],
)
def test_damaged_file_gets_one_sentence(asl: Path, file: str, content: str, says: str) -> None:
    (asl / "mav0" / file).parent.mkdir(exist_ok=True)
    (asl / "mav0" / file).write_text(content)
    with pytest.raises(DataError, match=says) as caught:
        open_dataset(asl)
    assert str(asl / "mav0" / file) in str(caught.value)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "file", ["cam0/sensor.yaml", "cam0/data.csv", "imu0/sensor.yaml", "imu0/data.csv", "drive0/data.csv"]
)
@pytest.mark.parametrize(("kind", "says"), [("pipe", "it is a pipe, no file"), ("device", "it is a device, no file")])
def test_what_is_no_file_is_not_said_to_be_missing(asl: Path, file: str, kind: str, says: str) -> None:
    path = asl / "mav0" / file
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(DataError, match=says) as caught:
        open_dataset(asl)
    assert str(path) in str(caught.value)


def test_corrupt_image_is_named_when_its_pixels_are_needed(asl: Path) -> None:
    (asl / "mav0" / "cam0" / "data" / "2.jpg").write_bytes(b"no picture")
    frames = list(frames_of(open_dataset(asl)))
    with pytest.raises(DataError, match=r"2\.jpg is not a readable"):
        frames[2].grey()


def test_missing_image_is_named(asl: Path) -> None:
    (asl / "mav0" / "cam0" / "data" / "3.jpg").unlink()
    with pytest.raises(DataError, match=r"3\.jpg cannot be read"):
        list(frames_of(open_dataset(asl)))


def test_paths_that_are_no_dataset(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(DataError, match="does not exist"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"no \*\.jpg"):
        open_dataset(tmp_path / "empty")
    (tmp_path / "text.txt").write_text("hello")
    with pytest.raises(DataError, match="is no dataset"):
        open_dataset(tmp_path / "text.txt")
    (tmp_path / "broken" / "mav0").mkdir(parents=True)
    with pytest.raises(DataError, match="neither"):
        open_dataset(tmp_path / "broken")
    with pytest.raises(DataError, match="none of them"):
        open_dataset(folder, first=100)
    with pytest.raises(DataError, match="step 0"):
        open_dataset(folder, step=0)
    (folder / "camera-intrinsics.txt").write_text("1 2\n3 4\n")
    with pytest.raises(DataError, match="3x3"):
        open_dataset(folder)
    (folder / "camera-intrinsics.txt").unlink()
    with pytest.raises(DataError, match=r"camera\.yaml"):
        open_dataset(folder)


def depth_picture(value: int, width: int = 32, height: int = 24) -> bytes:
    return cv2.imencode(".png", np.full((height, width), value, np.uint16))[1].tobytes()


@pytest.fixture
def with_depth(tmp_path: Path) -> Path:
    """Six images, every second one with depth."""
    (tmp_path / "camera-intrinsics.txt").write_text("50 0 31.5\n0 51 23.5\n0 0 1\n")
    (tmp_path / "depth-intrinsics.txt").write_text("30 0 15.5\n0 30 11.5\n0 0 1\n")
    for i in range(6):
        (tmp_path / f"frame-{i:06d}.color.jpg").write_bytes(picture(40 * i))
        if i % 2 == 0:
            (tmp_path / f"frame-{i:06d}.depth.png").write_bytes(depth_picture(1000 + i))
    return tmp_path


def test_depth_pictures_of_a_folder_come_before_the_image_of_their_number(with_depth: Path) -> None:
    data = open_dataset(with_depth)
    events = list(data.events())
    assert [type(e) for e in events] == [DepthFrame, ImageFrame, ImageFrame] * 3
    depth = [e for e in events if isinstance(e, DepthFrame)]
    assert [e.t_robot_ns for e in depth] == data.frame_times_ns[::2].tolist()
    assert [int(e.millimetres()[0, 0]) for e in depth] == [1000, 1002, 1004]
    sensor = data.calibration.depth_sensor
    assert sensor is not None and depth[0].sensor == sensor
    assert (sensor.width, sensor.height, sensor.fx, sensor.cx, sensor.is_measured) == (32, 24, 30.0, 15.5, False)


def test_depth_is_cut_to_the_frames_and_never_thinned(with_depth: Path) -> None:
    data = open_dataset(with_depth, first=1, last=5, step=4)
    assert data.read_depth is not None
    assert len(data.frame_times_ns) == 2
    assert [int(e.millimetres()[0, 0]) for e in data.read_depth()] == [1002, 1004]


@pytest.mark.parametrize("gone", ["depth-intrinsics.txt", "*.depth.png"])
def test_a_folder_without_depth_or_its_intrinsics_has_none(with_depth: Path, gone: str) -> None:
    for path in with_depth.glob(gone):
        path.unlink()
    data = open_dataset(with_depth)
    assert data.read_depth is None
    assert data.calibration == Calibration(camera=data.calibration.camera, imu=None)
    assert all(isinstance(e, ImageFrame) for e in data.events())


def test_a_damaged_depth_picture_is_named(with_depth: Path) -> None:
    (with_depth / "frame-000000.depth.png").write_bytes(b"no picture")
    with pytest.raises(DataError, match=r"frame-000000\.depth\.png is not a readable"):
        open_dataset(with_depth)
    (with_depth / "frame-000000.depth.png").write_bytes(depth_picture(1)[:50])
    depth = open_dataset(with_depth).read_depth
    assert depth is not None
    with pytest.raises(DataError, match=r"frame-000000\.depth\.png is no PNG of 16 bit"):
        next(depth()).millimetres()
    (with_depth / "depth-intrinsics.txt").write_text("0.1 0 15.5\n0 30 11.5\n0 0 1\n")
    with pytest.raises(DataError, match=r"depth-intrinsics\.txt: focal length"):
        open_dataset(with_depth)
