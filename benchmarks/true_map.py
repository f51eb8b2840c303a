"""A stand-in for a map: the simulator's poses and depths, where a benchmark asks for none of SLAM's errors."""

from __future__ import annotations

import math

import numpy as np

from robot.simulation.config import SimulationConfig
from robot.simulation.renderer import Renderer, unproject_pixels
from robot.simulation.routes import plan_route
from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse
from station.model.frames import ImageFrame
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap
from station.places.making.build import build_map
from station.vision.features import FeatureExtractor, to_floats
from tests.support.drives.robot import SimulatedRobot
from tests.support.drives.routes import Plan

KEYFRAME_M, KEYFRAME_RAD = 0.2, 0.2
MERGE_M = 0.06
MAX_S = 300.0


def map_truly(renderer: Renderer, calibration: Calibration, seed: int, max_s: float = MAX_S) -> PlaceMap:
    """A map along the mapping route with the simulator's poses, and its depths with 1 % noise."""
    camera, world = calibration.camera, renderer.world
    assert camera is not None
    plan = Plan("mapping", plan_route(world, "mapping", seed), None, max_s)
    robot = SimulatedRobot(renderer, calibration, SimulationConfig(), plan, seed)
    extractor, rays = FeatureExtractor(up_deg=calibration.up_in_image_deg), unproject_pixels(camera)
    rng = np.random.default_rng(seed)
    T_body_cam = camera.T_body_cam_matrix
    poses: list[FloatArray] = []
    frames: list[ImageFrame] = []
    points: list[FloatArray] = []
    landmark, keyframe, uv_all = [], [], []
    previous: list[tuple[np.ndarray, list[int]]] = []  # descriptors and landmark numbers of the last keyframes
    for item in robot.sent(4.0):
        if not isinstance(item, ImageFrame):
            continue
        T_body, _ = robot.true_at(item.t_robot_ns + round(1e9 * camera.middle_row_shift_s))
        T = T_body @ T_body_cam
        if poses:
            moved = inverse(poses[-1]) @ T
            turn = math.acos(float(np.clip((np.trace(moved[:3, :3]) - 1) / 2, -1, 1)))
            if np.linalg.norm(moved[:3, 3]) < KEYFRAME_M and turn < KEYFRAME_RAD:
                continue
        features = extractor.extract(item.grey())
        if len(features) < 30:
            continue  # a view of nothing
        at = np.clip(np.round(features.uv_px).astype(int), 0, [camera.width - 1, camera.height - 1])
        inverse_depth = renderer.render(T[None]).inverse_depth[at[:, 1], at[:, 0]]
        depth = 1.0 / np.maximum(inverse_depth, 1e-3) * rng.normal(1, 0.01, len(at))
        p = (rays[at[:, 1], :, at[:, 0]] * depth[:, None]) @ T[:3, :3].T + T[:3, 3]
        numbers = []
        mine = to_floats(features.descriptors)
        nearest = [np.argmax(mine @ descriptors.T, axis=1) for descriptors, _ in previous]
        for k in range(len(p)):
            number = -1
            if inverse_depth[k] > 0.1:
                for best, (_, ids) in zip(nearest[::-1], previous[::-1], strict=True):
                    j = int(best[k])
                    if ids[j] >= 0 and np.linalg.norm(points[ids[j]] - p[k]) < MERGE_M:
                        number = ids[j]
                        break
                if number < 0:
                    number = len(points)
                    points.append(p[k])
                landmark.append(number)
                keyframe.append(len(poses))
                uv_all.append(features.uv_px[k])
            numbers.append(number)
        previous = [*previous[-2:], (mine, numbers)]
        poses.append(T)
        frames.append(item)
    seen = np.bincount(landmark, minlength=len(points))
    keep = seen >= 2
    new_number = np.cumsum(keep) - 1
    observed = keep[np.array(landmark)]
    t = np.array([f.t_robot_ns for f in frames])
    T_all = np.stack(poses)
    count = int(keep.sum())
    return build_map(
        Navigation(
            id=f"truth-{world.name}-{world.seed}",
            calibration=calibration,
            trajectory=Trajectory(t, T_all @ inverse(T_body_cam)),
            keyframes=Keyframes(
                np.arange(len(t)), t, T_all, tuple(f.encoded for f in frames), np.zeros(len(t), np.int64)
            ),
            landmarks=Landmarks(
                np.array(points)[keep],
                np.full((count, 3), 128, np.uint8),
                np.zeros((count, 3, 3)),
                new_number[np.array(landmark)[observed]],
                np.array(keyframe)[observed],
                np.array(uv_all)[observed],
            ),
            report=NavigationReport("simulator", len(t), 0.0, 0.0, 0.0, 0.0, count, 0.0, "metric", True, seed, {}, {}),
        )
    )
