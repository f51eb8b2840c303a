"""A point cloud made ready for registration: cleaned, with spacing, local planes and a search tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.errors import DataError, DegenerateGeometry
from shared.geometry import FloatArray

MIN_POINTS = 50  # below it no statistic of an alignment means anything
NEIGHBOURS = 12  # a local plane needs about ten points; more blurs corners of furniture
MAX_POINTS = 20_000  # larger clouds are thinned: more points add time, not certainty


@dataclass(frozen=True, slots=True, eq=False)
class PreparedCloud:
    points: FloatArray  # (N, 3) thinned to at most MAX_POINTS
    normals: FloatArray  # (N, 3) unit, sign arbitrary
    flatness: FloatArray  # (N,) 0 (ball or line) .. 1 (plane)
    tree: cKDTree
    spacing: float  # median distance to the 4th neighbour: how far apart landmarks are
    noise: float  # median distance of a point from its neighbours' plane
    radius: float  # RMS horizontal distance from the median


def clean_points(points: FloatArray, name: str) -> FloatArray:
    """Points (N, 3) that are finite and distinct.

    Raises:
        DataError: not (N, 3).
        DegenerateGeometry: too few points, all on one point, line or plane.
    """
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3:
        raise DataError(f"the {name} cloud has shape {p.shape}, needs (N, 3)")
    finite = np.isfinite(p).all(axis=1)
    if len(p) and not finite.any():
        raise DegenerateGeometry(f"the {name} cloud holds no finite point")
    given, p = np.count_nonzero(finite), _distinct(p[finite])
    if len(p) == 1 < given:
        raise DegenerateGeometry(f"all points of the {name} cloud coincide")
    if len(p) < MIN_POINTS:
        raise DegenerateGeometry(f"the {name} cloud has {len(p)} usable points, needs at least {MIN_POINTS}")
    # Percentiles instead of extremes: a few far outliers must not hide that the rest lies on a plane.
    _check_spread(p, name)
    return p


def _distinct(points: FloatArray) -> FloatArray:
    """Every point once, in their order: many of one point would hide the others from every median."""
    rows = np.ascontiguousarray(points).view(np.dtype((np.void, 24)))[:, 0]
    first = np.unique(rows, return_index=True)[1]
    return points if len(first) == len(points) else points[np.sort(first)]


def _check_spread(p: FloatArray, name: str) -> None:
    centred = p - np.median(p, axis=0)
    _, _, Vt = np.linalg.svd(centred[:: max(1, len(p) // 5000)], full_matrices=False)
    widths = np.sort([float(np.subtract(*np.percentile(centred @ axis, [95, 5]))) for axis in Vt])[::-1]
    if widths[0] <= 0:
        raise DegenerateGeometry(f"all points of the {name} cloud coincide")
    if widths[1] < 1e-3 * widths[0]:
        raise DegenerateGeometry(f"all points of the {name} cloud lie on one line: a rotation stays unknown")
    if widths[2] < 1e-3 * widths[0]:
        raise DegenerateGeometry(
            f"all points of the {name} cloud lie on one plane: motions along it stay unknown; record from more sides"
        )


def prepare_cloud(points: FloatArray, rng: np.random.Generator) -> PreparedCloud:
    """Points (N, 3), clean, with local planes (PCA of NEIGHBOURS nearest points, reweighted once against outliers)."""
    if len(points) > MAX_POINTS:
        points = thin(points, MAX_POINTS, rng)
    tree = cKDTree(points)
    k = min(NEIGHBOURS + 1, len(points))
    distance, index = tree.query(points, k=k, workers=2)
    neighbours = points[index]
    weight = np.ones((len(points), k))
    for _ in range(2):
        total = weight.sum(axis=1)[:, None]
        mean = np.matmul(weight[:, None], neighbours)[:, 0] / total  # batched products: einsum takes five times as long
        offset = neighbours - mean[:, None]
        cov = np.matmul((weight[..., None] * offset).transpose(0, 2, 1), offset) / total[..., None]
        values, vectors = np.linalg.eigh(cov)
        normals = np.ascontiguousarray(vectors[:, :, 0])
        residual = np.abs(np.matmul(offset, normals[..., None])[..., 0])
        sigma = 1.5 * np.median(residual, axis=1)[:, None] + 1e-12
        weight = 1.0 / (1.0 + (residual / sigma) ** 2)
    flatness = np.clip((values[:, 1] - values[:, 0]) / np.maximum(values[:, 1], 1e-18), 0, 1)
    centred = points[:, :2] - np.median(points[:, :2], axis=0)
    squared = (centred**2).sum(axis=1)
    return PreparedCloud(
        points=points,
        normals=normals,
        flatness=flatness,
        tree=tree,
        spacing=float(np.median(distance[:, min(4, k - 1)])),
        noise=float(np.median(residual[:, 0])),
        radius=float(np.sqrt(np.median(squared) or squared.mean())),
    )


def thin(points: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """About `count` of the points, evenly in space: one per voxel, at random, with the voxel that gives the count."""
    low, high = points.min(axis=0), points.max(axis=0)
    shuffled = points[rng.permutation(len(points))]
    size = float(np.max(high - low)) / 2
    while True:
        key = np.floor((shuffled - low) / size).astype(np.int64)
        _, first = np.unique(key @ np.array([1, 1 << 20, 1 << 40]), return_index=True)
        if len(first) >= count or size < 1e-9:
            return shuffled[np.sort(first)[:count]]
        size *= 0.8
