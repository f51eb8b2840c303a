"""A keyframe of the smoother: what was seen and measured, and its state as estimated so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, se3
from station.motion.preintegration import Preintegration
from station.slam.mapping.rolling_shutter import observation_pose
from station.slam.ukf.filter.constraints import BodyVelocity
from station.slam.ukf.memory import RecentFrame
from station.vision.camera_model import CameraModel, normalised_points
from station.vision.klt import TrackedFrame


@dataclass(slots=True, eq=False)
class SmoothKeyframe:
    number: int
    source: RecentFrame
    tracked: TrackedFrame  # tracks called by their landmarks
    link: Preintegration | None  # IMU since the keyframe before
    wheels: BodyVelocity | None
    frames_since: int  # since the keyframe before: wheels speak at every frame
    is_still: bool  # since the keyframe before
    T_world_body: FloatArray  # (4, 4)
    v_world: FloatArray  # (3,)
    bias: FloatArray  # (6,)
    omega: FloatArray  # (3,) rad/s body, for the rolling shutter
    segment: int
    trusted: IntArray  # landmarks found again together, however far from where they were predicted
    T_before: FloatArray | None  # (4, 4) T_before_this by the filter, of the keyframe before; None: it does not say
    is_poor: bool = False  # too few landmarks were seen to say where it is

    @property
    def t_s(self) -> float:
        return self.source.t_imu_ns * 1e-9


def views_of(keyframes: list[SmoothKeyframe], camera: CameraModel, uv_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Body poses (F, K, 3, 3), (F, K, 3) at the time of each observation's row; uv_px (F, K, 2)."""
    R = np.array([k.T_world_body[:3, :3] for k in keyframes])
    x = np.array([k.T_world_body[:3, 3] for k in keyframes])
    F, K = uv_px.shape[:2]
    if not camera.line_delay_s:
        return np.broadcast_to(R, (F, K, 3, 3)), np.broadcast_to(x, (F, K, 3))
    v, omega = np.array([k.v_world for k in keyframes]), np.array([k.omega for k in keyframes])
    return observation_pose(R, x, v, omega, camera.row_delay_s(uv_px[..., 1]))


def reprojections(
    keyframe: SmoothKeyframe, camera: CameraModel, p_world: FloatArray, uv_px: FloatArray, xy: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of n landmarks seen by a keyframe: what an image exposed at once would have shown, and how far that is off.

    Returns:
        Normalised coordinates (n, 2) as measured, moved from their row's time to the image's; their sigma (n,) per
        sigma of a pixel; whitened distance (n,) from the predicted ones, infinite behind the camera.
    """
    T = keyframe.T_world_body
    n = len(p_world)
    R, x = np.broadcast_to(T[:3, :3], (n, 3, 3)), np.broadcast_to(T[:3, 3], (n, 3))
    at_once, _, in_front = normalised_points(camera, R, x, p_world)
    if camera.line_delay_s:
        delay = camera.row_delay_s(uv_px[:, 1])
        R, x = observation_pose(R, x, keyframe.v_world, keyframe.omega, delay)
        in_row, _, row_in_front = normalised_points(camera, R, x, p_world)
        in_front = in_front & row_in_front
        xy = xy + np.where(in_front[:, None], at_once - in_row, 0.0)
    W = camera.lens.whitening(xy, camera.sigma_px)
    distance = np.linalg.norm((W @ (xy - at_once)[..., None])[..., 0], axis=1)
    sigma = 1.0 / np.sqrt(np.abs(np.linalg.det(W)))
    return xy, sigma, np.where(in_front, distance, np.inf)


def camera_pose(T_world_body: FloatArray, camera: CameraModel) -> FloatArray:
    return T_world_body @ se3(camera.R_body_cam, camera.t_body_cam)
