"""A picture of a sticker as a camera sees it that looks straight along its axis."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.geometry import FloatArray, se3
from shared.room_sticker import CODE_SIDE_M, sticker_modules
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap

FOCAL_PX, WIDTH, HEIGHT = 600.0, 640, 480


def pinhole() -> Calibration:
    assert REFERENCE_ROBOT.camera is not None
    camera = msgspec.structs.replace(
        REFERENCE_ROBOT.camera, fx=FOCAL_PX, fy=FOCAL_PX, cx=319.5, cy=239.5, distortion=(0.0,) * 4
    )
    return msgspec.structs.replace(REFERENCE_ROBOT, camera=camera)


def code_picture(modules: npt.NDArray[np.bool_], distance_m: float) -> bytes:
    """A JPEG of a code (n, n; True is black) in the middle of a grey wall."""
    side = round(FOCAL_PX * CODE_SIDE_M / distance_m)
    code = np.where(modules, 20, 230).astype(np.uint8)
    fine = cv2.resize(code, (8 * side, 8 * side), interpolation=cv2.INTER_NEAREST)
    picture = np.full((HEIGHT, WIDTH), 190, np.uint8)
    x, y = (WIDTH - side) // 2, (HEIGHT - side) // 2
    picture[y : y + side, x : x + side] = cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", cv2.GaussianBlur(picture, (3, 3), 0.6))[1])


def sticker_picture(name: str, distance_m: float) -> bytes:
    return code_picture(sticker_modules(name), distance_m)


def looking_along_x(x: float, y: float) -> FloatArray:
    """T_world_cam of a level camera."""
    return se3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([x, y, 0.3]))


def map_of_pictures(pictures: list[bytes], poses: list[FloatArray]) -> PlaceMap:
    """A metric map of pictures, without landmarks and places."""
    t = np.arange(len(pictures))
    none = np.zeros(0, np.int64)
    landmarks = Landmarks(
        np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3, 3)), none, none, np.zeros((0, 2))
    )
    report = NavigationReport("simulator", len(t), 0.0, 0.0, 0.0, 0.0, 0, 0.0, "metric", True, 0, {}, {})
    T = np.stack(poses)
    keyframes = Keyframes(t, t, T, tuple(pictures), np.zeros_like(t))
    navigation = Navigation("nav", pinhole(), Trajectory(t, T), keyframes, landmarks, report)
    return PlaceMap("map-1", "Map", navigation, (), (), {})
