"""Keyframes are thinned without losing the motion between them; what has no solution leaves them as they are."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray
from station.model.frames import ImageFrame
from station.motion.preintegration import ImuSegment, preintegrate
from station.slam.mapping.inertial_graph import landmark_key
from station.slam.smoothing import batch
from station.slam.smoothing.batch import BatchInput, optimised, smooth_segment, thinned
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.keyframe import SmoothKeyframe
from station.slam.ukf.memory import RecentFrame
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

pytestmark = pytest.mark.computing

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)


def keyframe(number: int) -> SmoothKeyframe:
    none = TrackedFrame(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2)), 0, 0.0)
    t_ns = 150_000_000 * number
    source = RecentFrame(ImageFrame(number, t_ns, 0, b""), none, t_ns, None, None, None, None)
    steps = np.full(30, 0.005)
    imu = ImuSegment(steps, np.full((30, 3), 0.1), np.full((30, 3), 5.0), t_ns, np.zeros(3), np.ones((30, 6)))
    link = preintegrate(imu, np.zeros(6), NOISE) if number else None
    return SmoothKeyframe(
        number, source, none, link, None, 3, False, np.eye(4), np.zeros(3), np.zeros(6), np.zeros(3), 0,
        np.zeros(0, dtype=np.int64), None,
    )  # fmt: skip


@pytest.mark.parametrize("count", [7, 8, 41])
def test_thinned_keyframes_span_the_same_time_with_the_first_and_the_newest(count: int) -> None:
    whole = [keyframe(k) for k in range(count)]
    few = thinned(whole, 5)
    assert len(few) <= 5
    assert (few[0].number, few[-1].number) == (0, count - 1)
    links = [k.link for k in few[1:]]
    assert all(link is not None for link in links)
    assert sum(link.duration_s for link in links if link is not None) == pytest.approx(0.15 * (count - 1))
    assert sum(k.frames_since for k in few[1:]) == 3 * (count - 1)


def test_few_keyframes_stay_as_they_are() -> None:
    whole = [keyframe(k) for k in range(4)]
    assert thinned(whole, 5) is whole


def point_problem(jacobian: FloatArray, target: float) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """One point that shall lie at (target, target, target), with the derivative as given."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, H: list[FloatArray] | None) -> FloatArray:
        if H is not None:
            H[0] = jacobian
        return np.asarray(values.atPoint3(landmark_key(0)) - target)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [landmark_key(0)], error))
    values.insert(landmark_key(0), np.zeros(3))
    return graph, values


@pytest.mark.parametrize(
    ("jacobian", "target"), [(np.zeros((3, 3)), 1.0), (np.full((3, 3), np.nan), 1.0), (np.eye(3), np.nan)]
)
def test_equations_without_a_solution_are_an_error_and_not_their_start(jacobian: FloatArray, target: float) -> None:
    with pytest.raises(DegenerateGeometry):
        optimised(*point_problem(jacobian, target))


@pytest.mark.parametrize("target", [0.0, 1.0])
def test_a_problem_with_a_solution_is_solved_also_from_the_solution(target: float) -> None:
    assert optimised(*point_problem(np.eye(3), target)).atPoint3(landmark_key(0)) == pytest.approx(3 * [target])


def test_when_the_second_round_fails_keyframes_stay_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds: list[gtsam.Values] = []

    def second_fails(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
        if rounds:
            raise DegenerateGeometry("no solution")
        rounds.append(optimised(graph, values))
        return rounds[0]

    monkeypatch.setattr(batch, "optimised", second_fails)
    whole = [keyframe(k) for k in range(4)]
    camera = CameraModel.of(REFERENCE_CAMERA, 1.0)
    with pytest.raises(DegenerateGeometry):
        smooth_segment(whole, BatchInput(camera, NOISE, 9.81, SmoothingConfig(), None))
    assert len(rounds) == 1
    assert all(np.array_equal(k.T_world_body, np.eye(4)) and not k.v_world.any() for k in whole)
