"""Recorded drives, end to end: a map from one, the other through the code of the live workers, places named right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robot.simulation.config import SimulationConfig
from robot.simulation.recording import record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from station.datasets import Dataset, open_dataset
from station.demo.judge import MIN_RIGHT_OF_KNOWN, align_map, carried, is_right, positions_at
from station.model.navigation import Trajectory
from station.model.place_answer import PlaceAnswer
from station.model.place_map import PlaceMap
from station.places.making.build import build_map
from station.workers.repeatable import repeatable
from station.workers.replay import ReplayOptions, follow, locate, locate_live
from tests.support.paths import RECORDINGS

pytestmark = [pytest.mark.computing, pytest.mark.slow]
DRIVEN_S = {"mapping": 30.0, "local": 20.0}  # through the first room and into the next; once more through the first
CAMERA_HZ = 12.0  # of the robot's 20: enough to follow it, and each costs a picture drawn and a step of SLAM


def truth_of(data: Dataset) -> Trajectory:
    assert data.truth is not None
    return Trajectory(data.truth.t_robot_ns, data.truth.T_world_body)


def named(place_map: PlaceMap, mapped: Dataset, answers: tuple[PlaceAnswer, ...], asked: Dataset) -> list[bool]:
    """Of each answer that names a place: whether it is the nearest one to where the camera truly was."""
    T_world_map = align_map(place_map.navigation.trajectory, truth_of(mapped)).T_target_source
    centroids = carried({place.id: place.centroid_map for place in place_map.places}, T_world_map)
    known = [(answer.place.id, answer.t_robot_ns) for answer in answers if answer.place is not None]
    where = positions_at(truth_of(asked), np.array([t for _, t in known], dtype=np.float64))
    return [is_right(place, centroids, p) for (place, _), p in zip(known, where, strict=True)]


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason=f"recorded data is not at {RECORDINGS}")
def test_places_of_a_real_kitchen_are_named_right_when_somebody_passes_again() -> None:
    mapped = open_dataset(RECORDINGS / "redkitchen", 0, 398, step=4)
    again = open_dataset(RECORDINGS / "redkitchen", 500, 698, step=4)
    with repeatable(1):
        navigation, _ = follow(mapped, ReplayOptions("sfm"))
        place_map = build_map(navigation)
        answers, _ = locate(again, place_map, (), ReplayOptions())
    right = named(place_map, mapped, answers, again)
    assert len(right) >= 5 and all(right), [answer.reason for answer in answers]


def test_places_of_a_simulated_flat_are_named_right_on_the_second_drive(tmp_path: Path, textures: Path) -> None:
    world, config = make_world("small", 1), SimulationConfig(camera_rate_hz=CAMERA_HZ)
    for number, (kind, seconds) in enumerate(DRIVEN_S.items()):
        record_drive(world, plan_route(world, kind), config, number, tmp_path / kind, textures, max_duration_s=seconds)
    mapped, again = open_dataset(tmp_path / "mapping"), open_dataset(tmp_path / "local")
    with repeatable(1):
        navigation, _ = follow(mapped, ReplayOptions("ukf"))
        place_map = build_map(navigation)
    answers, hijacks = locate_live(again, place_map, ReplayOptions("ukf"))
    right = named(place_map, mapped, answers, again)
    assert not hijacks
    assert len(right) >= 5 and np.mean(right) >= MIN_RIGHT_OF_KNOWN, [answer.reason for answer in answers]
