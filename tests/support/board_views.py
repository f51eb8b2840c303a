"""Views of a target by a camera whose numbers are known: corners with noise, no images."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, se3
from station.calibration.target import BoardView, Target
from station.vision.lens import Lens

CAMERA = CameraCalibration(
    width=640, height=480, fx=520.0, fy=516.0, cx=328.0, cy=236.0, distortion=(-0.25, 0.08, 5e-4, -3e-4)
)
GRID = Target("aprilgrid", 5, 7, 0.027, gap_m=0.0081)
Shape = Callable[[FloatArray], FloatArray]  # corners of the target (n, 3) to where they are on the real board


def facing(target: Target, tilt: FloatArray, distance_m: float, shift: FloatArray) -> FloatArray:
    """T_cam_board (4, 4) of a board turned by a rotation vector about its middle, shifted by parts of its distance."""
    turned = np.asarray(cv2.Rodrigues(np.asarray(tilt, dtype=np.float64))[0], dtype=np.float64)
    R = turned @ np.diag([1.0, -1.0, -1.0])
    middle = target.corners.mean(axis=0)
    return se3(R, distance_m * np.array([*shift, 1.0]) - R @ middle)


def random_pose(rng: np.random.Generator, target: Target) -> FloatArray:
    """A board held well: tilted to every side, near and far, all over the image."""
    tilt = np.array([*rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.8, 0.8)])
    return facing(target, tilt, rng.uniform(0.25, 0.5), rng.uniform(-0.5, 0.5, 2) * (1.0, 0.75))


def see(
    rng: np.random.Generator,
    T_cam_board: FloatArray,
    name: str,
    target: Target = GRID,
    camera: CameraCalibration = CAMERA,
    noise_px: float = 0.15,
    shape: Shape = lambda corners: corners,
) -> BoardView:
    """The corners that are in the image, each off by a Gaussian."""
    p = shape(target.corners) @ T_cam_board[:3, :3].T + T_cam_board[:3, 3]
    xy = p[:, :2] / p[:, 2:]
    reach = 1.0 if camera.model == "radtan" else 3.0  # where the lens model still says something
    lens = Lens(camera)
    uv = lens.project(xy)
    ids = np.flatnonzero(lens.is_inside(uv, 5.0) & (p[:, 2] > 0.02) & (np.linalg.norm(xy, axis=1) < reach))
    return BoardView(name, 0, ids, uv[ids] + rng.normal(0.0, noise_px, (len(ids), 2)))


def session(
    seed: int,
    count: int,
    pose: Callable[[np.random.Generator, Target], FloatArray] = random_pose,
    target: Target = GRID,
    camera: CameraCalibration = CAMERA,
    shape: Shape = lambda corners: corners,
) -> list[BoardView]:
    """So many views with enough corners in them."""
    rng = np.random.default_rng(seed)
    views: list[BoardView] = []
    while len(views) < count:
        view = see(rng, pose(rng, target), f"{len(views):03d}.jpg", target, camera, shape=shape)
        if len(view.ids) >= 24:
            views.append(view)
    return views
