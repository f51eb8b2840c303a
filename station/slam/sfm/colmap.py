"""What COLMAP does for us: features, two-view geometry, incremental mapping of images alone, and the model it makes.

The only module that imports pycolmap. Scale and orientation of the model's world are its own.
"""

from __future__ import annotations

import signal
import tempfile
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import pycolmap

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, inverse
from station.model.frames import ImageArray, ImageFrame
from station.slam.mapping.assemble import Reconstructed, good_landmarks, make_keyframes, make_landmarks
from station.slam.mapping.config import MatchConfig
from station.slam.sfm.config import FeatureConfig, SfmConfig
from station.vision.features import Features
from station.vision.lens import Lens

# Importing pycolmap installs handlers that print a stack trace on SIGTERM, the signal every orderly stop uses: the
# process' own way to end is restored.
if threading.current_thread() is threading.main_thread():  # only there may handlers be set
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM) or signal.SIG_DFL)

# COLMAP puts the centre of the first pixel at (0.5, 0.5); ours is at (0, 0).
COLMAP_PIXEL_CENTRE = 0.5
CAMERA_ID = 1
VERSION: str = pycolmap.__version__
pycolmap.logging.minloglevel = max(pycolmap.logging.minloglevel, 2)


@dataclass(frozen=True, slots=True, eq=False)
class PinholeFeatures(Features):
    """SIFT features, the largest first."""

    uv_ideal_px: FloatArray  # (N, 2) where a pinhole camera with the same K would see them


class SiftExtractor:
    """Finds features; one per thread."""

    def __init__(self, config: FeatureConfig) -> None:
        options = pycolmap.FeatureExtractionOptions()
        options.use_gpu = False
        options.num_threads = 1
        options.sift.max_num_features = config.max_features
        options.sift.first_octave = config.first_octave
        options.sift.peak_threshold = config.peak_threshold
        options.sift.max_num_orientations = 1
        self._extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)

    def extract(self, grey: ImageArray, lens: Lens) -> PinholeFeatures:
        keypoints, found = self._extractor.extract_from_uint8_array(np.ascontiguousarray(grey))
        table = pycolmap.keypoints_to_matrix(keypoints)
        uv = table[:, :2].astype(np.float64) - COLMAP_PIXEL_CENTRE
        order = np.argsort(-table[:, 2], kind="stable") if len(table) else np.empty(0, np.int64)
        uv = uv[order]
        return PinholeFeatures(uv, np.asarray(found.data, dtype=np.uint8)[order], ideal_pixels(uv, lens))


def ideal_pixels(uv_px: FloatArray, lens: Lens) -> FloatArray:
    """Distorted pixels (N, 2) → pixels (N, 2) of the same camera without distortion."""
    camera = lens.camera
    return lens.unproject(uv_px) * [camera.fx, camera.fy] + [camera.cx, camera.cy]


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Keyframes a < b that see the same, with the features they share."""

    a: int
    b: int
    pairs: IntArray  # (M, 2) feature of a, feature of b
    geometry: pycolmap.TwoViewGeometry = field(repr=False)


def verify(
    a: int,
    b: int,
    pairs: IntArray,
    features: Sequence[PinholeFeatures],
    camera: pycolmap.Camera,
    config: MatchConfig,
    seed: int,
) -> Match | None:
    """The pairs of two keyframes that agree on one motion; None where they are too few."""
    if len(pairs) < config.min_inliers:
        return None
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = config.min_inliers
    options.ransac.max_error = config.max_error_px
    options.ransac.random_seed = seed
    options.ransac.max_num_trials = 2000
    options.detect_watermark = False
    geometry = pycolmap.estimate_calibrated_two_view_geometry(
        camera,
        features[a].uv_ideal_px + COLMAP_PIXEL_CENTRE,
        camera,
        features[b].uv_ideal_px + COLMAP_PIXEL_CENTRE,
        pairs.astype(np.uint32),
        options,
    )
    inliers = np.asarray(geometry.inlier_matches, dtype=np.int64).reshape(-1, 2)
    if len(inliers) < config.min_inliers:
        return None
    return Match(a, b, inliers, geometry)


def image_id(keyframe: int) -> int:
    """COLMAP counts from 1. Images, frames and pose priors share the number."""
    return keyframe + 1


def colmap_camera(camera: CameraCalibration, refine: bool) -> pycolmap.Camera:
    """The camera that ideal pixels come from; with room for distortion where the intrinsics are only a guess."""
    principal = [camera.cx + COLMAP_PIXEL_CENTRE, camera.cy + COLMAP_PIXEL_CENTRE]
    if refine:
        model, params = "RADIAL", [0.5 * (camera.fx + camera.fy), *principal, 0.0, 0.0]
    else:
        model, params = "PINHOLE", [camera.fx, camera.fy, *principal]
    made = pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=params, camera_id=CAMERA_ID)
    made.has_prior_focal_length = True
    return made


def fill_database(
    database: pycolmap.Database, camera: pycolmap.Camera, features: Sequence[PinholeFeatures], matches: Iterable[Match]
) -> None:
    """Everything the mapper asks for: camera, rig, frames, keypoints, verified matches."""
    database.write_camera(camera, use_camera_id=True)
    rig = pycolmap.Rig(rig_id=CAMERA_ID)
    rig.add_ref_sensor(camera.sensor_id)
    database.write_rig(rig, use_rig_id=True)
    for k, found in enumerate(features):
        number = image_id(k)
        image = pycolmap.Image(name=f"{k:06d}", camera_id=CAMERA_ID, image_id=number)
        database.write_image(image, use_image_id=True)
        frame = pycolmap.Frame(frame_id=number, rig_id=CAMERA_ID)
        frame.add_data_id(image.data_id)
        database.write_frame(frame, use_frame_id=True)
        database.write_keypoints(number, (found.uv_ideal_px + COLMAP_PIXEL_CENTRE).astype(np.float32))
    for match in matches:
        pair = (image_id(match.a), image_id(match.b))
        database.write_matches(*pair, match.pairs.astype(np.uint32))
        database.write_two_view_geometry(*pair, match.geometry)


def map_incrementally(
    camera: pycolmap.Camera,
    features: Sequence[PinholeFeatures],
    matches: Sequence[Match],
    config: SfmConfig,
    refine: bool,
) -> list[pycolmap.Reconstruction]:
    """Run COLMAP's incremental mapper; the models it could not connect come apart, largest first."""
    with tempfile.TemporaryDirectory(prefix="sfm-") as folder:
        database = pycolmap.Database.open(Path(folder) / "database.db")
        try:
            with pycolmap.DatabaseTransaction(database):
                fill_database(database, camera, features, matches)
            manager = pycolmap.ReconstructionManager()
            pipeline = pycolmap.IncrementalPipeline(pipeline_options(config, refine), database, manager)
            pipeline.run()
            models = [pycolmap.Reconstruction(manager.get(i)) for i in range(manager.size())]
        finally:
            database.close()
    return sorted(models, key=lambda model: -model.num_reg_images())


def pipeline_options(config: SfmConfig, refine: bool) -> pycolmap.IncrementalPipelineOptions:
    """COLMAP's defaults, made lighter for a robot's drive."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = config.seed
    options.num_threads = config.threads
    options.mapper.random_seed = config.seed
    options.triangulation.random_seed = config.seed
    options.extract_colors = False
    options.min_num_matches = config.matching.min_inliers
    options.ba_refine_focal_length = refine
    options.ba_refine_extra_params = refine
    options.ba_refine_principal_point = False
    options.mapper.abs_pose_refine_focal_length = refine
    options.mapper.abs_pose_refine_extra_params = refine
    options.mapper.init_min_tri_angle = 6.0
    options.mapper.abs_pose_min_num_inliers = 20
    options.mapper.abs_pose_max_error = 6.0
    options.mapper.filter_max_reproj_error = config.max_reprojection_error_px
    options.mapper.filter_min_tri_angle = config.min_triangulation_angle_deg
    options.triangulation.ignore_two_view_tracks = True
    options.ba_global_frames_ratio = 1.3
    options.ba_global_points_ratio = 1.3
    options.ba_local_max_num_iterations = 15
    options.ba_global_max_num_iterations = 30
    options.ba_global_max_refinements = 2
    options.ba_local_max_refinements = 1
    options.min_model_size = 5
    return options


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
