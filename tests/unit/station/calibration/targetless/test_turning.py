"""Two views of the same corners tell how the camera turned, whatever it moved."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, so3_exp, so3_log
from station.calibration.targetless.turning import relative_rotation


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
