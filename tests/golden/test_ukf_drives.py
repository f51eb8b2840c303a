"""The filter on a simulated drive whose stamps come before the exposure, judged by its truth.

The reference camera's stamps come after it. Here SLAM needs the IMU beyond a frame's stamp, also from a recording.
"""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from robot.simulation.cli import app
from robot.simulation.config import BuildErrors
from robot.simulation.construction import built_camera
from shared.calibration import REFERENCE_CAMERA
from shared.calibration_yaml import camera_sensor_text
from station.datasets import open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error
from station.slam.backends import make_backend
from station.slam.run import run_backend

LATER_MS = 110.0  # in the order of the stamps this drive is lost; 20 ms after them it would be borne


def test_stamps_before_the_exposure_bend_nothing(tmp_path: Path) -> None:
    built = built_camera(REFERENCE_CAMERA, BuildErrors(time_shift_ms=LATER_MS))
    assert built.time_shift_s > 0.06
    (tmp_path / "built.toml").write_text(f"[build]\ntime_shift_ms = {LATER_MS}\n")
    drive = tmp_path / "drive"
    where = ["--world", "small", "--seed", "11", "--route", "mapping", "--max-duration", "20"]
    result = CliRunner().invoke(app, ["dataset", *where, "--config", str(tmp_path / "built.toml"), "--out", str(drive)])
    assert result.exit_code == 0, result.output
    (drive / "mav0/cam0/sensor.yaml").write_text(camera_sensor_text(built))
    data = open_dataset(drive)
    assert data.calibration.camera == built
    nav = run_backend(make_backend("ukf", data.calibration, seed=1, threads=1), data.events())
    assert data.truth is not None and nav.is_metric
    error = absolute_trajectory_error(nav.trajectory, data.truth, "yaw")
    assert nav.report.tracking_lost_s == 0
    assert error.rmse_m < 0.05 and error.rotation_rmse_rad < 0.02, error
