import numpy as np

from station.slam.mono.config import FilterConfig
from station.slam.mono.start import Problem
from station.vision.lens import Lens
from tests.support.mono import hand_held_camera


def test_mirrored_world_moves_alike_in_the_pictures_with_the_camera_on_the_other_side() -> None:
    camera = hand_held_camera().camera
    assert camera is not None
    rng = np.random.default_rng(0)
    K, N = 5, 12
    frame, ids = np.repeat(np.arange(K + 1), N), np.tile(np.arange(N), K + 1)
    uv = np.tile(rng.uniform([250, 180], [390, 300], (N, 2)), (K + 1, 1))  # of a camera at rest
    problem = Problem(Lens(camera), FilterConfig(), np.full(K, 1 / 30), ids, frame, uv, 1.0)
    u = problem.mean.copy()
    u[0:2] = 0.5, -0.3  # units/s, sideways
    u[6 * K + 2 :: 3] = rng.uniform(0.1, 0.5, N)
    ones, other = problem.linearised(u)[0], problem.linearised(problem.mirrored(u))[0]
    np.testing.assert_allclose(other.x_v[-1, :2], -ones.x_v[-1, :2])
    assert np.linalg.norm(ones.error_px, axis=1).max() > 10.0  # they move by so much,
    assert np.linalg.norm(ones.error_px - other.error_px, axis=1).max() < 1.0  # and differ by so little
