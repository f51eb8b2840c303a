"""Two views of the same corners tell how the camera turned, whatever it moved."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, so3_exp, so3_log
from station.calibration.targetless.tracks import Sightings
from station.calibration.targetless.turning import planar_share, relative_rotation
from station.calibration.targetless.verdict import MAX_PLANAR


def two_views(moved: FloatArray, turn: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(4)
    points = rng.uniform([-2, -1.5, 2], [2, 1.5, 5], (150, 3))
    beyond = (points - moved) @ so3_exp(turn)
    a, b = (p[:, :2] / p[:, 2:] for p in (points, beyond))
    return a, b + noise * rng.standard_normal(b.shape)


@pytest.mark.parametrize("moved", [(0.1, 0.02, 0.05), (0.0, 0.0, 0.15), (0.0, 0.0, 0.0)])
def test_turn_is_found_however_the_camera_moved(moved: tuple[float, float, float]) -> None:
    turn = np.array([0.05, -0.08, 0.03])
    R, _ = relative_rotation(*two_views(np.array(moved), turn, 3e-4), 1.5e-3)
    assert np.linalg.norm(so3_log(so3_exp(turn).T @ R)) < 2e-3


def test_wrong_corners_lie_beside_their_epipolar_lines() -> None:
    a, b = two_views(np.array([0.1, 0.02, 0.05]), np.array([0.05, -0.08, 0.03]), 3e-4)
    b[:15, 1] += 0.05
    R, distance = relative_rotation(a, b, 1.5e-3)
    assert np.linalg.norm(so3_log(so3_exp(np.array([0.05, -0.08, 0.03])).T @ R)) < 2e-3
    assert np.median(distance[:15]) > 10 * np.median(distance[15:])


@pytest.mark.parametrize(("depth_m", "is_planar"), [(0.0, True), (2.0, False)])
def test_a_wall_is_told_from_a_room(depth_m: float, is_planar: bool) -> None:
    rng, num_images = np.random.default_rng(5), 12
    points = rng.uniform([-1.5, -1.0, 2.0], [1.5, 1.0, 2.0 + depth_m], (80, 3))
    moved = 0.08 * np.arange(num_images)[:, None, None] * np.array([1.0, 0.3, 0.2])
    xy = (points - moved)[..., :2] / (points - moved)[..., 2:]
    xy += 3e-4 * rng.standard_normal(xy.shape)
    corner, image = np.divmod(np.arange(80 * num_images), num_images)
    at = xy[image, corner]
    t_s = np.linspace(0.0, 0.1 * (num_images - 1), num_images)
    seen = Sightings(t_s, image, corner, 500.0 * at, at)
    assert (planar_share(seen, 500.0) > MAX_PLANAR) == is_planar
