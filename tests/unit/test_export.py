"""Exports are read back by the readers of their formats."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from test_navigation_files import small_navigation
from typer.testing import CliRunner

from shared.errors import DataError
from station.datasets import open_dataset
from station.main import app
from station.navigation_files import read_tum, save_navigation
from station.ply import read_points

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


def test_tum_and_ply_come_back(folder: Path, tmp_path: Path) -> None:
    back = read_tum(export(folder, "tum", tmp_path / "a.tum"))
    np.testing.assert_allclose(back.T_world_body, nav.trajectory.T_world_body, atol=1e-8)
    np.testing.assert_array_equal(read_points(export(folder, "ply", tmp_path / "a.ply")), nav.landmarks.p_world)


def test_euroc_folder_opens_as_a_dataset(folder: Path, tmp_path: Path) -> None:
    data = open_dataset(export(folder, "euroc", tmp_path / "asl"))
    assert [frame.t_robot_ns for frame in data.frames()] == nav.keyframes.t_robot_ns.tolist()
    assert [frame.encoded for frame in data.frames()] == list(nav.keyframes.encoded)
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
