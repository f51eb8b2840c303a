"""A robot before a wall of texture: pictures of it, and a map made of them."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.geometry import FloatArray, inverse, se3, so3_exp
from station.model.frames import ImageArray, ImageFrame
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap
from station.vision.features import FeatureExtractor

CAMERA = CameraCalibration(width=640, height=480, fx=600, fy=600, cx=319.5, cy=239.5)


CALIBRATION = Calibration(camera=CAMERA, imu=None)


DISTANCE_M = 3.0  # of the wall, along z


PIXELS_PER_M = 200.0


WALL_M = (8.0, 4.0)


@cache
def wall(seed: int) -> ImageArray:
    """A texture with structure at several sizes."""
    rng = np.random.default_rng(seed)
    h, w = int(WALL_M[1] * PIXELS_PER_M), int(WALL_M[0] * PIXELS_PER_M)
    out = np.zeros((h, w), np.float32)
    for size in (4, 10, 25, 60):
        small = rng.uniform(-1, 1, (h // size + 2, w // size + 2)).astype(np.float32)
        out += cv2.resize(small, (w, h), interpolation=cv2.INTER_NEAREST) * size**0.3
    return np.clip(110 + 35 * out, 0, 255).astype(np.uint8)


def camera_at(x: float, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """T_world_cam; the world has the camera's axes."""
    return se3(so3_exp(np.array([0.0, yaw, 0.0])), np.array([x, y, z]))


def picture(seed: int, T_world_cam: FloatArray) -> bytes:
    """The wall z = DISTANCE_M, centred on the origin, as the camera sees it."""
    T = inverse(T_world_cam)
    # wall pixel -> world point on the plane -> image
    to_world = np.array(
        [
            [1 / PIXELS_PER_M, 0, -WALL_M[0] / 2],
            [0, 1 / PIXELS_PER_M, -WALL_M[1] / 2],
            [0, 0, DISTANCE_M],
            [0, 0, 1.0],
        ]
    )
    H = CAMERA.K @ T[:3] @ to_world
    image = cv2.warpPerspective(wall(seed), H, (CAMERA.width, CAMERA.height), flags=cv2.INTER_AREA)
    return cv2.imencode(".png", image)[1].tobytes()


def make_map(map_id: str, seed: int) -> PlaceMap:
    """Keyframes along the wall; landmarks where features of neighbouring keyframes meet."""
    poses = np.stack([camera_at(x) for x in np.linspace(-1.5, 1.5, 7)])
    encoded = tuple(picture(seed, T) for T in poses)
    extractor = FeatureExtractor(400)
    p_all: list[FloatArray] = []
    landmark, keyframe, uv = [], [], []
    numbers: dict[tuple[int, int], int] = {}
    for k, T in enumerate(poses):
        grey = ImageFrame(0, 0, 0, encoded[k]).grey()
        for u, v in extractor.extract(grey).uv_px:
            p = T[:3, 3] + DISTANCE_M * np.array([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0])
            number = numbers.setdefault((round(p[0] / 0.01), round(p[1] / 0.01)), len(numbers))
            if number == len(p_all):
                p_all.append(p)
            landmark.append(number)
            keyframe.append(k)
            uv.append((u, v))
    t = np.arange(len(poses)) * 1_000_000_000
    n = len(p_all)
    navigation = Navigation(
        id=f"nav-{map_id}",
        calibration=CALIBRATION,
        trajectory=Trajectory(t, poses),
        keyframes=Keyframes(np.arange(len(t)), t, poses, encoded, np.zeros(len(t), dtype=np.int64)),
        landmarks=Landmarks(
            p_world=np.array(p_all),
            rgb=np.zeros((n, 3), dtype=np.uint8),
            cov_world=np.zeros((n, 3, 3)),
            observed_landmark=np.array(landmark),
            observed_keyframe=np.array(keyframe),
            observed_uv_px=np.array(uv),
        ),
        report=NavigationReport("test", len(t), 1, 1, 1, 1, n, 0, "metric", False, 0, {}, {}),
    )
    return PlaceMap(map_id, map_id, navigation, (), (), {})


def frame(encoded: bytes) -> ImageFrame:
    return ImageFrame(index=0, t_robot_ns=7, exposure_ns=0, encoded=encoded)
