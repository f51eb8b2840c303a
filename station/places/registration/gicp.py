"""Generalized ICP by one of two libraries. Both are rigid: a scale is applied to the source first."""

from __future__ import annotations

import importlib.util

import numpy as np

from shared.advice import install
from shared.errors import ConfigError, EstimationError
from shared.geometry import FloatArray, scale_of, sim3, transform
from station.places.registration.cloud import NEIGHBOURS
from station.places.registration.result import Backend


def require_backend(backend: Backend) -> None:
    """Raises ConfigError when the library is not installed."""
    if backend not in ("small_gicp", "open3d"):
        raise ConfigError(f"backend {backend!r} is not known; choose small_gicp or open3d")
    if importlib.util.find_spec(backend) is None:
        raise ConfigError(f"backend {backend} is missing; run: {install(_extra(backend))}")


def _extra(backend: Backend) -> str:
    return "open3d" if backend == "open3d" else "station"


def align_gicp(
    target: FloatArray, source: FloatArray, T_start: FloatArray, *, reach: float, backend: Backend
) -> FloatArray:
    """Refine T_start (4, 4, with scale) rigidly; the scale stays.

    Args:
        target: (N, 3), thinned already: neither library is asked to downsample.
        source: (M, 3), only points that have a counterpart (neither library trims).
        reach: largest distance of a correspondence, target units.
    Raises:
        EstimationError: the library returned something that is no motion.
    Source: Segal, Haehnel, Thrun: Generalized-ICP, RSS 2009.
    """
    scale = scale_of(T_start)
    # Centred on the target's mean and in units of the reach, as the libraries' stopping thresholds are absolute.
    centre = target.mean(axis=0)
    unit = reach / 0.3
    p_target = (target - centre) / unit
    p_source = (transform(T_start, source) - centre) / unit
    align = _small_gicp if backend == "small_gicp" else _open3d
    T = align(p_target, p_source, 0.3)
    if not np.isfinite(T).all() or abs(np.linalg.det(T[:3, :3]) - 1) > 1e-3:
        raise EstimationError(f"{backend} returned no rigid motion")
    to_unit = sim3(1 / unit, np.eye(3), -centre / unit)
    from_unit = sim3(unit, np.eye(3), centre)
    out = from_unit @ T @ to_unit @ T_start
    out[:3, :3] *= scale / scale_of(out)  # rounding only
    return out


def _small_gicp(target: FloatArray, source: FloatArray, reach: float) -> FloatArray:
    import small_gicp

    # Raw arrays would be downsampled to 0.25 silently: prepare them with a voxel that keeps every point. The library
    # counts a million voxels to each side of the origin; beyond, it lumps points together.
    tiny = max(1e-3, 1e-6 * float(max(np.abs(target).max(), np.abs(source).max())))
    A, tree = small_gicp.preprocess_points(target, downsampling_resolution=tiny, num_neighbors=NEIGHBOURS)
    B, _ = small_gicp.preprocess_points(source, downsampling_resolution=tiny, num_neighbors=NEIGHBOURS)
    result = small_gicp.align(
        A,
        B,
        tree,
        np.eye(4),
        registration_type="GICP",
        max_correspondence_distance=reach,
        num_threads=1,  # two threads sum in another order at every run
        max_iterations=20,
        rotation_epsilon=2e-4,
        translation_epsilon=2e-4,
    )
    return np.asarray(result.T_target_source, dtype=np.float64)


def _open3d(target: FloatArray, source: FloatArray, reach: float) -> FloatArray:
    import open3d as o3d

    A = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(target)))
    B = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(source)))
    for cloud in (A, B):
        cloud.estimate_covariances(search_param=o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    result = o3d.pipelines.registration.registration_generalized_icp(
        B,
        A,
        reach,
        np.eye(4),
        o3d.pipelines.registration.TransformationEstimationForGeneralizedICP(),
        o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=30),
    )
    return np.asarray(result.transformation, dtype=np.float64)
