"""Rendered calibration recordings: what they show is where the truth puts it, and what they tell is only believed."""

import json
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from robot.simulation.along import read_states
from robot.simulation.asl import TRUTH
from robot.simulation.calibration.board_camera import OFFSETS_PX
from robot.simulation.calibration.conduct import POOR
from robot.simulation.calibration.kind import Kind
from robot.simulation.calibration.sensors import draw_camera
from robot.simulation.calibration.sessions import record_session
from robot.simulation.calibration.waving import Wave, WavedRig
from robot.simulation.renderer import undistort
from shared.calibration import REFERENCE_CAMERA, Calibration
from shared.errors import ConfigError
from shared.geometry import inverse, so3_log, transform
from shared.sensor_yaml import read_yaml
from station.calibration.target import Target
from station.datasets.opening import open_dataset
from tests.support.tags import detect_tags, project, read_grey


def read_target(folder: Path) -> Target:
    content = read_yaml(folder / "target.yaml")
    assert content["target_type"] == "aprilgrid"
    size = content["tagSize"]
    return Target("aprilgrid", content["tagCols"], content["tagRows"], size, size * content["tagSpacing"])


def truth_of(folder: Path) -> tuple[dict[str, Any], Calibration]:
    truth = json.loads((folder / "truth.json").read_text())
    return truth, msgspec.convert(truth["calibration"], Calibration)


@pytest.mark.parametrize("seed", [0, 1])  # a wide lens and a common one
def test_corners_of_a_waved_board_are_seen_where_the_truth_puts_them(tmp_path: Path, seed: int) -> None:
    record_session(Kind.CAMERA_IMU, tmp_path / "session", seed, seconds=3.0)
    truth, calibration = truth_of(tmp_path / "session")
    camera = calibration.camera
    assert camera is not None
    T_world_board = np.array(truth["T_world_board"])
    corners = read_target(tmp_path / "session").corners
    states = read_states(tmp_path / "session" / "mav0" / TRUTH / "data.csv")
    path, first_ns = states.path(), int(states.t_ns[0])
    errors = []
    for image_file in sorted((tmp_path / "session/mav0/cam0/data").iterdir())[::10]:
        t_s = (int(image_file.stem) - first_ns) * 1e-9 + camera.time_shift_s
        ids, seen = detect_tags(read_grey(image_file))
        expected = np.empty_like(seen)
        for i, (corner, (_, v)) in enumerate(zip(corners[ids], seen, strict=True)):
            T_world_cam = path.pose(t_s + camera.line_delay_s * float(v)) @ camera.T_body_cam_matrix
            expected[i] = project(camera, transform(inverse(T_world_cam) @ T_world_board, corner[None]))[0]
        errors.append(seen - expected)
    off = np.concatenate(errors)
    assert len(off) > 400
    assert np.abs(np.median(off, axis=0)).max() < 0.02
    assert np.median(np.linalg.norm(off, axis=1)) < 0.12


def test_stills_calibrate_to_the_camera_that_took_them(tmp_path: Path) -> None:
    record_session(Kind.CAMERA, tmp_path / "session", seed=1, seconds=40.0)
    _, calibration = truth_of(tmp_path / "session")
    camera = calibration.camera
    assert camera is not None and camera.model == "radtan"
    corners = read_target(tmp_path / "session").corners.astype(np.float32)
    views = [detect_tags(read_grey(f)) for f in sorted((tmp_path / "session/mav0/cam0/data").iterdir())]
    views = [view for view in views if len(view[0]) > 40]
    flags = cv2.CALIB_FIX_K3
    _, K, lens, _, _ = cv2.calibrateCamera(
        [corners[ids] for ids, _ in views], [seen for _, seen in views], (640, 480), None, None, flags=flags
    )
    np.testing.assert_allclose(K[[0, 1], [0, 1]], [camera.fx, camera.fy], rtol=0.004)
    np.testing.assert_allclose(K[[0, 1], 2], [camera.cx, camera.cy], atol=3.0)
    assert lens.ravel()[0] == pytest.approx(camera.distortion[0], abs=0.03)


@pytest.mark.parametrize("duration_s", [None, 20.0])
def test_rates_and_accelerations_of_a_waved_rig_are_the_derivatives_of_its_poses(duration_s: float | None) -> None:
    T_body_cam = REFERENCE_CAMERA.T_body_cam_matrix
    rig = WavedRig(Wave(), 0.5, T_body_cam, np.random.default_rng(3), duration_s=duration_s)
    h, t_s = 1e-4, np.linspace(0.01, 19.99, 50)
    before, now, after = rig.at(t_s - h), rig.at(t_s), rig.at(t_s + h)
    np.testing.assert_allclose((after.p_world - before.p_world) / (2 * h), now.v_world, atol=1e-5)
    np.testing.assert_allclose((after.v_world - before.v_world) / (2 * h), now.a_world, atol=1e-4)
    turned = so3_log(before.R_world_body.transpose(0, 2, 1) @ after.R_world_body)
    np.testing.assert_allclose(turned / (2 * h), now.omega_body, atol=1e-5)


def test_every_lens_that_is_drawn_can_be_undone() -> None:
    corners = np.array([[u, v] for u in (0, 320, 639) for v in (0, 240, 479)], dtype=np.float64)
    for seed in range(30):
        camera = draw_camera(np.random.default_rng(seed))
        xy = undistort(camera, (corners - [camera.cx, camera.cy]) / [camera.fx, camera.fy])
        again = project(camera, np.column_stack([xy, np.ones(len(xy))]))
        np.testing.assert_allclose(again, corners, atol=1e-3)


def test_a_dataset_tells_the_lens_that_was_calibrated_before_and_nothing_else_that_is_true(tmp_path: Path) -> None:
    record_session(Kind.CAMERA_IMU, tmp_path / "session", seed=2, seconds=1.0)
    _, true = truth_of(tmp_path / "session")
    dataset = open_dataset(tmp_path / "session")
    told = dataset.calibration.camera
    assert told is not None and true.camera is not None and dataset.imu is not None
    assert (told.fx, told.distortion) == (true.camera.fx, true.camera.distortion)
    assert (told.time_shift_s, told.line_delay_s) == (0.0, 0.0)
    assert true.camera.time_shift_s != 0.0 != true.camera.line_delay_s
    np.testing.assert_allclose(told.T_body_cam_matrix, REFERENCE_CAMERA.T_body_cam_matrix, atol=1e-9)
    assert dataset.calibration.rig == "hand-held"


def test_stills_tell_a_guessed_lens(tmp_path: Path) -> None:
    record_session(Kind.CAMERA, tmp_path / "session", seed=2, seconds=1.0)
    dataset = open_dataset(tmp_path / "session")
    assert not dataset.intrinsics_known
    assert dataset.imu is None


def test_an_imu_at_rest_has_the_noise_that_the_truth_says(tmp_path: Path) -> None:
    record_session(Kind.IMU, tmp_path / "session", seed=4, seconds=600.0)
    truth, calibration = truth_of(tmp_path / "session")
    imu = open_dataset(tmp_path / "session").imu
    noise = calibration.imu
    assert imu is not None and noise is not None
    for readings, density, walk in (
        (imu.gyro_imu, noise.gyro_density, noise.gyro_walk),
        (imu.accel_imu, noise.accel_density, noise.accel_walk),
    ):
        white = np.diff(readings, axis=0).std() / np.sqrt(2)
        assert white == pytest.approx(density * np.sqrt(noise.rate_hz), rel=0.02)
        minutes = readings.reshape(10, -1, 3).mean(
            axis=1
        )  # of 60 s: their steps have variance 2/3 walk^2 60 s and more
        expected = np.sqrt(2 / 3 * walk**2 * 60 + 2 * density**2 / 60)
        assert np.diff(minutes, axis=0).std() == pytest.approx(expected, rel=0.5)
    np.testing.assert_allclose(imu.gyro_imu.mean(axis=0), truth["gyro_bias"], atol=1e-3)


def test_running_motors_shake_the_imu(tmp_path: Path) -> None:
    spreads = []
    for motors in (False, True):
        record_session(Kind.IMU, tmp_path / str(motors), seed=4, seconds=20.0, motors=motors)
        imu = open_dataset(tmp_path / str(motors)).imu
        assert imu is not None
        spreads.append(imu.accel_imu.std(axis=0).mean())
    assert spreads[1] > 3 * spreads[0]


@pytest.mark.parametrize(("kind", "poor"), [(kind, poor) for kind, names in POOR.items() for poor in names])
def test_every_poor_recording_can_be_made(tmp_path: Path, kind: Kind, poor: str) -> None:
    session = record_session(kind, tmp_path / "session", seed=5, poor=poor, seconds=1.0)
    truth, _ = truth_of(tmp_path / "session")
    assert truth["poor"] == poor
    assert (session.frames > 0) == (kind is not Kind.IMU)
    assert (session.imu_samples == 0) == (kind is Kind.CAMERA or poor == "no-imu")


def test_the_same_seed_makes_the_same_recording_and_another_one_another(tmp_path: Path) -> None:
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        record_session(Kind.CAMERA_IMU, tmp_path / name, seed, seconds=1.0)
    a, b, c = (
        [f.read_bytes() for f in sorted((tmp_path / name).rglob("*")) if f.is_file()] for name in ("a", "b", "c")
    )
    assert a == b
    assert a != c


def test_a_board_of_another_size_than_told_is_a_scaled_one(tmp_path: Path) -> None:
    record_session(Kind.CAMERA_IMU, tmp_path / "session", seed=5, poor="wrong-target-size", seconds=1.0)
    truth, _ = truth_of(tmp_path / "session")
    assert truth["board"]["tag_m"] == pytest.approx(0.9 * read_target(tmp_path / "session").square_m)


def test_an_unknown_mistake_is_refused_with_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="too-still"):
        record_session(Kind.CAMERA_IMU, tmp_path / "session", seed=0, poor="too-loud")
    assert not (tmp_path / "session").exists()


def test_an_exposure_looks_at_opposite_places_before_and_after_its_middle() -> None:
    """So that motion blurs corners and does not shift them: 0.005 px is more than a sigma."""
    np.testing.assert_array_equal(np.array(OFFSETS_PX), -np.array(OFFSETS_PX[::-1]))
