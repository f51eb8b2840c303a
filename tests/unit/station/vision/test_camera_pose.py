"""A camera's pose from what one small thing shows of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from shared.geometry import FloatArray, inverse, se3, so3_exp, transform
from station.vision import camera_pose
from station.vision.camera_pose import pose_by_ransac, solve_pose, solve_pose_from

# Matches of a picture on the wall of a simulated home (`home` 902), seen from 0.8 m: where each of the map's landmarks
# is in the true camera's frame, and the ray it was matched with. Two of five matches are right to 4 px, of 1105 px.
MATCHES = Path(__file__).parents[3] / "golden" / "matches_of_a_picture.json"
TOLERANCE = 4.0 / 1105.0


def test_a_camera_is_not_turned_about_the_picture_before_it() -> None:
    rows = np.array(json.loads(MATCHES.read_text()))
    p_cam, rays = rows[:, :3], rows[:, 3:]
    drawn_once = pose_by_ransac(p_cam, rays, TOLERANCE, iterations=400, seed=1)
    assert drawn_once is not None
    turned = solve_pose_from(drawn_once[0], p_cam, rays, TOLERANCE)
    assert turned is not None and off(turned.T_map_cam) > 0.15  # what is to be avoided
    pose = solve_pose(p_cam, rays, TOLERANCE)
    assert pose is not None and off(pose.T_map_cam) < 0.03
    assert pose.num_inliers > turned.num_inliers


@pytest.mark.parametrize("right", range(camera_pose.SEARCHES))
def test_the_search_counts_that_explains_most_once_refined(monkeypatch: pytest.MonkeyPatch, right: int) -> None:
    rng = np.random.default_rng(0)
    p_map = rng.uniform([-1, -1, 2], [1, 1, 4], (30, 3))
    rays = p_map[:, :2] / p_map[:, 2:]
    elsewhere = se3(so3_exp(np.array([0.0, 0.3, 0.0])), np.array([-0.8, 0.0, 0.1]))
    p_seen = transform(inverse(elsewhere), p_map[:8])
    rays[:8] = p_seen[:, :2] / p_seen[:, 2:]
    drawn = [elsewhere] * camera_pose.SEARCHES
    drawn[right] = se3(np.eye(3), np.array([0.001, 0.0, 0.0]))
    monkeypatch.setattr(camera_pose, "_drawn_pose", lambda p, r, tolerance, seed: drawn[seed - 1])
    pose = solve_pose(p_map, rays, 0.005)
    assert pose is not None and pose.num_inliers == 22
    assert off(pose.T_map_cam) < 1e-6


def test_matches_that_agree_on_nothing_give_no_pose() -> None:
    """And no exception, whatever the search makes of them."""
    rng = np.random.default_rng(1)
    for n in (0, 3, 5, 6, 8):
        assert solve_pose(rng.uniform(1, 2, (n, 3)), rng.uniform(-1, 1, (n, 2)), 1e-6) is None
    same = np.tile([0.1, 0.2, 2.0], (12, 1))
    solve_pose(same, same[:, :2] / same[:, 2:], 0.005)


def test_the_same_matches_give_the_same_pose() -> None:
    rows = np.array(json.loads(MATCHES.read_text()))
    poses = [solve_pose(rows[:, :3], rows[:, 3:], TOLERANCE) for _ in range(2)]
    assert poses[0] is not None and poses[1] is not None
    assert np.array_equal(poses[0].T_map_cam, poses[1].T_map_cam)


def off(T_map_cam: FloatArray) -> float:
    """Metres from where the camera is: the origin."""
    return float(np.linalg.norm(T_map_cam[:3, 3]))
