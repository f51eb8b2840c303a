"""What mapping made → keyframes, poses and landmarks as plain arrays, weak landmarks dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray
from station.model.frames import ImageFrame
from station.model.navigation import Keyframes, Landmarks
from station.slam.mapping.config import MappingConfig


@dataclass(frozen=True, slots=True, eq=False)
class Reconstructed:
    """A model in the world frame and scale of its own."""

    keyframes: Keyframes  # T_world_cam in that world
    landmarks: Landmarks
    camera: CameraCalibration  # refined, where asked for
    is_drive_metric: bool = False  # its unit is the metre of the drive commands


def make_keyframes(frames: Sequence[ImageFrame], T_world_cam: FloatArray) -> Keyframes:
    """Keyframes of one segment."""
    return Keyframes(
        frame_index=np.array([frame.index for frame in frames], dtype=np.int64),
        t_robot_ns=np.array([frame.t_robot_ns for frame in frames], dtype=np.int64),
        T_world_cam=T_world_cam,
        encoded=tuple(frame.encoded for frame in frames),
        segment=np.zeros(len(frames), dtype=np.int64),
    )


def make_landmarks(
    keyframes: Keyframes,
    keep: npt.NDArray[np.bool_],
    points: FloatArray,
    cov_world: FloatArray,
    owner: IntArray,
    seen_from: IntArray,
    uv: FloatArray,
) -> Landmarks:
    """The kept points with their observations, renumbered and coloured."""
    number = np.cumsum(keep) - 1
    rows = keep[owner] if len(owner) else np.empty(0, dtype=bool)
    owner, seen_from, uv = number[owner[rows]].astype(np.int64), seen_from[rows], uv[rows]
    rgb = sample_colours(keyframes.encoded, owner, seen_from, uv, int(keep.sum()))
    return Landmarks(points[keep], rgb, cov_world[keep], owner, seen_from, uv)


def good_landmarks(
    points: FloatArray, owner: IntArray, seen_from: IntArray, centres: FloatArray, config: MappingConfig
) -> npt.NDArray[np.bool_]:
    """(M,) landmarks seen often enough and from directions far enough apart to have a sure depth."""
    length = np.bincount(owner, minlength=len(points))
    rays = points[owner] - centres[seen_from]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    # The widest angle of a track is at least its angle to the mean ray: cheap and safe.
    mean = np.zeros_like(points)
    np.add.at(mean, owner, rays)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    off_mean = np.arccos(np.clip((rays * mean[owner]).sum(axis=1), -1.0, 1.0))
    widest = np.zeros(len(points))
    np.maximum.at(widest, owner, off_mean)
    wide_enough = 2.0 * widest >= np.radians(config.min_triangulation_angle_deg)
    return (length >= config.min_track_length) & wide_enough


def sample_colours(
    encoded: Sequence[bytes], owner: IntArray, seen_from: IntArray, uv_px: FloatArray, num_points: int
) -> npt.NDArray[np.uint8]:
    """Mean colour (M, 3) RGB of each landmark over the keyframes that see it."""
    total, count = np.zeros((num_points, 3)), np.zeros(num_points)
    for k, file in enumerate(encoded):
        rows = np.flatnonzero(seen_from == k)
        if not len(rows):
            continue
        image = ImageFrame(k, 0, 0, file).bgr()
        u = np.clip(np.round(uv_px[rows, 0]).astype(int), 0, image.shape[1] - 1)
        v = np.clip(np.round(uv_px[rows, 1]).astype(int), 0, image.shape[0] - 1)
        np.add.at(total, owner[rows], image[v, u, ::-1].astype(np.float64))
        np.add.at(count, owner[rows], 1.0)
    return np.round(total / np.maximum(count, 1.0)[:, None]).astype(np.uint8)
