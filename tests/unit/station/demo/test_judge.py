"""The demo's judge: right answers pass, wrong ones do not."""

from __future__ import annotations

import numpy as np
import pytest

from shared.errors import EstimationError
from shared.geometry import FloatArray, inverse, se3, transform, yaw_rotation
from station.demo.judge import Sample, Verdict, judge
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


def verdict(log: Trajectory, samples: list[Sample]) -> Verdict:
    T_map_truth = inverse(T_TRUTH_MAP)
    mapped = Trajectory(log.t_robot_ns[:41], T_map_truth @ log.T_world_body[:41])
    centroids = {name: transform(T_map_truth, c[None])[0] for name, c in CENTROIDS_TRUE.items()}
    return judge(mapped, centroids, log, samples, start_ns=46 * RATE_NS)


def test_right_answers_after_the_hijack_pass(log: Trajectory) -> None:
    result = verdict(log, [Sample(47 * RATE_NS, "unknown", None, 0.4), Sample(55 * RATE_NS, "known", "kitchen", 0.98)])
    assert result.passed
    assert (result.right, result.wrong, result.not_known) == (1, 0, 1)
    assert result.seconds_to_first_known == pytest.approx(0.9)
    assert result.map_error_m < 1e-9
    assert result.map_scale == pytest.approx(1.0)


def test_a_wrong_last_answer_fails(log: Trajectory) -> None:
    samples = [Sample((47 + i) * RATE_NS, "known", "kitchen", 0.9) for i in range(8)]
    assert verdict(log, samples).passed
    wrong = verdict(log, [*samples, *samples, *samples, Sample(55 * RATE_NS, "known", "hall", 0.9)])
    assert not wrong.passed and wrong.shortfall == "the last answer is wrong"


def test_unknown_at_the_end_fails(log: Trajectory) -> None:
    samples = [Sample(50 * RATE_NS, "known", "kitchen", 0.9), Sample(55 * RATE_NS, "unknown", None, 0.5)]
    assert not verdict(log, samples).passed and verdict(log, samples).shortfall == "the last answer is not known"


def test_one_wrong_answer_in_five_fails(log: Trajectory) -> None:
    samples = [Sample((47 + i) * RATE_NS, "known", "hall" if i == 0 else "kitchen", 0.9) for i in range(5)]
    result = verdict(log, samples)
    assert (result.right, result.wrong) == (4, 1)
    assert not result.passed and "one in ten" in result.shortfall


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
