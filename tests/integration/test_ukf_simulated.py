"""The ukf backend on a simulated robot that is blinded and carried away: noticed in time, started again, mapped."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from robot.simulation.atlas import default_cache_dir
from robot.simulation.body import Body
from robot.simulation.config import Faults, SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.sensors import ImuModel
from robot.simulation.trajectory import MotionHistory
from robot.simulation.worlds import make_world
from shared.geometry import FloatArray, transform
from station.experiments.alignment import align_points
from station.model.frames import DriveSample, ImageArray, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.slam.ukf.backend import UkfBackend

pytestmark = pytest.mark.computing

COVERED_S = (4.5, 7.0)
HIJACK_S = 10.5
END_S = 16.0
FRAME_S = 1 / 12
CONFIG = SimulationConfig(camera_rate_hz=1 / FRAME_S)
CALIBRATION = simulated_calibration(CONFIG)


def as_jpeg(image: ImageArray) -> bytes:
    ok, encoded = cv2.imencode(".jpg", image)
    assert ok
    return encoded.tobytes()


def drive(truth: dict[int, FloatArray] | None = None) -> Iterator[ImuBatch | DriveSample | ImageFrame]:
    """An arc in a box of checkerboards; the lens is covered for a while, later hands carry the robot away.

    truth: of a drive before a blank wall for that while; gets where the body was (3,) at each image. It ends before the
    hands come.
    """
    wall = b""
    camera, noise = CALIBRATION.camera, CALIBRATION.imu
    assert camera is not None and noise is not None
    world = make_world("checker", 0)
    body = Body(world, CONFIG.body, (1.0, 1.2, 0.3), 1)
    imu = ImuModel(noise, CONFIG.imu, CALIBRATION.gravity, 1)
    eye = SimulatedCamera(Renderer(world, camera, default_cache_dir()), camera, CONFIG.camera, 1)
    history, state, next_frame_s, index, ticks, hijacked = MotionHistory(keep_s=2.0), body.state(), 0.1, 0, 0, False
    while state.t_s < (END_S if truth is None else HIJACK_S):
        history.append(state)
        t_ns = 10**9 + round(state.t_s * 1e9)
        m = imu.measure(state)
        yield ImuBatch(np.array([t_ns]), m.gyro_imu[None], m.accel_imu[None])
        if state.t_s - next_frame_s > 0.05:
            is_blind = COVERED_S[0] < next_frame_s < COVERED_S[1]
            faults = Faults(covered_lens=is_blind and truth is None)
            seen = eye.expose(history.pose, next_frame_s, faults, history.carried(next_frame_s))
            stamp = 10**9 + round((next_frame_s - camera.time_shift_s) * 1e9)
            if truth is not None:
                truth[stamp] = history.pose(next_frame_s)[:3, 3]
                wall = wall if is_blind else as_jpeg(np.full_like(seen.image, round(float(seen.image.mean()))))
            yield ImageFrame(index, stamp, 0, wall if is_blind and truth is not None else seen.jpeg)
            index, next_frame_s = index + 1, next_frame_s + FRAME_S
        if not hijacked and state.t_s > HIJACK_S:
            hijacked = True
            body.command(0.0, 0.0)
            body.hijack(2.6, 1.2, 2.0)
        elif ticks % 15 == 0 and state.t_s > 1.2:
            speed, turn = (0.0, 0.0) if hijacked else (0.15, 0.6 if state.t_s < 8.0 else -0.6)
            body.command(speed, turn)
            yield DriveSample(t_ns, speed, turn)
        state, ticks = body.step(), ticks + 1


@pytest.fixture(scope="module")
def run() -> tuple[Navigation, list[tuple[float, SlamUpdate]]]:
    backend, updates = UkfBackend(CALIBRATION), []
    assert CALIBRATION.camera is not None
    for event in drive():
        if isinstance(event, ImuBatch):
            backend.add_imu(event)
        elif isinstance(event, DriveSample):
            backend.add_drive(event)
        else:
            t_s = (event.t_robot_ns - 10**9) * 1e-9 + CALIBRATION.camera.time_shift_s
            updates.append((t_s, backend.add_frame(event)))
    return backend.finish(), updates


def lost_after(updates: list[tuple[float, SlamUpdate]], begin_s: float) -> float:
    """Seconds until the backend says that tracking is lost."""
    return next(t for t, u in updates if t > begin_s and u.state == "lost") - begin_s


def test_a_covered_lens_is_tracking_lost_within_two_seconds(
    run: tuple[Navigation, list[tuple[float, SlamUpdate]]],
) -> None:
    _, updates = run
    assert all(u.state == "tracking" for t, u in updates if 1.5 < t < COVERED_S[0])
    assert lost_after(updates, COVERED_S[0]) <= 2.0


def test_tracking_starts_again_as_a_new_segment(run: tuple[Navigation, list[tuple[float, SlamUpdate]]]) -> None:
    nav, updates = run
    again = [u for t, u in updates if COVERED_S[1] + 2.0 < t < HIJACK_S]
    assert {u.state for u in again} == {"tracking"}
    assert {u.segment for u in again} == {1}
    assert {0, 1} <= set(nav.keyframes.segment.tolist())
    assert nav.report.tracking_lost_s > 0.3
    assert any("nothing to follow" in message for message in nav.report.messages)


def test_under_a_cover_the_wheels_go_on(run: tuple[Navigation, list[tuple[float, SlamUpdate]]]) -> None:
    """Commands come between all frames: what the wheels roll before each of them counts."""
    _, updates = run
    seen = [(t, u.T_world_body[:3, 3], u.segment) for t, u in updates if u.T_world_body is not None]
    t_before, x_before, _ = next(s for s in seen if s[0] > COVERED_S[0] - 2 * FRAME_S)
    t_after, x_after, _ = next(s for s in seen if s[2] == 1)
    rolled_m = 0.96 * 0.15 * (t_after - t_before)  # of the simulated body; by a tenth of a radian less on its arc
    assert float(np.linalg.norm(x_after - x_before)) == pytest.approx(rolled_m, rel=0.1)


def test_before_a_blank_wall_the_robot_is_followed_by_wheels_and_imu() -> None:
    backend, truth, poses = UkfBackend(CALIBRATION), dict[int, FloatArray](), []
    for event in drive(truth):
        if isinstance(event, ImuBatch):
            backend.add_imu(event)
        elif isinstance(event, DriveSample):
            backend.add_drive(event)
        elif (update := backend.add_frame(event)).T_world_body is not None:
            poses.append((update.t_robot_ns, update.T_world_body[:3, 3]))
            assert update.segment == 0
    nav = backend.finish()
    assert set(nav.keyframes.segment.tolist()) == {0} and nav.report.tracking_lost_s == 0.0
    true, found = np.array([truth[t] for t, _ in poses]), np.array([p for _, p in poses])
    error_m = np.linalg.norm(transform(align_points(true, found, "yaw").T_target_source, found) - true, axis=1)
    assert float(error_m.max()) < 0.03


def test_a_hijack_is_tracking_lost_within_two_seconds(
    run: tuple[Navigation, list[tuple[float, SlamUpdate]]],
) -> None:
    _, updates = run
    lifted_s = HIJACK_S + 1.0  # hands hold the wheels for a second before they lift
    assert lost_after(updates, HIJACK_S) <= lifted_s - HIJACK_S + 2.0


def test_chessboards_are_mapped_from_tracks_and_no_landmark_spans_two_segments(
    run: tuple[Navigation, list[tuple[float, SlamUpdate]]],
) -> None:
    nav, _ = run
    landmarks, keyframes = nav.landmarks, nav.keyframes
    assert nav.report.config["mapped_from"] == "tracks"
    assert len(landmarks) > 100 and landmarks.observed_keyframe.max() < len(keyframes)
    assert (landmarks.num_observations >= 3).all()
    segment = keyframes.segment[landmarks.observed_keyframe]
    lowest = np.full(len(landmarks), 99)
    highest = np.zeros(len(landmarks), dtype=np.int64)
    np.minimum.at(lowest, landmarks.observed_landmark, segment)
    np.maximum.at(highest, landmarks.observed_landmark, segment)
    assert (lowest == highest).all()
