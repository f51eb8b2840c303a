"""Incremental structure from motion by pycolmap: images only, scale and orientation of the world are its own."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from shared.calibration import CameraCalibration
from station.slam.sfm.colmap import COLMAP_PIXEL_CENTRE, pycolmap
from station.slam.sfm.config import SfmConfig
from station.slam.sfm.sift import PinholeFeatures
from station.slam.sfm.two_view import Match

CAMERA_ID = 1


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
