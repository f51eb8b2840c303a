"""The ukf backend on real sequences, and on input that is wrong."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import msgspec
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.errors import ConfigError, EstimationError
from station.datasets import Dataset, open_dataset
from station.experiments.trajectory_error import absolute_trajectory_error
from station.model.frames import ImageFrame, ImuBatch
from station.model.navigation import Navigation, Trajectory
from station.model.slam_update import SlamUpdate
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.start.starter import GivenState
from tests.support.paths import RECORDINGS

pytestmark = pytest.mark.computing

DATA = RECORDINGS
needs_data = pytest.mark.skipif(not (DATA / "euroc_v1_01_flight").is_dir(), reason="../shared/data is not here")


def run(data: Dataset, backend: UkfBackend) -> tuple[Navigation, list[SlamUpdate]]:
    updates = []
    for event in data.events():
        if isinstance(event, ImageFrame):
            updates.append(backend.add_frame(event))
        elif isinstance(event, ImuBatch):
            backend.add_imu(event)
        else:
            backend.add_drive(event)
    return backend.finish(), updates


def ate(trajectory: Trajectory, data: Dataset) -> float:
    truth = data.truth
    assert truth is not None
    error = absolute_trajectory_error(trajectory, Trajectory(truth.t_robot_ns, truth.T_world_body))
    return float(error.rmse_m)


def live(updates: list[SlamUpdate]) -> Trajectory:
    known = [u for u in updates if u.T_world_body is not None]
    return Trajectory(np.array([u.t_robot_ns for u in known]), np.array([u.T_world_body for u in known]))


@needs_data
def test_real_flight_from_its_own_start_in_motion() -> None:
    data = open_dataset(DATA / "euroc_v1_01_flight", None, None, 1)
    nav, updates = run(data, UkfBackend(data.calibration))
    first = next(i for i, u in enumerate(updates) if u.T_world_body is not None)
    assert updates[0].message.startswith("not initialised yet: needs")
    assert (updates[first].t_robot_ns - updates[0].t_robot_ns) * 1e-9 <= 1.6
    assert ate(live(updates), data) <= 0.025
    assert ate(nav.trajectory, data) <= 0.025
    assert len(nav.landmarks) > 200
    assert (nav.landmarks.num_observations >= 3).all()
    # Bit for bit the same, whatever the number of threads around it.
    cv2.setNumThreads(2)
    with threadpool_limits(limits=2):
        again, _ = run(data, UkfBackend(data.calibration))
    assert np.array_equal(again.trajectory.T_world_body, nav.trajectory.T_world_body)
    assert np.array_equal(again.landmarks.p_world, nav.landmarks.p_world)


@needs_data
def test_real_flight_from_a_given_state() -> None:
    data = open_dataset(DATA / "euroc_v1_01_flight", None, None, 1)
    truth = data.truth
    assert truth is not None and truth.v_world is not None
    assert truth.gyro_bias is not None and truth.accel_bias is not None
    i = int(np.argmin(np.abs(truth.t_robot_ns - data.frame_times_ns[0])))
    T = truth.T_world_body[i]
    given = GivenState(0, T[:3, :3], truth.v_world[i], T[:3, 3], truth.gyro_bias[i], truth.accel_bias[i])
    nav, updates = run(data, UkfBackend(data.calibration, initial_state=given))
    assert updates[0].state == "tracking"
    assert ate(live(updates), data) <= 0.025
    assert ate(nav.trajectory, data) <= 0.020


@needs_data
def test_real_standstill_does_not_drift() -> None:
    data = open_dataset(DATA / "euroc_v1_01_static", None, None, 1)
    nav, updates = run(data, UkfBackend(data.calibration))
    assert ate(live(updates), data) <= 0.005
    assert ate(nav.trajectory, data) <= 0.005
    T = nav.trajectory.T_world_body
    turn = np.degrees(np.arccos(np.clip(0.5 * (np.trace(T[0, :3, :3].T @ T[-1, :3, :3]) - 1.0), -1.0, 1.0)))
    assert turn <= 0.3


# ---- wrong input


@needs_data
def test_a_wrong_focal_length_is_said() -> None:
    data = open_dataset(DATA / "euroc_v1_01_flight", None, None, 1)
    camera = data.calibration.camera
    assert camera is not None
    wrong = msgspec.structs.replace(camera, fx=1.4 * camera.fx, fy=1.4 * camera.fy)
    nav, updates = run(data, UkfBackend(msgspec.structs.replace(data.calibration, camera=wrong)))
    assert any("image and IMU contradict each other" in message for message in nav.report.messages)
    assert any(u.state == "lost" for u in updates)


def frames(count: int, texture: bool = True, shape: tuple[int, int] = (480, 640)) -> Iterator[ImageFrame]:
    rng = np.random.default_rng(0)
    image = np.full(shape, 90, np.uint8)
    if texture:
        small = rng.integers(0, 255, (shape[0] // 16, shape[1] // 16)).astype(np.uint8)
        image = cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    encoded = cv2.imencode(".png", image)[1].tobytes()
    for k in range(count):
        yield ImageFrame(k, 10**9 + k * 50_000_000, 0, encoded)


def resting_imu(duration_s: float = 3.0, seed: int = 0) -> ImuBatch:
    t = (np.arange(round(duration_s * 225)) * 1e9 / 225).astype(np.int64) + 9 * 10**8
    rng = np.random.default_rng(seed)
    gyro = rng.normal([0.01, -0.02, 0.005], 0.004, (len(t), 3))
    return ImuBatch(t, gyro, rng.normal([0.0, 0.0, 9.81], 0.03, (len(t), 3)))


def test_starts_at_rest_and_finds_the_gyro_bias() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend.add_imu(resting_imu())
    updates = [backend.add_frame(f) for f in frames(24)]
    assert updates[-1].state == "tracking"
    T = updates[-1].T_world_body
    assert T is not None and np.linalg.norm(T[:3, 3]) < 0.01
    assert backend._filter is not None
    assert np.allclose(backend._filter.state.bias_gyro, [0.01, -0.02, 0.005], atol=2e-3)


def test_images_without_imu_say_what_is_missing() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    messages = {backend.add_frame(f).message for f in frames(5)}
    assert messages == {"not initialised yet: needs IMU samples"}
    with pytest.raises(EstimationError, match="needs IMU samples"):
        backend.finish()


def test_imu_without_images_says_what_is_missing() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend.add_imu(resting_imu())
    with pytest.raises(EstimationError, match="needs images"):
        backend.finish()


def test_a_calibration_without_imu_is_refused() -> None:
    with pytest.raises(ConfigError, match="IMU"):
        UkfBackend(Calibration(camera=REFERENCE_ROBOT.camera, imu=None))


def test_images_of_another_size_are_refused() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend.add_imu(resting_imu())
    with pytest.raises(ConfigError, match="640x480"):
        backend.add_frame(next(frames(1, shape=(480, 752))))


def test_bad_samples_and_frames_are_counted_and_change_nothing() -> None:
    clean, dirty = UkfBackend(REFERENCE_ROBOT), UkfBackend(REFERENCE_ROBOT)
    imu = resting_imu()
    clean.add_imu(imu)
    gyro = imu.gyro_imu.copy()
    half = len(imu) // 2
    dirty.add_imu(ImuBatch(imu.t_robot_ns[:half], gyro[:half], imu.accel_imu[:half]))
    dirty.add_imu(ImuBatch(imu.t_robot_ns[:5], gyro[:5] * 7, imu.accel_imu[:5]))  # late
    dirty.add_imu(ImuBatch(imu.t_robot_ns[half : half + 1] - 1, np.full((1, 3), np.nan), imu.accel_imu[:1]))
    dirty.add_imu(ImuBatch(imu.t_robot_ns[half:], gyro[half:], imu.accel_imu[half:]))
    stream = list(frames(24))
    for f in stream:
        a = clean.add_frame(f)
        b = dirty.add_frame(f)
        again = dirty.add_frame(f)
        assert "out of order" in again.message
        broken = dirty.add_frame(ImageFrame(f.index, f.t_robot_ns + 1, 0, b"no image", "x.png"))
        assert "not a readable" in broken.message
        assert a.state == b.state == again.state
        assert (a.T_world_body is None) == (b.T_world_body is None)
        if a.T_world_body is not None and b.T_world_body is not None:
            assert np.array_equal(a.T_world_body, b.T_world_body)
    assert dirty._imu.counts.not_finite == 1 and dirty._imu.counts.out_of_order == 5


def test_a_blank_wall_never_gives_a_pose() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend.add_imu(resting_imu())
    updates = [backend.add_frame(f) for f in frames(30, texture=False)]
    assert all(u.T_world_body is None for u in updates)
    assert "needs" in updates[-1].message


def test_a_covered_lens_is_noticed_within_two_seconds() -> None:
    backend = UkfBackend(msgspec.structs.replace(REFERENCE_ROBOT, rig="hand-held"))
    backend.add_imu(resting_imu(5.0))
    seen = [backend.add_frame(f) for f in frames(20)]
    assert seen[-1].state == "tracking"
    dark = [
        backend.add_frame(ImageFrame(20 + f.index, f.t_robot_ns + 20 * 50_000_000, 0, f.encoded))
        for f in frames(40, texture=False)
    ]
    assert dark[-1].state == "lost" and dark[-1].T_world_body is None


def test_a_silent_imu_ends_tracking() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend.add_imu(resting_imu(2.0))
    updates = [backend.add_frame(f) for f in frames(50)]
    assert any(u.state == "tracking" for u in updates)
    assert updates[-1].T_world_body is None
    assert any("IMU" in u.message for u in updates[-20:])
