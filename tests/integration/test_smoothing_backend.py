"""The smoothing backend on real sequences, and on input that is wrong."""

from __future__ import annotations

from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from shared.calibration import REFERENCE_ROBOT
from shared.errors import ConfigError, EstimationError
from station.datasets import Dataset, open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error
from station.model.frames import ImageFrame
from station.model.navigation import Navigation, Trajectory
from station.model.slam_update import SlamUpdate
from station.slam.backends import make_backend
from station.slam.run import run_backend
from tests.support.paths import RECORDINGS

pytestmark = pytest.mark.computing

needs_data = pytest.mark.skipif(not (RECORDINGS / "euroc_v1_01_flight").is_dir(), reason="../shared/data is not here")


def run(name: str) -> tuple[Dataset, Navigation, list[SlamUpdate]]:
    data = open_dataset(RECORDINGS / name, None, None, 1)
    updates: list[SlamUpdate] = []
    return data, run_backend(make_backend("smoothing", data.calibration), data.events(), updates.append), updates


def ate(trajectory: Trajectory, data: Dataset) -> float:
    truth = data.truth
    assert truth is not None
    return absolute_trajectory_error(trajectory, Trajectory(truth.t_robot_ns, truth.T_world_body)).rmse_m


@needs_data
def test_real_flight_is_known_within_12_mm_and_followed_within_16_with_the_same_bits_on_two_threads() -> None:
    with threadpool_limits(limits=1):
        data, one, updates = run("euroc_v1_01_flight")
    with threadpool_limits(limits=2):
        _, two, again = run("euroc_v1_01_flight")
    assert ate(one.trajectory, data) < 0.012
    assert one.report.backend == "smoothing"
    assert len(one.landmarks) > 150
    assert one.id == two.id
    assert one.trajectory.T_world_body.tobytes() == two.trajectory.T_world_body.tobytes()
    seen = [
        (t, u.T_world_body) for t, u in zip(data.frame_times_ns, updates, strict=True) if u.T_world_body is not None
    ]
    poses = [T for _, T in seen]
    assert len(poses) > 60
    # A global shutter without a time shift: images have the IMU's times.
    assert ate(Trajectory(np.array([t for t, _ in seen]), np.array(poses)), data) < 0.016
    assert (
        np.array(poses).tobytes() == np.array([u.T_world_body for u in again if u.T_world_body is not None]).tobytes()
    )


@needs_data
def test_a_rig_at_rest_stays_where_it_is() -> None:
    data, nav, _ = run("euroc_v1_01_static")
    assert ate(nav.trajectory, data) < 0.005


@needs_data
def test_what_was_followed_before_an_outage_is_kept() -> None:
    data = open_dataset(RECORDINGS / "euroc_v1_01_flight", None, None, 1)
    times = data.frame_times_ns
    begin, end = times[int(0.4 * len(times))], times[int(0.7 * len(times))]
    ok, black = cv2.imencode(".png", np.zeros((480, 752), np.uint8))
    assert ok
    events = (
        replace(event, encoded=black.tobytes())
        if isinstance(event, ImageFrame) and begin <= event.t_robot_ns < end
        else event
        for event in data.events()
    )
    nav = run_backend(make_backend("smoothing", data.calibration), events)
    assert any("tracking lost" in message for message in nav.report.messages)
    before = nav.trajectory.t_robot_ns < begin
    assert before.sum() > 20
    assert ate(Trajectory(nav.trajectory.t_robot_ns[before], nav.trajectory.T_world_body[before]), data) < 0.02


def test_without_an_imu_another_backend_is_named() -> None:
    with pytest.raises(ConfigError, match="sfm"):
        make_backend("smoothing", msgspec.structs.replace(REFERENCE_ROBOT, imu=None))


def test_without_images_the_reason_is_said() -> None:
    with pytest.raises(EstimationError, match="no usable image came"):
        make_backend("smoothing", REFERENCE_ROBOT).finish()
