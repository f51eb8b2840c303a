"""What the map's views see pulls keyframes to where it was seen from, also views between two keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, inverse, transform
from station.model.frames import ImageFrame
from station.motion.preintegration import ImuSegment, preintegrate
from station.slam.mapping.odometry_bundle import BundleState, Observations
from station.slam.smoothing.batch import BatchInput, SegmentProblem
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.keyframe import SmoothKeyframe
from station.slam.smoothing.view_adjuster import ViewAdjuster
from station.slam.ukf.memory import RecentFrame
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

pytestmark = pytest.mark.computing

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
GRAVITY = 9.81
FRAME_S, SPEED_M_S = 0.075, 0.5
KEYFRAMES = np.arange(0, 21, 2)  # frames: every second one
VIEWS = [0, 5, 11, 15, 20]  # between keyframes, too
DRIFT = 0.01  # of the way, sideways


def pose(frame: FloatArray, drift: float) -> FloatArray:
    """(..., 4, 4) straight ahead, drifting to the side."""
    T = np.tile(np.eye(4), (*frame.shape, 1, 1))
    T[..., 0, 3] = SPEED_M_S * FRAME_S * frame
    T[..., 1, 3] = drift * T[..., 0, 3]
    return T


def keyframes() -> list[SmoothKeyframe]:
    """As they drifted: the accelerometer has felt nothing but gravity."""
    none = TrackedFrame(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2)), 0, 0.0)
    n = round(2 * FRAME_S / 0.005)
    still = ImuSegment(
        np.full(n, 0.005), np.zeros((n, 3)), np.tile([0.0, 0.0, GRAVITY], (n, 1)), 0, np.zeros(3), np.ones((n, 6))
    )
    link = preintegrate(still, np.zeros(6), NOISE)
    out = []
    for number, frame in enumerate(KEYFRAMES.tolist()):
        t_ns = round(1e9 * FRAME_S * frame)
        source = RecentFrame(ImageFrame(frame, t_ns, 0, b""), none, t_ns, None, None, None, None)
        T = pose(np.array(frame, dtype=float), DRIFT)
        out.append(
            SmoothKeyframe(
                number,
                source,
                none,
                link if number else None,
                None,
                1,
                False,
                T,
                SPEED_M_S * np.array([1.0, DRIFT, 0.0]),
                np.zeros(6),
                np.zeros(3),
                0,
                np.zeros(0, dtype=np.int64),
                None,
            )
        )
    return out


def seen_by_views() -> tuple[BundleState, Observations]:
    """Thirty points as all views see them from their true poses, on a state of the drifted ones."""
    T_cam_body, views = REFERENCE_CAMERA.T_cam_body_matrix, np.array(VIEWS, dtype=float)
    points = np.random.default_rng(0).uniform([2.0, -1.0, -0.7], [4.0, 1.0, 0.7], (30, 3))
    p_cam = np.array([transform(T_cam_body @ inverse(T), points) for T in pose(views, 0.0)])
    assert (p_cam[..., 2] > 0.5).all()
    view, point = (a.ravel() for a in np.mgrid[: len(VIEWS), :30])
    xy = (p_cam[..., :2] / p_cam[..., 2:]).reshape(-1, 2)
    T = pose(views, DRIFT)
    state = BundleState(T[:, :3, :3], T[:, :3, 3], points + np.array([0.0, 0.005, 0.0]), np.zeros(0))
    return state, Observations(view, point, xy, T_cam_body, REFERENCE_CAMERA.fx)


def adjuster() -> ViewAdjuster:
    given = BatchInput(CameraModel.of(REFERENCE_CAMERA, 1.0), NOISE, GRAVITY, SmoothingConfig(), None)
    return ViewAdjuster(keyframes(), given, VIEWS, pose(np.array(VIEWS, dtype=float), DRIFT))


def test_views_pull_the_drift_out_of_keyframes() -> None:
    state, seen = seen_by_views()
    better = adjuster()(state, seen, 1.5)
    assert np.abs(state.p_world_body[:, 1]).max() == pytest.approx(0.0075)
    assert np.abs(better.p_world_body[:, 1:]).max() < 0.0005  # how far it went an even motion does not tell


def test_without_a_solution_views_stay_where_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    def unsolvable(_: SegmentProblem) -> None:
        raise DegenerateGeometry("no solution")

    monkeypatch.setattr(SegmentProblem, "solve", unsolvable)
    state, seen = seen_by_views()
    assert adjuster()(state, seen, 1.5) is state
