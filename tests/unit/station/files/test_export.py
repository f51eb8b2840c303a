"""Exports are read back by the readers of their formats."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from shared.errors import DataError
from shared.geometry import FloatArray
from station.datasets import open_dataset
from station.files.navigation_folder import parse_tum, save_navigation
from station.files.ply import read_rows
from station.main import app
from station.model.navigation import Navigation
from tests.support.datasets import frames_of
from tests.support.navigations import small_navigation
from tests.support.open3d import skip_without_open3d
from tests.support.synthetic_home import drive, furnished_room, navigate

nav = small_navigation()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_navigation(nav, tmp_path / "nav")
    return tmp_path / "nav"


def export(folder: Path, file_format: str, out: Path) -> Path:
    result = CliRunner().invoke(app, ["export", str(folder), "--format", file_format, "--out", str(out)])
    if result.exception is not None:
        raise result.exception
    return out


@pytest.mark.parametrize("file_format", ["tum", "euroc"])
def test_a_trajectory_without_poses_is_not_exported(folder: Path, tmp_path: Path, file_format: str) -> None:
    (folder / "trajectory.tum").write_text("")
    with pytest.raises(DataError, match="not one pose"):
        export(folder, file_format, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_tum_and_ply_come_back(folder: Path, tmp_path: Path) -> None:
    written = export(folder, "tum", tmp_path / "a.tum")
    back = parse_tum(written.read_text(), written)
    np.testing.assert_allclose(back.T_world_body, nav.trajectory.T_world_body, atol=1e-8)
    np.testing.assert_array_equal(read_rows(export(folder, "ply", tmp_path / "a.ply")), nav.landmarks.p_world)


def test_euroc_folder_opens_as_a_dataset(folder: Path, tmp_path: Path) -> None:
    data = open_dataset(export(folder, "euroc", tmp_path / "asl"))
    assert [frame.t_robot_ns for frame in frames_of(data)] == nav.keyframes.t_robot_ns.tolist()
    assert [frame.encoded for frame in frames_of(data)] == list(nav.keyframes.encoded)
    assert data.calibration.camera is not None
    assert data.calibration.camera.fx == nav.calibration.camera.fx  # type: ignore[union-attr]


def test_mcap_holds_poses_keyframes_and_cloud(folder: Path, tmp_path: Path) -> None:
    with export(folder, "mcap", tmp_path / "a.mcap").open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert topics.count("/navigation/pose") == 3
    assert topics.count("/navigation/keyframe") == 2
    assert topics.count("/navigation/landmarks") == 1


def test_what_cannot_be_exported_is_said(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no place graph"):
        export(folder, "graphml", tmp_path / "g.graphml")
    export(folder, "tum", tmp_path / "a.tum")
    with pytest.raises(DataError, match="exists already"):
        export(folder, "tum", tmp_path / "a.tum")
    with pytest.raises(DataError, match="is no folder"):
        export(tmp_path / "nothing", "tum", tmp_path / "b.tum")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.tum", "nav"]


def test_evo_and_open3d_read_what_they_should(folder: Path, tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed")
    read = file_interface.read_tum_trajectory_file(str(export(folder, "tum", tmp_path / "a.tum")))
    np.testing.assert_allclose(np.array(read.poses_se3), nav.trajectory.T_world_body, atol=1e-8)
    cloud = export(folder, "ply", tmp_path / "a.ply")
    skip_without_open3d()
    # In a process of its own: its import brings a dozen warnings and threads along.
    code = "import sys, open3d; print(open3d.io.read_point_cloud(sys.argv[1]).points.__len__())"
    said = subprocess.run([sys.executable, "-W", "ignore", "-c", code, cloud], capture_output=True, text=True)
    assert said.stdout.split()[-1:] == [str(len(nav.landmarks))], said.stderr


def test_colmap_reads_the_model_and_its_points_fall_where_they_were_seen(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this machine")
    home = furnished_room(2)
    drive_nav = navigate(home, drive(home, 2, frames=10), seed=2)
    save_navigation(drive_nav, tmp_path / "nav")
    model = pycolmap.Reconstruction(str(export(tmp_path / "nav", "colmap", tmp_path / "model")))
    seen = np.flatnonzero(drive_nav.landmarks.num_observations)
    assert model.num_reg_images() == len(drive_nav.keyframes) and model.num_points3D() == len(seen)
    distances = []
    for image in model.images.values():
        for point in image.points2D:
            projected = image.project_point(model.points3D[point.point3D_id].xyz)
            assert projected is not None
            distances.append(float(np.linalg.norm(projected - point.xy)))
    ours = np.sort(reprojection_px(drive_nav))
    np.testing.assert_allclose(np.sort(distances), ours, atol=1e-3)
    assert len(list((tmp_path / "model" / "images").iterdir())) == len(drive_nav.keyframes)


def reprojection_px(navigation: Navigation) -> FloatArray:
    """(K,) px between where landmarks were seen and where they fall; without lens distortion."""
    camera, landmarks = navigation.calibration.camera, navigation.landmarks
    assert camera is not None
    T_cam_world = np.linalg.inv(navigation.keyframes.T_world_cam)[landmarks.observed_keyframe]
    p_world = landmarks.p_world[landmarks.observed_landmark]
    p_cam = np.einsum("kij,kj->ki", T_cam_world[:, :3, :3], p_world) + T_cam_world[:, :3, 3]
    uv = p_cam[:, :2] / p_cam[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return np.linalg.norm(uv - landmarks.observed_uv_px, axis=1)
