"""A short drive writes a complete dataset."""

from pathlib import Path

import pytest

from robot.simulation.config import SimulationConfig
from robot.simulation.recording import record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.errors import DataError


def test_a_drive_writes_images_imu_truth_and_commands(tmp_path: Path) -> None:
    world = make_world("room", 1)
    route = plan_route(world, "triangle_a")
    result = record_drive(world, route, SimulationConfig(), 0, tmp_path / "drive", max_duration_s=2.5)
    mav = tmp_path / "drive" / "mav0"
    assert result.frames == len(list((mav / "cam0/data").glob("*.jpg"))) == 48
    assert len((mav / "imu0/data.csv").read_text().splitlines()) == pytest.approx(2.5 * 225, abs=3)
    assert len((mav / "state_groundtruth_estimate0/data.csv").read_text().splitlines()) > 500
    assert len((mav / "drive0/data.csv").read_text().splitlines()) > 10


def test_an_existing_folder_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "precious").write_text("x")
    world = make_world("room", 1)
    with pytest.raises(DataError, match="not empty"):
        record_drive(world, plan_route(world, "triangle_a"), SimulationConfig(), 0, tmp_path / "drive")
    assert (tmp_path / "drive" / "precious").read_text() == "x"
