"""What the figures of a navigation are drawn from."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from shared.geometry import FloatArray, se3, yaw_rotation
from station.datasets import Truth
from station.experiments.experiment import Experiment, run_experiment
from station.experiments.figures import draw_figures
from station.experiments.navigation_figures import Viewpoint
from station.experiments.plotting import decode_rgb
from station.experiments.scene import Scene
from station.places.making.config import PlacesConfig
from tests.support.synthetic_home import drive, furnished_room, navigate

T_NAV_WORLD = se3(yaw_rotation(2.2), np.array([4.0, -1.0, 0.0]))


def truth_of(poses: FloatArray) -> Truth:
    return Truth(np.arange(len(poses), dtype=np.int64) * 100_000_000, poses)


@pytest.fixture(scope="module")
def poses() -> tuple[FloatArray, FloatArray]:
    home = furnished_room(3, density=300)
    return drive(home, 31), drive(home, 32, radius=0.6)


def matched(poses: tuple[FloatArray, FloatArray], *, with_truth: bool) -> Experiment:
    home = furnished_room(3, density=300)
    first = navigate(home, poses[0], seed=31, images=False)
    second = navigate(home, poses[1], seed=32, T_nav_world=T_NAV_WORLD, images=False)
    truths = (truth_of(poses[0]), truth_of(poses[1])) if with_truth else (None, None)
    return run_experiment(first, second, PlacesConfig(), truths=truths)


def test_routes_are_the_true_ones_in_the_axes_of_the_map(poses: tuple[FloatArray, FloatArray]) -> None:
    turn = se3(yaw_rotation(1.0), np.array([7.0, 3.0, 0.5]))  # truth's world is not the map's
    elsewhere = turn @ poses[0], turn @ poses[1]
    home = furnished_room(3, density=300)
    first = navigate(home, poses[0], seed=31, images=False)
    second = navigate(home, poses[1], seed=32, T_nav_world=T_NAV_WORLD, images=False)
    truths = truth_of(elsewhere[0]), truth_of(elsewhere[1])
    paths = Scene(run_experiment(first, second, PlacesConfig(), truths=truths)).driven_paths()
    assert paths is not None
    for path, true in zip(paths, poses, strict=True):
        np.testing.assert_allclose(path.position, true[:, :3, 3] - poses[0][0, :3, 3], atol=1e-6)
        assert (path.unit, path.source, path.is_shared_frame) == ("m", "by true poses", True)


def test_without_truth_routes_are_the_estimated_ones(poses: tuple[FloatArray, FloatArray]) -> None:
    paths = Scene(matched(poses, with_truth=False)).driven_paths()
    assert paths is not None and {path.source for path in paths} == {"as estimated"}
    np.testing.assert_allclose(paths[1].position, poses[1][:, :3, 3], atol=0.1)


def test_every_figure_is_drawn_also_without_pictures(poses: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    experiment = matched(poses, with_truth=True)
    assert not any(experiment.navigation.keyframes.encoded)
    files = draw_figures(experiment, tmp_path)
    assert {"frames", "routes", "coloured_clouds", "trajectories"} <= files.keys()


def test_a_cloud_is_seen_from_above_with_its_longer_side_across() -> None:
    rng = np.random.default_rng(0)
    p = rng.uniform([-1, -4, 0], [1, 4, 2], (500, 3))
    view = Viewpoint.of(p, p[:0])
    np.testing.assert_allclose(np.abs(view.R_eye_cloud[0]), [0, 1, 0], atol=0.1)
    assert np.linalg.det(view.R_eye_cloud) == pytest.approx(1.0)
    high, low = view.project(np.array([[0.0, 0, 2], [0.0, 0, 0]]))
    assert high[1] > low[1] and high[2] > low[2]  # up in the picture, and nearer to an eye above


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_wall_is_seen_from_the_side_of_the_cameras(side: float) -> None:
    rng = np.random.default_rng(0)
    wall = rng.uniform([-3, 0, 0], [3, 0.1, 2], (500, 3))
    view = Viewpoint.of(wall, np.array([[0.0, 2 * side, 1.0]]))
    assert np.sign(view.R_eye_cloud[2, 1]) == side  # towards the eye


def test_what_is_nearer_is_larger_and_what_is_behind_the_eye_is_not_drawn() -> None:
    view = Viewpoint(np.eye(3), np.zeros(3), 2.0)
    near, middle, behind = view.project(np.array([[1.0, 0, 2], [1.0, 0, 0], [0.0, 0, 8]]))
    assert near[2] > middle[2] == 1.0 and near[0] > middle[0] == 0.5
    assert np.isnan(behind).all()


def test_a_file_that_is_no_picture_has_no_pixels() -> None:
    assert decode_rgb(b"") is None and decode_rgb(b"no picture") is None
    red = np.zeros((4, 5, 3), np.uint8)
    red[..., 2] = 200  # OpenCV's order is BGR
    pixels = decode_rgb(cv2.imencode(".png", red)[1].tobytes())
    assert pixels is not None and pixels.shape == (4, 5, 3)
    np.testing.assert_array_equal(pixels[0, 0], [200, 0, 0])
