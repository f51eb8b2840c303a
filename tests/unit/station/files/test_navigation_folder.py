"""A navigation survives the disk exactly, and damage is named."""

import json
import math
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_IMU, REFERENCE_ROBOT
from shared.errors import DataError
from station.files.navigation_folder import (
    DEPTH,
    OBSERVATIONS,
    encode_navigation,
    load_navigation,
    parse_tum,
    save_navigation,
)
from station.files.ply import read_ply, read_rows, write_ply
from station.model.navigation import DepthScans, Landmarks, Navigation
from station.slam.run import content_digest
from tests.support.depth import depth_camera
from tests.support.navigations import small_navigation

CONTRACT_KEYS = {"backend", "frames", "duration_s", "wall_s", "realtime_factor", "cpu_s", "landmarks"} | {
    "tracking_lost_s",
    "scale",
    "gravity_aligned",
    "seed",
    "versions",
    "config",
}


def test_a_folder_that_a_killed_program_took_the_name_from_is_read(tmp_path: Path) -> None:
    save_navigation(small_navigation(), tmp_path / ".new-x/before/nav")
    assert load_navigation(tmp_path / "nav").id == small_navigation().id


def test_a_folder_that_cannot_take_the_name_leaves_the_old_one_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, new = small_navigation(), replace(small_navigation(), id="hall")
    save_navigation(old, tmp_path / "nav")
    rename = Path.rename

    def refuse_the_new_one(self: Path, target: Path) -> Path:
        if self.name == "fresh":
            raise OSError(28, "No space left on device")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse_the_new_one)
    with pytest.raises(DataError, match="No space left"):
        save_navigation(new, tmp_path / "nav")
    assert load_navigation(tmp_path / "nav").id == "kitchen"
    assert [p.name for p in tmp_path.iterdir()] == ["nav"]


def test_too_long_a_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be written"):
        save_navigation(small_navigation(), tmp_path / ("x" * 300))


def test_navigations_share_a_digest_only_when_they_are_the_same() -> None:
    nav = small_navigation()
    other_pictures = replace(nav, keyframes=replace(nav.keyframes, encoded=nav.keyframes.encoded[::-1]))
    other_points = replace(nav, landmarks=replace(nav.landmarks, p_world=nav.landmarks.p_world + 0.1))
    digests = [content_digest(n) for n in (nav, small_navigation(), other_pictures, other_points)]
    assert digests[0] == digests[1] and len(set(digests)) == 3


def test_a_sensor_range_without_limit_survives_the_disk(tmp_path: Path) -> None:
    unlimited = msgspec.structs.replace(REFERENCE_IMU, gyro_range=math.inf, accel_range=math.inf)
    calibration = msgspec.structs.replace(REFERENCE_ROBOT, imu=unlimited)
    save_navigation(replace(small_navigation(), calibration=calibration), tmp_path / "nav")
    assert load_navigation(tmp_path / "nav").calibration == calibration


def test_the_told_camera_survives_beside_the_corrected_one(tmp_path: Path) -> None:
    nav = small_navigation()
    told = REFERENCE_ROBOT.camera
    save_navigation(replace(nav, report=replace(nav.report, told_camera=told)), tmp_path / "nav")
    assert load_navigation(tmp_path / "nav").report.told_camera == told
    path = tmp_path / "nav" / "navigation.json"
    content = json.loads(path.read_text())
    del content["told_camera"]  # as it was before cameras were corrected
    path.write_text(json.dumps(content))
    assert load_navigation(tmp_path / "nav").report.told_camera is None


def test_navigation_survives_the_disk(tmp_path: Path) -> None:
    nav = small_navigation()
    save_navigation(nav, tmp_path / "nav")
    back = load_navigation(tmp_path / "nav")
    assert back.id == nav.id and back.report == nav.report and back.calibration == nav.calibration
    assert back.trajectory.t_robot_ns.tolist() == nav.trajectory.t_robot_ns.tolist()
    np.testing.assert_allclose(back.trajectory.T_world_body, nav.trajectory.T_world_body, atol=1e-8)
    for name in ("frame_index", "t_robot_ns", "T_world_cam", "segment"):
        np.testing.assert_array_equal(getattr(back.keyframes, name), getattr(nav.keyframes, name))
    assert back.keyframes.encoded == nav.keyframes.encoded
    for name in ("p_world", "rgb", "cov_world", "observed_landmark", "observed_keyframe", "observed_uv_px"):
        np.testing.assert_array_equal(getattr(back.landmarks, name), getattr(nav.landmarks, name))


def test_files_are_those_of_the_contract(tmp_path: Path) -> None:
    save_navigation(small_navigation(), tmp_path / "nav")
    assert json.loads((tmp_path / "nav" / "navigation.json").read_text()).keys() >= CONTRACT_KEYS
    cloud = read_ply(tmp_path / "nav" / "landmarks.ply")
    assert list(cloud)[:8] == ["x", "y", "z", "red", "green", "blue", "first_frame", "num_observations"]
    assert cloud["num_observations"].tolist() == [2, 2, 2, 1, 1, 1, 1]
    assert cloud["first_frame"].tolist() == [0, 0, 0, 4, 4, 4, 4]


def test_no_landmarks_is_a_navigation_too(tmp_path: Path) -> None:
    nav = small_navigation(3)
    empty = Landmarks(*(column[:0] for column in (nav.landmarks.p_world, nav.landmarks.rgb, nav.landmarks.cov_world)),
                      np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)))  # fmt: skip
    save_navigation(
        Navigation(nav.id, nav.calibration, nav.trajectory, nav.keyframes, empty, nav.report), tmp_path / "n"
    )
    assert len(load_navigation(tmp_path / "n").landmarks) == 0


def test_saving_again_replaces_but_never_deletes_other_things(tmp_path: Path) -> None:
    save_navigation(small_navigation(7), tmp_path / "nav")
    save_navigation(small_navigation(5), tmp_path / "nav")
    assert len(load_navigation(tmp_path / "nav").landmarks) == 5
    assert [p.name for p in tmp_path.iterdir()] == ["nav"]
    (tmp_path / "nav" / "letter.txt").write_text("dear")
    with pytest.raises(DataError, match=r"letter\.txt"):
        save_navigation(small_navigation(7), tmp_path / "nav")
    assert (tmp_path / "nav" / "letter.txt").read_text() == "dear"


def test_failed_save_leaves_the_old_navigation(tmp_path: Path) -> None:
    save_navigation(small_navigation(7), tmp_path / "nav")
    broken = small_navigation(5)
    broken.report.config["odd"] = {1: object()}
    object.__setattr__(broken.keyframes, "encoded", ("not bytes",))
    with pytest.raises(TypeError):
        save_navigation(broken, tmp_path / "nav")
    assert len(load_navigation(tmp_path / "nav").landmarks) == 7
    assert [p.name for p in tmp_path.iterdir()] == ["nav"]


@pytest.mark.parametrize(
    "name", ["trajectory.tum", "landmarks.ply", "navigation.json", "calibration.json", "keyframes/observations.npz"]
)
def test_damaged_or_missing_file_is_named(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "nav"
    save_navigation(small_navigation(), folder)
    content = (folder / name).read_bytes()
    for damage in (b"garbage", content[: len(content) // 2], b""):
        (folder / name).write_bytes(damage)
        if name == "trajectory.tum" and damage == b"":
            continue
        with pytest.raises(DataError, match=name.split("/")[-1]):
            load_navigation(folder)
    (folder / name).unlink()
    with pytest.raises(DataError):
        load_navigation(folder)


@pytest.mark.parametrize(
    "line",
    [
        "0.1 nan 0 0 0 0 0 1",
        "0.1 0 0 inf 0 0 0 1",
        "0.1 0 0 0 0 nan 0 1",
        "0.1 0 0 0 0 0 0 0",
        "0.1 0 0 0 9 9 9 9",
        "0.1 0 0 0 1e308 1e308 0 0",
        "0.1 1e308 0 0 0 0 0 1",
        f"{10**20}.0 0 0 0 0 0 0 1",
        f"-{10**10}.0 0 0 0 0 0 0 1",
    ],
)
def test_a_trajectory_holds_poses_only(line: str) -> None:
    with pytest.raises(DataError, match="line 2"):
        parse_tum(f"0.0 0 0 0 0 0 0 1\n{line}\n", Path("trajectory.tum"))


def test_a_trajectory_goes_forward_in_time() -> None:
    """Poses are looked up by bisection, which finds others where times are in no order."""
    with pytest.raises(DataError, match="line 3 is earlier than the line before"):
        parse_tum("0.0 0 0 0 0 0 0 1\n0.2 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n", Path("trajectory.tum"))


@pytest.mark.parametrize("number", [math.nan, math.inf, 7.0])
def test_a_keyframe_whose_pose_is_none_is_refused(number: float, tmp_path: Path) -> None:
    nav = small_navigation()
    nav.keyframes.T_world_cam[1, 0, 0] = number
    save_navigation(nav, tmp_path / "nav")
    with pytest.raises(DataError, match=r"observations\.npz is damaged"):
        load_navigation(tmp_path / "nav")


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_an_observation_that_is_nowhere_is_refused(number: float, tmp_path: Path) -> None:
    nav = small_navigation()
    nav.landmarks.observed_uv_px[2, 1] = number
    save_navigation(nav, tmp_path / "nav")
    with pytest.raises(DataError, match="nowhere"):
        load_navigation(tmp_path / "nav")


@pytest.mark.parametrize(("key", "sensor"), [("gravity", None), ("gyro_density", "imu"), ("rate_hz", "imu")])
def test_a_calibration_holds_numbers_only(key: str, sensor: str | None, tmp_path: Path) -> None:
    save_navigation(small_navigation(), tmp_path / "nav")
    path = tmp_path / "nav" / "calibration.json"
    content = json.loads(path.read_text())
    (content[sensor] if sensor else content)[key] = math.nan
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match=r"calibration\.json is damaged"):
        load_navigation(tmp_path / "nav")


def test_a_report_that_nests_without_end_is_refused(tmp_path: Path) -> None:
    save_navigation(small_navigation(), tmp_path / "nav")
    (tmp_path / "nav" / "navigation.json").write_text("[" * 100_000)
    with pytest.raises(DataError, match=r"navigation\.json .* too deep"):
        load_navigation(tmp_path / "nav")


def test_an_array_without_bytes_is_refused(tmp_path: Path) -> None:
    """It may have any length: a list of its entries fills the memory."""
    save_navigation(small_navigation(), tmp_path / "nav")
    path = tmp_path / "nav" / "keyframes" / "observations.npz"
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(path, **arrays | {"names": np.empty(10**6, dtype="V0")})
    with pytest.raises(DataError, match="names does not have the bytes"):
        load_navigation(tmp_path / "nav")


@pytest.mark.parametrize("header", ["(" * 30, "'''", "{", "(" * 200])
def test_an_array_whose_header_is_no_header_is_refused(header: str, tmp_path: Path) -> None:
    save_navigation(small_navigation(), tmp_path / "nav")
    path = tmp_path / "nav" / OBSERVATIONS
    text = header.ljust(246).encode() + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("frame_index.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text)
    with pytest.raises(DataError, match="is damaged") as caught:
        load_navigation(tmp_path / "nav")
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("body", ["", "1 2 3\n", "1 2 3 4 5 6\n\n", "1 2\n3 4 5 6\n", "1 2 x\n1 2 3\n"])
def test_a_ply_of_other_lines_than_it_says_is_refused(body: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n{body}")
    with pytest.raises(DataError, match="not 3 numbers, or too few lines"):
        read_ply(path)


def test_points_without_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_text("ply\nformat binary_little_endian 1.0\nelement vertex 100000000\nend_header\n")
    with pytest.raises(DataError, match="points without numbers"):
        read_ply(path)


def test_ascii_and_foreign_plys_are_read(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_text(
        "ply\nformat ascii 1.0\ncomment hi\nelement camera 1\nproperty float f\nelement vertex 2\n"
        "property float x\nproperty double y\nproperty float z\nproperty uchar red\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n5\n1 2 3 4\n5 6 nan 7\n3 0 1 0\n"
    )
    columns = read_ply(path)
    assert columns["red"].tolist() == [4, 7]
    np.testing.assert_array_equal(read_rows(path), [[1, 2, 3], [5, 6, np.nan]])


def test_big_endian_ply_is_read(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    header = (
        b"ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    )
    path.write_bytes(header + b"end_header\n" + np.array([1, 2, 3], ">f4").tobytes())
    np.testing.assert_array_equal(read_rows(path), [[1, 2, 3]])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"hello", "not a PLY"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "without x, y and z"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
            b"end_header\nnan -1e12 0\n",
            r"at y = -1e\+12",
        ),
        (b"ply\nformat odd 1.0\nelement vertex 1\nend_header\n1\n", "odd"),
        (b"ply\nformat ascii 1.0\nwhat is this\nend_header\n", "header line"),
        (b"ply\nformat ascii 1.0\nend_header\n", "no vertices"),
        (
            b"ply\nformat ascii 1.0\nelement vertex " + b"9" * 5000 + b"\nend_header\n",
            "header line 'element vertex 9+",
        ),
        (b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n", "claims more"),
    ],
)
def test_bad_ply_gets_a_sentence(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(DataError, match=says):
        read_ply(tmp_path / "bad.ply")


def test_cut_ply_says_how_much_is_left(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_ply(path, {axis: np.arange(10.0) for axis in "xyz"})
    path.write_bytes(path.read_bytes()[:-24])
    with pytest.raises(DataError, match="9 of 10"):
        read_ply(path)


def scanned() -> Navigation:
    nav = small_navigation()
    millimetres = np.arange(2 * 6 * 8, dtype=np.uint16).reshape(2, 6, 8)
    return replace(nav, depth=DepthScans(nav.trajectory.t_robot_ns[:2], millimetres, depth_camera(8, 6)))


def test_depth_survives_the_disk_and_is_no_file_where_there_is_none(tmp_path: Path) -> None:
    assert DEPTH not in encode_navigation(small_navigation())
    nav = scanned()
    without = {name: content for name, content in encode_navigation(nav).items() if name != DEPTH}
    assert without == encode_navigation(small_navigation())
    save_navigation(nav, tmp_path / "nav")
    read = load_navigation(tmp_path / "nav").depth
    assert read is not None and nav.depth is not None
    np.testing.assert_array_equal(read.t_robot_ns, nav.depth.t_robot_ns)
    np.testing.assert_array_equal(read.millimetres, nav.depth.millimetres)
    assert read.sensor == nav.depth.sensor
    save_navigation(small_navigation(), tmp_path / "nav")
    assert load_navigation(tmp_path / "nav").depth is None


@pytest.mark.parametrize(
    "changes",
    [
        {"millimetres": np.zeros((2, 6, 9), np.uint16)},
        {"millimetres": np.zeros((3, 6, 8), np.uint16)},
        {"millimetres": np.zeros((2, 6, 8))},
        {"sensor": np.frombuffer(b"{}", np.uint8)},
        {"sensor": np.frombuffer(b'{"width": 8, "height": 6, "fx": 0, "fy": 1, "cx": 0, "cy": 0}', np.uint8)},
    ],
)
def test_damaged_depth_is_named(changes: dict[str, np.ndarray], tmp_path: Path) -> None:
    save_navigation(scanned(), tmp_path / "nav")
    with np.load(tmp_path / "nav" / DEPTH) as arrays:
        content = dict(arrays) | changes
    np.savez_compressed(tmp_path / "nav" / DEPTH, **content)
    with pytest.raises(DataError, match=r"depth\.npz is damaged"):
        load_navigation(tmp_path / "nav")
    (tmp_path / "nav" / DEPTH).write_bytes(b"PK")
    with pytest.raises(DataError, match=r"depth\.npz is damaged"):
        load_navigation(tmp_path / "nav")
