"""Loops closed while driving, on features of a round hall that is driven through twice by an odometry that drifts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from shared.calibration import CameraCalibration, ImuNoise
from shared.geometry import FloatArray, inverse, se3, so3_exp, yaw_rotation
from station.model.frames import ImageFrame
from station.slam.smoothing.closing import Claim, LoopCloser
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.views import MapViews, View, ViewConfig
from station.vision.camera_model import CameraModel
from station.vision.features import Details, Features
from station.vision.klt import TrackedFrame

pytestmark = pytest.mark.computing

R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along body x
CAMERA = CameraCalibration(
    width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0,
    T_body_cam=tuple(se3(R_BODY_CAM, np.array([0.1, 0.0, 0.2])).ravel().tolist()),
)  # fmt: skip
MODEL = CameraModel.of(CAMERA, 1.0)
NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
PER_LAP, VIEWS = 32, 56
FRAMES_PER_VIEW = 8
WIDE = np.array([640.0, 480.0])


class Hall:
    """A wall all around with marks on it. In the second lap it stands `aside_m` away: that of another, equal hall."""

    def __init__(self, aside_m: float = 0.0) -> None:
        rng = np.random.default_rng(5)
        n = 700
        angle, height = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-0.8, 1.2, n)
        radius = rng.uniform(2.5, 4.0, n)
        self.descriptors = rng.integers(0, 256, (n, 128), dtype=np.uint8)
        self.points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        self._aside = np.array([aside_m, 0.0, 0.0])
        self._noise = rng.normal(0.0, 0.3, (VIEWS, n, 2))

    def features(self, view: int, T_world_cam: FloatArray) -> Features:
        points = self.points + (self._aside if view >= PER_LAP else 0.0)
        p = (points - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
        uv = 500.0 * p[:, :2] / np.maximum(p[:, 2:], 0.1) + np.array([320.0, 240.0]) + self._noise[view]
        seen = (p[:, 2] > 0.3) & (uv > 0).all(axis=1) & (uv < WIDE).all(axis=1)
        return Features(uv[seen], self.descriptors[seen])


def true_pose(view: int) -> FloatArray:
    """Around the hall, looking at its wall."""
    a = 2.0 * np.pi * view / PER_LAP
    return se3(yaw_rotation(a), np.array([1.2 * np.cos(a), 1.2 * np.sin(a), 0.0]))


def drifted(view: int) -> FloatArray:
    """As the odometry has it: 0.2 degrees too far and a bit aside with each view."""
    T = true_pose(view)
    return se3(so3_exp(np.array([0.0, 0.0, 0.0006 * view])), np.array([0.003 * view, -0.001 * view, 0.0])) @ T


class Drive:
    """Frames of which every eighth is a view; poses by the odometry."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, hall: Hall, capacity: int = 300) -> None:
        self.views = MapViews(MODEL.lens, ViewConfig(capacity=capacity), 0)
        monkeypatch.setattr(self.views, "_extractor", self)
        monkeypatch.setattr(ImageFrame, "grey", lambda frame: frame)
        self._hall = hall
        self.closer = LoopCloser(self.views, 0, self.odometry, MODEL, NOISE, np.eye(4))
        self.corrections: list[FloatArray] = []

    def extract(self, frame: ImageFrame) -> Details:
        view = frame.index // FRAMES_PER_VIEW
        found = self._hall.features(view, true_pose(view) @ CAMERA.T_body_cam_matrix)
        return Details(found, found)

    def odometry(self, frame: int) -> FloatArray:
        return drifted(frame // FRAMES_PER_VIEW)

    def run(self, views: int = VIEWS, in_idle: Callable[[Drive], object] | None = None, first: int = 0) -> None:
        """Args: in_idle: what is done between frames."""
        nothing = TrackedFrame(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2)), 0, 0.0)
        for frame in range(first * FRAMES_PER_VIEW, views * FRAMES_PER_VIEW):
            if frame % FRAMES_PER_VIEW == 0:
                image = ImageFrame(frame, frame * 100_000_000, 0, b"")
                T = self.odometry(frame)
                zero = np.zeros(3)
                rgb = np.zeros((0, 3), dtype=np.uint8)
                self.views.add(Keyframe(image, nothing, rgb, T, zero, zero, np.zeros(6), 0, None, None))
            self.closer.look()
            self.corrections.append(self.closer.T_map_odom)
            if in_idle is not None:
                in_idle(self)


def off_m(T_map_odom: FloatArray, view: int) -> float:
    return float(np.linalg.norm((T_map_odom @ drifted(view))[:3, 3] - true_pose(view)[:3, 3]))


def test_what_is_seen_again_takes_the_drift_out_of_the_map_and_leaves_the_odometry_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive = Drive(monkeypatch, Hall())
    drive.run()
    first_lap = drive.corrections[: PER_LAP * FRAMES_PER_VIEW]
    assert all(np.array_equal(T, np.eye(4)) for T in first_lap)  # nothing was seen again yet
    assert off_m(np.eye(4), VIEWS - 1) > 0.12
    assert off_m(drive.closer.T_map_odom, VIEWS - 1) < 0.05
    assert len(drive.closer.closed) > 10


def look_ahead(drive: Drive) -> None:
    while drive.closer.look_ahead():
        pass


@pytest.mark.parametrize("in_idle", [lambda drive: drive.views.describe_next(), look_ahead])
@pytest.mark.parametrize("capacity", [300, PER_LAP + 8])
def test_a_correction_comes_at_the_same_frame_whatever_was_done_before_it(
    monkeypatch: pytest.MonkeyPatch, in_idle: Callable[[Drive], object], capacity: int
) -> None:
    late, early = (Drive(monkeypatch, Hall(), capacity) for _ in range(2))
    late.run(VIEWS - 12)
    early.run(VIEWS - 12, in_idle)
    assert np.array_equal(late.corrections, early.corrections)
    assert not np.array_equal(late.corrections[-1], np.eye(4))


def test_what_looks_back_is_done_before_its_frame_where_there_is_time(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, compare, is_idle = Drive(monkeypatch, Hall()), LoopCloser._compare, False
    done_in_idle = list[bool]()

    def watched(closer: LoopCloser, views: list[View], T_odom: FloatArray, a: int, way_m: float) -> Claim | None:
        done_in_idle.append(is_idle)
        return compare(closer, views, T_odom, a, way_m)

    def idle(drive: Drive) -> None:
        nonlocal is_idle
        is_idle = True
        look_ahead(drive)
        is_idle = False

    monkeypatch.setattr(LoopCloser, "_compare", watched)
    drive.run(in_idle=idle)
    assert len(done_in_idle) > 20 and all(done_in_idle)


def test_what_only_looks_like_a_place_seen_before_closes_no_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive(monkeypatch, Hall(aside_m=1.0))
    drive.run()
    assert not drive.closer.closed
    assert all(np.array_equal(T, np.eye(4)) for T in drive.corrections)


def test_loops_outlast_the_views_that_were_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive(monkeypatch, Hall(), capacity=VIEWS - 8)
    drive.run()
    kept = {v.frame_index for v in drive.views.described()}
    assert len(kept) < VIEWS - 20
    assert len(drive.closer.closed) > 3
    assert off_m(drive.closer.T_map_odom, VIEWS - 1) < 0.05


def test_one_view_alone_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive(monkeypatch, Hall())
    compare, said = LoopCloser._compare, list[bool]()

    def once(closer: LoopCloser, views: list[View], T_odom: FloatArray, a: int, way_m: float) -> Claim | None:
        claim = None if said else compare(closer, views, T_odom, a, way_m)
        if claim is not None:
            said.append(True)
        return claim

    monkeypatch.setattr(LoopCloser, "_compare", once)
    drive.run()
    assert said and not drive.closer.closed
    assert all(np.array_equal(T, np.eye(4)) for T in drive.corrections)


def test_the_odometry_drifts_over_the_way_to_where_loops_tie_it(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive(monkeypatch, Hall())
    drive.run(PER_LAP)
    at = {frame: k for k, frame in enumerate(range(0, VIEWS * FRAMES_PER_VIEW, FRAMES_PER_VIEW))}
    T_odom = np.array([drive.odometry(frame) for frame in at])
    steps = np.linalg.norm(np.diff(T_odom[:, :3, 3], axis=0), axis=1)
    assert drive.closer._ways(T_odom, at) == pytest.approx([*np.cumsum(steps[::-1])[::-1], 0.0], abs=1e-3)
    drive.run(first=PER_LAP)
    tied = max(new for _, new in drive.closer.closed)
    ways = drive.closer._ways(T_odom, at)
    assert ways[at[tied]] < 0.3 * steps.sum()
    assert ways.max() < 0.7 * steps.sum()  # half a lap at most from a loop's ends


def test_loop_edges_are_of_the_body(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive(monkeypatch, Hall())
    drive.run(VIEWS - 12)
    for claim in drive.closer.closed.values():
        T_true = inverse(true_pose(claim.old // FRAMES_PER_VIEW)) @ true_pose(claim.new // FRAMES_PER_VIEW)
        assert np.abs(claim.T_old_new - T_true).max() < 0.03
