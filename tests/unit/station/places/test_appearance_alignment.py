"""Cameras found in the map agree on one motion, whatever a few of them say."""

import numpy as np
import pytest

from shared.geometry import FloatArray, inverse, rotation_of, scale_of, se3, so3_exp, so3_log, transform, yaw_rotation
from station.places.joining.appearance_alignment import (
    MAX_SIGHTINGS,
    agree_on_motion,
    covariance_of_motion,
    keyframes_with_news,
)
from tests.support.synthetic_home import drive, furnished_room, navigate


def cameras(seed: int, count: int, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    T_map_cam = np.stack([se3(so3_exp(rng.normal(size=3)), rng.uniform(-2, 2, 3)) for _ in range(count)])
    T_map_nav = se3(yaw_rotation(2.5), np.array([1.0, -2.0, 0.3]))
    T_nav_cam = inverse(T_map_nav) @ T_map_cam
    T_nav_cam[:, :3, 3] /= scale
    T_map_nav[:3, :3] *= scale
    return T_map_cam, T_nav_cam, T_map_nav


@pytest.mark.parametrize("scale", [1.0, 0.2, 7.0])
def test_the_motion_is_found_with_its_scale_among_wrong_cameras(scale: float) -> None:
    T_map_cam, T_nav_cam, T_map_nav = cameras(1, 10, scale)
    T_map_cam[[2, 5, 8], :3, 3] += [3.0, 1.0, 0.0]
    found = agree_on_motion(T_map_cam, T_nav_cam, tolerance=0.2, fixed_scale=scale == 1.0)
    assert found is not None
    np.testing.assert_allclose(found[0], T_map_nav, atol=1e-9)
    assert found[1].tolist() == [0, 1, 3, 4, 6, 7, 9]


def test_cameras_that_disagree_say_nothing() -> None:
    rng = np.random.default_rng(0)
    T_map_cam, T_nav_cam, _ = cameras(2, 8, 1.0)
    T_map_cam[:, :3, 3] = rng.uniform(-5, 5, (8, 3))
    assert agree_on_motion(T_map_cam, T_nav_cam, tolerance=0.2, fixed_scale=True) is None
    assert agree_on_motion(T_map_cam[:3], T_nav_cam[:3], tolerance=0.2, fixed_scale=True) is None


def test_right_positions_with_wrong_headings_do_not_agree() -> None:
    T_map_cam, T_nav_cam, _ = cameras(3, 8, 1.0)
    T_map_cam[4:, :3, :3] = T_map_cam[4:, :3, :3] @ so3_exp(np.array([0.0, 0.5, 0.0]))
    found = agree_on_motion(T_map_cam, T_nav_cam, tolerance=0.2, fixed_scale=True)
    assert found is None  # four of eight are no majority


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_the_uncertainty_of_the_motion_is_how_much_it_scatters(scale: float) -> None:
    rng = np.random.default_rng(5)
    T_map_cam, T_nav_cam, T_map_nav = cameras(4, 10, scale)
    middle = T_nav_cam[:, :3, 3].mean(axis=0)
    errors, told = [], []
    for _ in range(300):
        seen = T_map_cam.copy()
        seen[:, :3, 3] += rng.normal(0, 0.03, (10, 3))
        seen[:, :3, :3] = np.stack([so3_exp(turn) for turn in rng.normal(0, 0.01, (10, 3))]) @ seen[:, :3, :3]
        found = agree_on_motion(seen, T_nav_cam, tolerance=1.0, fixed_scale=scale == 1.0)
        covariance = covariance_of_motion(seen, T_nav_cam, fixed_scale=scale == 1.0)
        assert found is not None and len(found[1]) == 10
        assert covariance is not None and np.linalg.eigvalsh(covariance).min() > -1e-12
        told.append(covariance)
        turn = so3_log(rotation_of(found[0]) @ rotation_of(T_map_nav).T)
        shift = transform(found[0] - T_map_nav, middle)
        errors.append([*turn, *shift, np.log(scale_of(found[0]) / scale)])
    sigma = np.sqrt(np.mean(told, axis=0).diagonal())
    free = slice(0, 6) if scale == 1.0 else slice(0, 7)
    np.testing.assert_allclose(sigma[free], np.std(errors, axis=0)[free], rtol=0.25)
    assert (sigma[6] == 0) == (scale == 1.0)
    assert covariance_of_motion(T_map_cam[:2], T_nav_cam[:2], fixed_scale=True) is None


def test_of_keyframes_that_show_the_same_only_a_few_have_news() -> None:
    home = furnished_room(4)
    there = drive(home, 4, frames=12)
    stays = np.repeat(there[:1], 30, axis=0)
    navigation = navigate(home, np.concatenate([stays, there]), seed=4, images=False, seen_share=1.0)
    has_news = keyframes_with_news(navigation)
    assert all(has_news[:MAX_SIGHTINGS])
    assert sum(has_news[:30]) <= 2 * MAX_SIGHTINGS  # each frame of this drive sees four fifths of what is in view
    landmarks = navigation.landmarks
    described = np.flatnonzero(has_news)
    shown = landmarks.observed_landmark[np.isin(landmarks.observed_keyframe, described)]
    assert len(np.unique(shown)) >= 0.95 * len(landmarks)


def test_a_drive_through_a_room_is_described_as_a_whole() -> None:
    home = furnished_room(5)
    navigation = navigate(home, drive(home, 5, frames=24, turns=1.0), seed=5, images=False)
    assert len(navigation.landmarks) > 50
    assert sum(keyframes_with_news(navigation)) >= 22
