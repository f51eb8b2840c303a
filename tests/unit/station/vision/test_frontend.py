"""Lens models, corner selection, two-view outlier test and the tracker on synthetic images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, CameraCalibration
from shared.geometry import so3_exp
from station.vision.klt import Tracker, TrackerConfig, detect_corners
from station.vision.lens import Lens
from station.vision.two_view import epipolar_inliers

EUROC = CameraCalibration(
    width=752,
    height=480,
    fx=458.654,
    fy=457.296,
    cx=367.215,
    cy=248.375,
    distortion=(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
)
FISHEYE = CameraCalibration(
    width=512,
    height=512,
    fx=190,
    fy=190,
    cx=255,
    cy=256,
    model="equidistant",
    distortion=(0.0034, 0.0007, -0.002, 2e-4),
)


@pytest.mark.parametrize("camera", [EUROC, FISHEYE, REFERENCE_CAMERA])
def test_unproject_inverts_project_over_the_whole_image(camera: CameraCalibration) -> None:
    lens = Lens(camera)
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 23), np.linspace(0, camera.height - 1, 17))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    if camera.model == "equidistant":
        uv = uv[np.linalg.norm(uv - (255, 256), axis=1) < 270]  # the corners lie beyond 85 degrees
    assert np.abs(lens.project(lens.unproject(uv)) - uv).max() < 1e-6
    assert lens.is_invertible(uv, lens.unproject(uv)).all()


def test_points_beyond_the_lens_model_are_not_invertible() -> None:
    lens = Lens(FISHEYE)
    corner = np.array([[0.0, 0.0]])
    assert not lens.is_invertible(corner, lens.unproject(corner)).any()


@pytest.mark.parametrize("camera", [EUROC, REFERENCE_CAMERA])
def test_radtan_agrees_with_opencv(camera: CameraCalibration) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.3, 0.3, (50, 2))
    rays = np.column_stack([xy, np.ones(50)])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion))
    assert np.allclose(Lens(camera).project(xy), expected.reshape(-1, 2), atol=1e-9)


def test_equidistant_agrees_with_opencv() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1.2, 1.2, (50, 2))
    expected = cv2.fisheye.distortPoints(xy.reshape(-1, 1, 2), FISHEYE.K, np.array(FISHEYE.distortion))
    assert np.allclose(Lens(FISHEYE).project(xy), expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("camera", [EUROC, FISHEYE])
def test_lens_jacobian_is_the_finite_difference(camera: CameraCalibration) -> None:
    lens = Lens(camera)
    xy = np.array([[0.2, -0.3], [0.0, 0.0], [-0.5, 0.4], [1e-10, 0.0]])
    J = lens.whitening(xy, 1.0)
    h = 1e-6
    for k in range(2):
        step = np.eye(2)[k] * h
        difference = (lens.project(xy + step) - lens.project(xy - step)) / (2 * h)
        assert np.allclose(J[..., k], difference, rtol=1e-5, atol=1e-3)


def texture(seed: int, shape: tuple[int, int] = (480, 752)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = rng.uniform(0, 255, (shape[0] // 8, shape[1] // 8)).astype(np.float32)
    image = cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.clip(image, 0, 255).astype(np.uint8)


def test_corners_are_spread_and_keep_away_from_live_tracks() -> None:
    grey = texture(1)
    live = np.array([[100.0, 100.0], [400.0, 300.0]])
    corners = detect_corners(grey, live, 200, 32, 1e-4)
    assert len(corners) > 150
    to_live = np.linalg.norm(corners[:, None] - live[None], axis=-1)
    assert to_live.min() > 10.0
    quarters = np.histogram2d(corners[:, 0], corners[:, 1], bins=(4, 4), range=((0, 752), (0, 480)))[0]
    assert quarters.min() >= 4


def test_fewer_corners_are_the_best_of_many() -> None:
    grey = texture(1)
    many = detect_corners(grey, np.zeros((0, 2)), 200, 32, 1e-4)
    few = detect_corners(grey, np.zeros((0, 2)), 20, 32, 1e-4)
    assert len(few) == 20
    assert np.array_equal(few, many[:20])
    apart = np.linalg.norm(many[:, None] - many[None], axis=-1) + 1e3 * np.eye(len(many))
    assert apart.min() > 8.0  # half a cell of the half-size picture, less what the sub-pixel step moves them


def test_no_corners_on_a_blank_wall() -> None:
    assert len(detect_corners(np.full((480, 640), 120, np.uint8), np.zeros((0, 2)), 100, 32, 3e-4)) == 0


def test_peaks_lie_at_their_corner_and_not_on_its_slope_where_a_live_track_covers_it() -> None:
    grey = np.full((480, 640), 100, np.uint8)
    grey[127:193, 127:193] = 180
    true = np.array([[126.5, 126.5], [192.5, 126.5], [126.5, 192.5], [192.5, 192.5]])
    live = np.array([[119.0, 119.0]])
    peaks, all_corners = (detect_corners(grey, live, 200, 32, 1e-5, peak_px=peak_px) for peak_px in (6, 0))
    off = np.linalg.norm(peaks[:, None] - true, axis=2)
    assert sorted(off.argmin(axis=1).tolist()) == [1, 2, 3] and off.min(axis=1).max() < 3.0
    assert len(all_corners) > 3


@pytest.mark.parametrize("translation", [0.0, 0.1])
def test_two_view_test_finds_the_wrong_pairs(translation: float) -> None:
    rng = np.random.default_rng(3)
    p = np.column_stack([rng.uniform(-2, 2, 80), rng.uniform(-1, 1, 80), rng.uniform(2, 5, 80)])
    R_a_b = so3_exp(np.array([0.02, -0.05, 0.03]))
    t_a_b = translation * np.array([0.8, 0.1, 0.4])
    p_b = (p - t_a_b) @ R_a_b
    a, b = p[:, :2] / p[:, 2:], p_b[:, :2] / p_b[:, 2:]
    b += rng.normal(0, 2e-4, b.shape)
    b[:15] += rng.choice([-1, 1], (15, 2)) * rng.uniform(0.02, 0.05, (15, 2))
    inlier = epipolar_inliers(a, b, R_a_b, 2e-3, np.random.default_rng(0))
    assert inlier[15:].mean() > 0.95
    assert inlier[:15].mean() < 0.35  # a wrong pair may slide along its epipolar line unnoticed


@pytest.mark.parametrize("yaw_rad", [0.002, 0.1])
def test_tracker_follows_rotation_with_the_gyroscopes_help(yaw_rad: float) -> None:
    lens = Lens(EUROC)
    R_prev_cur = so3_exp(np.array([0.01, yaw_rad, -0.01]))
    first = texture(5)
    u, v = np.meshgrid(np.arange(752.0), np.arange(480.0))
    rays = lens.unproject(np.stack([u, v], axis=-1))
    rays = np.concatenate([rays, np.ones((480, 752, 1))], axis=-1) @ R_prev_cur.T
    source = lens.project(rays[..., :2] / rays[..., 2:]).astype(np.float32)
    second = cv2.remap(first, source[..., 0], source[..., 1], cv2.INTER_CUBIC)
    tracker = Tracker(lens, TrackerConfig())
    start = tracker.process(first, np.eye(3), True)
    frame = tracker.process(second, R_prev_cur, True)
    assert frame.num_tracked > 0.7 * len(start.ids)
    common, i, j = np.intersect1d(start.ids, frame.ids, return_indices=True)
    assert len(common) == frame.num_tracked
    rays = np.column_stack([start.xy[i], np.ones(len(i))]) @ R_prev_cur
    expected = lens.project(rays[:, :2] / rays[:, 2:])
    error = np.linalg.norm(expected - frame.uv_px[j], axis=1)
    assert np.median(error) < 0.1


def test_tracker_gives_the_same_result_twice() -> None:
    a, b = texture(7), np.roll(texture(7), 3, axis=1)
    runs = []
    for _ in range(2):
        tracker = Tracker(Lens(EUROC), TrackerConfig(), seed=4)
        tracker.process(a, np.eye(3), False)
        runs.append(tracker.process(b, np.eye(3), False))
    assert np.array_equal(runs[0].uv_px, runs[1].uv_px) and np.array_equal(runs[0].ids, runs[1].ids)
