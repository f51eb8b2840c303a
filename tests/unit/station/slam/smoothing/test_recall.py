"""Lost landmarks are found where they are, and not where they are not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, inverse, se3, so3_exp
from station.model.frames import ImageArray
from station.slam.smoothing.config import RecallConfig
from station.slam.smoothing.keyframe import camera_pose
from station.slam.smoothing.landmarks import LandmarkTable
from station.slam.smoothing.recall import Patches, cut_patches, find_again, predict_views
from station.slam.smoothing.search import Recaller
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame
from station.vision.lens import BoolArray, Lens

pytestmark = pytest.mark.computing

LENS = Lens(REFERENCE_CAMERA)
CONFIG = RecallConfig()
DEPTH_M = 2.0


def wall(T_world_cam: FloatArray, seed: int = 0) -> ImageArray:
    """What a camera sees of a textured wall at z = DEPTH_M."""
    texture = np.random.default_rng(seed).integers(0, 256, (300, 400)).astype(np.uint8)
    texture = cv2.GaussianBlur(cv2.resize(texture, None, fx=4, fy=4), (0, 0), 3.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    u, v = np.meshgrid(np.arange(REFERENCE_CAMERA.width), np.arange(REFERENCE_CAMERA.height))
    xy = LENS.unproject(np.stack([u, v], axis=-1).reshape(-1, 2).astype(float))
    rays = np.column_stack([xy, np.ones(len(xy))]) @ T_world_cam[:3, :3].T
    c = T_world_cam[:3, 3]
    p = c + rays * ((DEPTH_M - c[2]) / rays[:, 2])[:, None]
    maps = ((p[:, :2] + 1.0) * 600.0).astype(np.float32).reshape(*u.shape, 2)
    return np.asarray(cv2.remap(texture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR))


def marks() -> tuple[FloatArray, FloatArray]:
    """Pixels (n, 2) of the first view, from the origin, and the points of the wall there."""
    u, v = np.meshgrid(np.linspace(120, 520, 6), np.linspace(100, 380, 5))
    uv = np.column_stack([u.ravel(), v.ravel()])
    xy = LENS.unproject(uv)
    return uv, DEPTH_M * np.column_stack([xy, np.ones(len(xy))])


def test_landmarks_are_found_to_a_tenth_of_a_pixel_from_a_turned_nearer_view() -> None:
    uv, p = marks()
    patches, inside = cut_patches(wall(np.eye(4)), uv, np.eye(4), CONFIG.stored_px)
    assert inside.all()
    T = se3(so3_exp(np.array([0.05, -0.06, 0.3])), np.array([0.05, -0.03, 0.25]))
    predicted = T @ se3(so3_exp(np.array([0.002, -0.003, 0.0])), np.zeros(3))  # 3 px off
    found = find_again(wall(T), LENS, predicted, p, patches, np.full(len(p), CONFIG.reach_px), CONFIG)
    p_cam = (p[found.rows] - T[:3, 3]) @ T[:3, :3]
    error = np.linalg.norm(found.uv_px - LENS.project(p_cam[:, :2] / p_cam[:, 2:]), axis=1)
    assert len(found.rows) > 0.6 * len(p)  # a quarter lies outside of the nearer view
    assert np.median(error) < 0.1


def test_on_another_wall_hardly_anything_is_found() -> None:
    uv, p = marks()
    patches, _ = cut_patches(wall(np.eye(4)), uv, np.eye(4), CONFIG.stored_px)
    found = find_again(
        wall(np.eye(4), seed=1), LENS, np.eye(4), p, patches, np.full(len(p), CONFIG.old_reach_px), CONFIG
    )
    assert len(found.rows) <= 1


def test_what_lies_behind_the_camera_is_not_looked_for() -> None:
    uv, p = marks()
    patches, _ = cut_patches(wall(np.eye(4)), uv, np.eye(4), CONFIG.stored_px)
    behind = se3(so3_exp(np.array([0.0, np.pi, 0.0])), np.zeros(3))
    assert not len(find_again(wall(np.eye(4)), LENS, behind, p, patches, np.full(len(p), 8.0), CONFIG).rows)


def test_only_landmarks_near_the_view_have_their_patches_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    uv, p = marks()
    patches, _ = cut_patches(wall(np.eye(4)), uv, np.eye(4), CONFIG.stored_px)
    far = 1000
    table = LandmarkTable(CONFIG.stored_px)
    elsewhere = se3(np.eye(3), np.array([50.0, 0.0, 0.0]))
    moved = replace(patches.take(np.zeros(far, dtype=np.int64)), T_world_cam=np.repeat(elsewhere[None], far, axis=0))
    table.add(np.arange(far), np.repeat(p[:1] + elsewhere[:3, 3], far, axis=0), np.zeros((far, 3, 3)), moved, 0)
    table.add(far + np.arange(len(p)), p, np.zeros((len(p), 3, 3)), patches, 0)
    asked: list[int] = []

    def counted(
        lens: Lens, T_world_cam: FloatArray, p_world: FloatArray, patches: Patches, config: RecallConfig
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        asked.append(len(p_world))
        return predict_views(lens, T_world_cam, p_world, patches, config)

    for name in ("search", "recall"):
        monkeypatch.setattr(f"station.slam.smoothing.{name}.predict_views", counted)
    camera = CameraModel.of(REFERENCE_CAMERA, 1.0)
    nothing = TrackedFrame(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2)), 0, 0.0)
    T_world_body = inverse(camera_pose(np.eye(4), camera))
    found = Recaller(camera, CONFIG).search(table, wall(np.eye(4)), nothing, T_world_body, 0)
    reach = np.full(len(p), CONFIG.reach_px)
    alone = find_again(wall(np.eye(4)), LENS, np.eye(4), p, patches, reach, CONFIG)
    assert len(alone.rows) > 20
    assert found.landmarks.tolist() == (far + alone.rows).tolist()
    assert max(asked) <= len(p)
