"""The demo's judge: right answers pass, wrong ones do not."""

from __future__ import annotations

import numpy as np
import pytest

from shared.errors import EstimationError
from shared.geometry import FloatArray, inverse, se3, transform, yaw_rotation
from station.demo.judge import Sample, TrueRoom, Verdict, is_room_right, judge, true_rooms_of
from station.model.navigation import Trajectory

RATE_NS = 100_000_000
T_TRUTH_MAP = se3(yaw_rotation(0.7), np.array([3.0, -2.0, 0.1]))
CENTROIDS_TRUE = {"kitchen": np.array([0.0, 0.0, 1.0]), "hall": np.array([4.0, 0.0, 1.0])}


def drive(x_m: FloatArray) -> Trajectory:
    poses = np.tile(np.eye(4), (len(x_m), 1, 1))
    poses[:, 0, 3] = x_m
    poses[:, 1, 3] = 0.3 * np.sin(x_m)
    return Trajectory(np.arange(len(x_m), dtype=np.int64) * RATE_NS, poses)


@pytest.fixture
def log() -> Trajectory:
    return drive(np.concatenate([np.linspace(0, 4, 41), np.full(5, 4.0), np.linspace(0, 1, 11)]))


def verdict(log: Trajectory, samples: list[Sample], map_size: float = 1.0) -> Verdict:
    """Args: map_size: map length per true length."""
    T_map_truth = inverse(T_TRUTH_MAP)
    poses = T_map_truth @ log.T_world_body[:41]
    poses[:, :3, 3] *= map_size
    mapped = Trajectory(log.t_robot_ns[:41], poses)
    centroids = {name: map_size * transform(T_map_truth, c[None])[0] for name, c in CENTROIDS_TRUE.items()}
    return judge(mapped, centroids, log, samples, start_ns=46 * RATE_NS)


def test_right_answers_after_the_hijack_pass(log: Trajectory) -> None:
    known = [Sample((53 + i) * RATE_NS, "known", "kitchen", 0.98) for i in range(3)]
    result = verdict(log, [Sample(47 * RATE_NS, "unknown", None, 0.4), *known])
    assert result.passed
    assert (result.right, result.wrong, result.not_known) == (3, 0, 1)
    assert result.seconds_to_first_known == pytest.approx(0.7)
    assert result.map_error_m < 1e-9
    assert result.map_scale == pytest.approx(1.0)


def test_a_wrong_last_answer_fails(log: Trajectory) -> None:
    samples = [Sample((47 + i) * RATE_NS, "known", "kitchen", 0.9) for i in range(8)]
    assert verdict(log, samples).passed
    wrong = verdict(log, [*samples, *samples, *samples, Sample(55 * RATE_NS, "known", "hall", 0.9)])
    assert not wrong.passed and wrong.shortfall == "the last answer is wrong"


def test_unknown_at_the_end_fails(log: Trajectory) -> None:
    known = [Sample((48 + i) * RATE_NS, "known", "kitchen", 0.9) for i in range(4)]
    result = verdict(log, [*known, Sample(55 * RATE_NS, "unknown", None, 0.5)])
    assert not result.passed and result.shortfall == "the last answer is not known"


def test_one_wrong_answer_in_five_fails(log: Trajectory) -> None:
    samples = [Sample((47 + i) * RATE_NS, "known", "hall" if i == 0 else "kitchen", 0.9) for i in range(5)]
    result = verdict(log, samples)
    assert (result.right, result.wrong) == (4, 1)
    assert not result.passed and "one in ten" in result.shortfall


@pytest.mark.parametrize(("num_known", "passes"), [(7, True), (6, False)])
def test_a_run_with_fewer_than_seven_of_ten_answers_known_fails(log: Trajectory, num_known: int, passes: bool) -> None:
    silent = [Sample(47 * RATE_NS, "unknown", None, 0.4)] * (10 - num_known)
    known = [Sample(55 * RATE_NS, "known", "kitchen", 0.9)] * num_known
    result = verdict(log, [*silent, *known])
    assert result.passed == passes
    assert result.shortfall == ("" if passes else "only 6 of 10 answers are known, fewer than 70%")


@pytest.mark.parametrize(("map_size", "passes"), [(1.025, True), (0.975, True), (1.04, False), (0.96, False)])
def test_a_map_of_the_wrong_size_fails_however_right_its_places_are(
    log: Trajectory, map_size: float, passes: bool
) -> None:
    result = verdict(log, [Sample(55 * RATE_NS, "known", "kitchen", 0.9)], map_size)
    assert result.map_scale == pytest.approx(1.0 / map_size)
    assert result.map_error_m < 1e-9 and result.wrong == 0
    assert result.passed == passes
    assert passes or result.shortfall == f"the map's scale is {1.0 / map_size:.3f}, off by more than 3%"


def test_everything_that_a_run_lacks_is_said(log: Trajectory) -> None:
    unsure = [Sample(55 * RATE_NS, "unknown", None, 0.4)] * 4
    result = verdict(log, [Sample(50 * RATE_NS, "known", "hall", 0.9), *unsure], map_size=1.1)
    assert result.shortfall == (
        "more than one in ten of the known answers is wrong; the last answer is not known; "
        "only 1 of 5 answers are known, fewer than 70%; the map's scale is 0.909, off by more than 3%"
    )


def test_answers_before_the_hijack_do_not_count(log: Trajectory) -> None:
    with pytest.raises(EstimationError, match="no answer"):
        verdict(log, [Sample(10 * RATE_NS, "known", "kitchen", 1.0)])


def test_each_answer_stands_beside_the_truth(log: Trajectory) -> None:
    at_start = transform(inverse(T_TRUTH_MAP), np.array([[0.5, 0.0, 0.0]]))[0]
    wrong = Sample(50 * RATE_NS, "known", "hall", 0.9, (at_start[0], at_start[1], at_start[2]))
    unsure = Sample(55 * RATE_NS, "lost", None, 0.4)
    first, second = verdict(log, [wrong, unsure]).answers
    assert (first.right, first.nearest_place_id) == (False, "kitchen")
    truth = np.array(first.position_true)
    assert first.position_error_m == pytest.approx(np.linalg.norm(truth - [0.5, 0.0, 0.0]), abs=2e-3)
    assert (second.right, second.position_error_m) == (None, None)


ROOMS = (TrueRoom("kitchen", (-1.0, -2.0), (2.0, 2.0)), TrueRoom("hall", (2.1, -2.0), (6.0, 2.0)))


@pytest.mark.parametrize(
    ("x_m", "named", "right"), [(0.0, "k", True), (4.0, "k", False), (2.4, "k", True), (4.0, "none", False)]
)
def test_the_room_is_judged_too_and_both_are_right_in_a_doorway(x_m: float, named: str, right: bool) -> None:
    middles = {"k": np.array([0.5, 0.0, 0.0]), "h": np.array([4.0, 0.0, 0.0])}
    true_rooms = true_rooms_of(middles, ROOMS, np.eye(4))
    assert {room_id: room.name for room_id, room in true_rooms.items()} == {"k": "kitchen", "h": "hall"}
    assert is_room_right(named, true_rooms, np.array([x_m, 0.0, 0.0])) is right
    assert is_room_right(None, true_rooms, np.array([x_m, 0.0, 0.0])) is None
