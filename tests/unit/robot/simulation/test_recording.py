"""A short drive writes a complete dataset."""

import math
from pathlib import Path

import numpy as np
import pytest

from robot.simulation.config import SimulationConfig, without_imperfections
from robot.simulation.driver import LookAround
from robot.simulation.recording import START_NS, record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_HEAD
from shared.errors import DataError
from station.datasets import open_dataset


def test_a_drive_writes_images_imu_truth_and_commands(tmp_path: Path) -> None:
    world = make_world("room", 1)
    route = plan_route(world, "triangle_a")
    result = record_drive(world, route, SimulationConfig(), 0, tmp_path / "drive", max_duration_s=2.5)
    mav = tmp_path / "drive" / "mav0"
    assert result.frames == len(list((mav / "cam0/data").glob("*.jpg"))) == 48
    assert len((mav / "imu0/data.csv").read_text().splitlines()) == pytest.approx(2.5 * 225, abs=3)
    assert len((mav / "state_groundtruth_estimate0/data.csv").read_text().splitlines()) > 500
    assert len((mav / "drive0/data.csv").read_text().splitlines()) > 10


def test_a_head_that_looks_around_is_in_the_dataset_and_the_pictures(tmp_path: Path) -> None:
    world = make_world("room", 1)
    route = plan_route(world, "triangle_a")
    config = without_imperfections()
    for name, look_around in (("ahead", None), ("around", LookAround(math.radians(60)))):
        record_drive(world, route, config, 0, tmp_path / name, max_duration_s=4.0, look_around=look_around)
    ahead, around = (open_dataset(tmp_path / name) for name in ("ahead", "around"))
    assert ahead.calibration.head is None and around.calibration.head == REFERENCE_HEAD
    assert not any(d.pan_rad for d in ahead.drive)
    pans = np.array([d.pan_rad for d in around.drive])
    assert pans.max() == pytest.approx(math.radians(60), abs=1e-5) and (np.abs(np.diff(pans)) < 0.06).all()
    assert ahead.read_frames is not None and around.read_frames is not None
    pairs = list(zip(ahead.read_frames(), around.read_frames(), strict=True))
    is_same = [a.encoded == b.encoded for a, b in pairs]
    turns_ns = START_NS + round(1.5e9)  # and the robot begins to drive
    assert [s for s, (a, _) in zip(is_same, pairs, strict=True) if a.t_robot_ns < turns_ns].count(False) == 0
    assert is_same[-40:].count(True) == 0


def test_an_existing_folder_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "precious").write_text("x")
    world = make_world("room", 1)
    with pytest.raises(DataError, match="not empty"):
        record_drive(world, plan_route(world, "triangle_a"), SimulationConfig(), 0, tmp_path / "drive")
    assert (tmp_path / "drive" / "precious").read_text() == "x"
