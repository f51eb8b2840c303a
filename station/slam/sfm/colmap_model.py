"""A model that COLMAP made, as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, inverse
from station.model.frames import ImageFrame
from station.slam.mapping.assemble import Reconstructed, good_landmarks, make_keyframes, make_landmarks
from station.slam.sfm.colmap import COLMAP_PIXEL_CENTRE, pycolmap
from station.slam.sfm.config import SfmConfig
from station.slam.sfm.visual import CAMERA_ID
from station.vision.features import Features


def read_model(
    model: pycolmap.Reconstruction,
    frames: Sequence[ImageFrame],
    features: Sequence[Features],
    camera: CameraCalibration,
    config: SfmConfig,
    refined: bool,
) -> Reconstructed:
    """Keyframes in time order and the landmarks worth keeping, with their observations and colours."""
    registered = sorted(number - 1 for number in model.reg_image_ids())
    index_of = {k: i for i, k in enumerate(registered)}
    T_world_cam = np.stack([_pose(model, k) for k in registered])
    keyframes = make_keyframes([frames[k] for k in registered], T_world_cam)
    points, owner, seen_from, feature = _observations(model, index_of, config)
    uv = np.array(
        [features[registered[k]].uv_px[f] for k, f in zip(seen_from.tolist(), feature.tolist(), strict=True)]
    ).reshape(-1, 2)
    keep = good_landmarks(points, owner, seen_from, T_world_cam[:, :3, 3], config.mapping)
    landmarks = make_landmarks(keyframes, keep, points, np.zeros((len(points), 3, 3)), owner, seen_from, uv)
    return Reconstructed(keyframes, landmarks, _calibrated(model, camera) if refined else camera)


def _pose(model: pycolmap.Reconstruction, k: int) -> FloatArray:
    T_cam_world = np.eye(4)
    T_cam_world[:3] = model.image(k + 1).cam_from_world().matrix()
    return inverse(T_cam_world)


def _observations(
    model: pycolmap.Reconstruction, index_of: dict[int, int], config: SfmConfig
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Points (M, 3) and of each observation: point, keyframe, feature."""
    points: list[FloatArray] = []
    owner: list[int] = []
    seen_from: list[int] = []
    feature: list[int] = []
    model.update_point_3d_errors()
    for _, point in sorted(model.points3D.items()):
        if point.error > config.max_reprojection_error_px:
            continue
        elements = sorted((index_of[e.image_id - 1], e.point2D_idx) for e in point.track.elements)
        for k, f in elements:
            owner.append(len(points))
            seen_from.append(k)
            feature.append(f)
        points.append(point.xyz)
    p_world = np.array(points, dtype=np.float64).reshape(-1, 3)
    return p_world, np.array(owner, np.int64), np.array(seen_from, np.int64), np.array(feature, np.int64)


def _calibrated(model: pycolmap.Reconstruction, camera: CameraCalibration) -> CameraCalibration:
    """The camera with COLMAP's refined numbers (model RADIAL: f, cx, cy, k1, k2; or OPENCV)."""
    params = [float(p) for p in model.camera(CAMERA_ID).params]
    if model.camera(CAMERA_ID).model_name == "OPENCV":
        fx, fy, cx, cy, *distortion = params
    else:
        f, cx, cy, k1, k2 = params
        fx, fy, distortion = f, f, [k1, k2, 0.0, 0.0]
    return msgspec.structs.replace(
        camera,
        fx=fx,
        fy=fy,
        cx=cx - COLMAP_PIXEL_CENTRE,
        cy=cy - COLMAP_PIXEL_CENTRE,
        model="radtan",
        distortion=tuple(distortion),
    )
