"""A camera's pose from matches of which half are wrong."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, inverse, se3, transform
from station.vision.camera_pose import solve_pose

FOCAL_PX, DEPTH_M = 600.0, 0.8
TOLERANCE = 4.0 / FOCAL_PX


def picture_on_a_wall(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (n, 3) of a flat thing of 6 to 60 cm, their rays (n, 2), half of them wrong, and T_map_cam."""
    rng = np.random.default_rng(seed)
    count, half, tilt = int(rng.integers(20, 120)), rng.uniform(0.03, 0.3), rng.uniform(-0.4, 0.4)
    p_map = np.column_stack([rng.uniform(-half, half, (count, 2)), np.zeros(count)])
    c, s = np.cos(tilt), np.sin(tilt)
    T_cam_map = se3(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), np.array([0.0, 0.0, DEPTH_M]))
    p_cam = transform(T_cam_map, p_map)
    rays = p_cam[:, :2] / p_cam[:, 2:] + rng.normal(0.0, 0.5 / FOCAL_PX, (count, 2))
    rays[: count // 2] = rng.uniform(-0.3, 0.3, (count // 2, 2))
    return p_map, rays, inverse(T_cam_map)


def test_a_small_flat_thing_gives_a_pose() -> None:
    off_m = []
    for seed in range(60):
        p_map, rays, T_map_cam = picture_on_a_wall(seed)
        pose = solve_pose(p_map, rays, TOLERANCE)
        assert pose is not None, seed
        off_m.append(float(np.linalg.norm(pose.T_map_cam[:3, 3] - T_map_cam[:3, 3])))
    assert np.median(off_m) < 0.01 and np.quantile(off_m, 0.9) < 0.05


def test_matches_with_few_points_are_no_error() -> None:
    """As where one corner is matched by many features."""
    p_map, rays, _ = picture_on_a_wall(0)
    for points in (1, 2, 3):
        same = np.arange(len(p_map)) % points
        pose = solve_pose(p_map[same], rays[len(rays) // 2 + same], TOLERANCE)
        assert pose is None or np.isfinite(pose.T_map_cam).all()
