"""Structure from motion on recorded and simulated drives, judged by their truth.

Bounds are about twice what was measured (docs/studies/sfm.md): they notice a broken step, not a bad day.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.commands.slam import summary
from station.datasets import Dataset, open_dataset
from station.experiments.depth_truth import align_by_depth
from station.experiments.trajectory_error import absolute_trajectory_error
from station.model.navigation import Navigation
from station.slam.backend import SlamBackend
from station.slam.backends import make_backend
from station.slam.run import run_backend
from tests.support.paths import RECORDINGS

DATA = RECORDINGS
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"recorded data is not at {DATA}")


def backend_of(data: Dataset) -> SlamBackend:
    return make_backend("sfm", data.calibration, seed=1, threads=1, intrinsics_known=data.intrinsics_known)


def reconstruct(data: Dataset) -> Navigation:
    return run_backend(backend_of(data), data.events())


@needs_data
def test_kitchen_without_imu_is_right_up_to_a_similarity() -> None:
    data = replace(open_dataset(DATA / "redkitchen", 120, 220, step=2), read_depth=None)
    nav = reconstruct(data)
    truth = data.truth
    assert truth is not None
    assert nav.report.scale == "arbitrary" and not nav.is_gravity_aligned
    assert absolute_trajectory_error(nav.trajectory, truth, "sim3").rmse_m < 0.04
    assert len(nav.landmarks) > 500 and nav.landmarks.num_observations.min() >= 3
    assert nav.calibration.camera is not None and 480 < nav.calibration.camera.fx < 580  # refined from a guess of 525
    assert "arbitrary scale" in summary(nav, Path("nav"))


@needs_data
def test_kitchen_gets_its_metres_from_depth_in_every_tenth_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    data = open_dataset(DATA / "redkitchen", 500, 698)
    backend, plain = backend_of(data), list[Navigation]()
    finish = backend.finish

    def finished() -> Navigation:
        plain.append(finish())
        return plain[0]

    monkeypatch.setattr(backend, "finish", finished)
    nav = run_backend(backend, data.events())
    assert data.truth is not None
    assert nav.is_metric and not nav.is_gravity_aligned
    assert nav.report.config["depth"]["scans"] == 20
    assert abs(align_by_depth(nav, data.truth).scale - 1.0) < 0.02
    assert "metres by depth" in summary(nav, Path("nav"))
    assert plain[0].report.scale == "arbitrary"
    shape = plain[0].keyframes.T_world_cam[:, :3, 3] * nav.report.config["depth"]["scale"]
    np.testing.assert_allclose(nav.keyframes.T_world_cam[:, :3, 3], shape, rtol=1e-9)


@needs_data
def test_flight_gets_metres_and_gravity_from_its_imu() -> None:
    data = open_dataset(DATA / "euroc_v1_01_keyframes")
    nav = reconstruct(data)
    truth = data.truth
    assert truth is not None
    assert nav.is_metric and nav.is_gravity_aligned
    assert len(nav.keyframes) >= 45
    assert absolute_trajectory_error(nav.trajectory, truth, "yaw").rmse_m < 0.08
    assert absolute_trajectory_error(nav.trajectory, truth, "sim3").alignment.scale == pytest.approx(1.0, abs=0.05)


def test_simulated_drive_holds_together_and_is_metric(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from robot.simulation.cli import app

    arguments = ["dataset", "--world", "home", "--seed", "11", "--route", "mapping", "--max-duration", "11"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "drive")])
    assert result.exit_code == 0, result.output
    data = open_dataset(tmp_path / "drive")
    nav = reconstruct(data)
    truth = data.truth
    assert truth is not None
    assert nav.report.config["mapping"] == "odometry and images"
    assert nav.is_metric and nav.is_gravity_aligned and nav.report.tracking_lost_s == 0
    error = absolute_trajectory_error(nav.trajectory, truth, "yaw")
    assert error.rmse_m < 0.15 and error.rotation_rmse_rad < 0.03
    assert absolute_trajectory_error(nav.trajectory, truth, "sim3").rmse_m < 0.05
    assert len(nav.landmarks) > 500
