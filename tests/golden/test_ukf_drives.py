"""The filter on a simulated drive whose stamps come before the exposure, judged by its truth.

The reference camera's stamps come after it. Here SLAM needs the IMU beyond a frame's stamp, also from a recording. Once
as the robot is built, and once told as a calibration at home would leave it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from robot.simulation.cli import app
from robot.simulation.config import BuildErrors
from robot.simulation.construction import built_camera
from shared.calibration import REFERENCE_CAMERA, CameraCalibration
from shared.calibration_yaml import camera_sensor_text
from shared.geometry import so3_exp, so3_log
from station.datasets import open_dataset
from station.experiments.trajectory_error import TrajectoryError, absolute_trajectory_error
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.motion.preintegration import RolledWay
from station.slam.backends import make_backend
from station.slam.run import Events, run_backend
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.monitor import CONTRADICTION, TrackingMonitor

DARK_AFTER_NS, DARK_NS = 8 * 10**9, 2 * 10**9  # under a hand, after which tracking is lost
CAMERA_HZ = 12.0  # of the robot's 20: enough to follow it
LATER_MS = 110.0  # in the order of the stamps this drive is lost; 20 ms after them it would be borne


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    (folder / "built.toml").write_text(f"camera_rate_hz = {CAMERA_HZ}\n[build]\ntime_shift_ms = {LATER_MS}\n")
    where = ["--world", "small", "--seed", "11", "--route", "mapping", "--max-duration", "20"]
    out = folder / "drive"
    result = CliRunner().invoke(app, ["dataset", *where, "--config", str(folder / "built.toml"), "--out", str(out)])
    assert result.exit_code == 0, result.output
    return out


def followed(drive: Path, told: CameraCalibration) -> tuple[Navigation, TrajectoryError]:
    """What the filter makes of the drive with the camera that it is told, and how far off that is."""
    (drive / "mav0/cam0/sensor.yaml").write_text(camera_sensor_text(told))
    data = open_dataset(drive)
    assert data.calibration.camera == told and data.truth is not None
    nav = run_backend(make_backend("ukf", data.calibration, seed=1, threads=1), data.events())
    return nav, absolute_trajectory_error(nav.trajectory, data.truth, "yaw")


def test_stamps_before_the_exposure_bend_nothing(drive: Path) -> None:
    built = built_camera(REFERENCE_CAMERA, BuildErrors(time_shift_ms=LATER_MS))
    assert built.time_shift_s > 0.06
    nav, error = followed(drive, built)
    assert nav.is_metric and nav.report.tracking_lost_s == 0
    assert error.rmse_m < 0.05 and error.rotation_rmse_rad < 0.02, error


def test_a_map_finds_out_what_its_camera_is(drive: Path) -> None:
    built = built_camera(REFERENCE_CAMERA, BuildErrors(time_shift_ms=LATER_MS))
    T = built.T_body_cam_matrix
    T[:3, :3] = T[:3, :3] @ so3_exp(np.radians([1.0, -1.0, 0.3]))
    told = msgspec.structs.replace(
        built,
        fx=0.98 * built.fx,
        fy=0.98 * built.fy,
        T_body_cam=tuple(T.ravel().tolist()),
        time_shift_s=built.time_shift_s - 0.005,
    )
    nav, error = followed(drive, told)
    found, fit = nav.calibration.camera, nav.report.calibration_fit
    assert found is not None and fit is not None and nav.report.told_camera == told
    assert error.rmse_m < 0.05, error
    turned_deg = np.degrees(so3_log(built.T_body_cam_matrix[:3, :3].T @ found.T_body_cam_matrix[:3, :3]))
    sigma_deg = np.array(fit.mounting_sigma_deg)
    assert abs(np.log(found.fx / built.fx)) < min(0.005, 4.0 * fit.focal_sigma)  # of 2 %
    assert (np.abs(turned_deg) < 4.0 * sigma_deg).all()
    assert (sigma_deg[[0, 2]] < 0.2).all()  # about its right and forward axes, of 1.0 and 0.3 degrees
    assert abs(fit.time_shift_s - 0.005) < min(0.0015, 4.0 * fit.time_shift_sigma_s)


def test_what_lies_before_and_behind_an_outage_is_one_map(drive: Path) -> None:
    (drive / "mav0/cam0/sensor.yaml").write_text(
        camera_sensor_text(built_camera(REFERENCE_CAMERA, BuildErrors(time_shift_ms=LATER_MS)))
    )
    data = open_dataset(drive)
    assert data.calibration.camera is not None and data.truth is not None
    camera = data.calibration.camera
    dark = cv2.imencode(".jpg", np.zeros((camera.height, camera.width), dtype=np.uint8))[1].tobytes()
    begin_ns = int(data.truth.t_robot_ns[0]) + DARK_AFTER_NS

    def events() -> Events:
        for event in data.events():
            covered = isinstance(event, ImageFrame) and 0 <= event.t_robot_ns - begin_ns < DARK_NS
            yield replace(event, encoded=dark) if covered and isinstance(event, ImageFrame) else event

    backend = UkfBackend(data.calibration, seed=1)
    nav = run_backend(backend, events())
    assert any("tracking lost" in message for message in nav.report.messages)
    assert_links_are_whole(backend)
    assert sum(way is None for way in ways_of(backend)) == 1  # in the dark nobody kept count
    assert not nav.keyframes.segment.any()  # all of the first piece
    behind = nav.keyframes.t_robot_ns > begin_ns + DARK_NS
    assert behind.any() and not behind.all()
    error = absolute_trajectory_error(nav.trajectory, data.truth, "yaw")
    assert error.rmse_m < 0.05, error


def assert_links_are_whole(backend: UkfBackend) -> None:
    """Of all views: the IMU from each to the next."""
    assert backend.memory.views is not None
    for before, view in pairwise(backend.memory.views.described()):
        since_s = (view.keyframe.image.t_robot_ns - before.keyframe.image.t_robot_ns) * 1e-9
        assert view.keyframe.link is not None and view.keyframe.link.duration_s == pytest.approx(since_s, abs=1e-6)


def ways_of(backend: UkfBackend) -> list[RolledWay | None]:
    """How far the wheels rolled from each view to the next."""
    assert backend.memory.views is not None
    links = [view.keyframe.link for view in backend.memory.views.described()[1:]]
    return [None if link is None else link.rolled for link in links]


def test_what_leaves_the_window_as_tracking_is_lost_is_kept(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    was, lost = TrackingMonitor.why_lost, list[int]()

    def why_lost(self: TrackingMonitor, *given: Any) -> str | None:
        reason = was(self, *given)
        result = given[-1]
        if not lost and len(result.retired) and given[2] > begin_ns + 5 * 10**9:
            lost.append(result.retired[0].frame_index)
            return CONTRADICTION
        return reason

    data = open_dataset(drive)
    assert data.truth is not None
    begin_ns = int(data.truth.t_robot_ns[0])
    monkeypatch.setattr(TrackingMonitor, "why_lost", why_lost)
    backend = UkfBackend(data.calibration, seed=1)
    for event in data.events():
        if isinstance(event, ImageFrame):
            backend.add_frame(event)
            if event.t_robot_ns > begin_ns + 10 * 10**9:
                break
        elif isinstance(event, ImuBatch):
            backend.add_imu(event)
        else:
            assert isinstance(event, DriveSample)
            backend.add_drive(event)
    backend.finish()
    assert lost and backend.memory.segment == 1
    assert_links_are_whole(backend)
