"""Free space: what lies between a camera and a landmark it sees must be empty in the other cloud, too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Who saw what: ray k goes from viewpoint `viewpoint[k]` to point `point[k]` of the cloud as given."""

    viewpoints: FloatArray  # (V, 3) camera centres, the cloud's frame
    viewpoint: IntArray  # (K,) index into viewpoints
    point: IntArray  # (K,) index into the cloud


@dataclass(frozen=True, slots=True)
class Watched:
    """Points of one cloud in the space that the other navigation watched: on its surfaces, or where it saw through."""

    points: int  # all of them
    violating: int  # those where rays went through

    @property
    def share(self) -> float:
        """Violating ones, 0..1; nan where nothing was watched."""
        return self.violating / self.points if self.points else float("nan")


MAX_RAYS = 20_000
MIN_RAYS_PER_VOXEL = 2  # one ray may belong to a false landmark


def watched_points(
    p_rays: FloatArray, rays: Rays, p_other: FloatArray, voxel: float, rng: np.random.Generator
) -> Watched:
    """How many of p_other lie in the space that rays of the first cloud watched, and where they went through.

    Args:
        p_rays: (N, 3) the cloud the rays end in.
        p_other: (M, 3) the other cloud, in the same frame.
        voxel: resolution; the last two voxels before a landmark do not count as free.
    """
    pick = np.arange(len(rays.point))
    if len(pick) > MAX_RAYS:
        pick = rng.choice(pick, MAX_RAYS, replace=False)
    start = rays.viewpoints[rays.viewpoint[pick]]
    end = p_rays[rays.point[pick]]
    good = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    start, end = start[good], end[good]
    length = np.linalg.norm(end - start, axis=1)
    usable = length > 3 * voxel
    start, end, length = start[usable], end[usable], length[usable]
    if not len(start):
        return Watched(0, 0)
    low = np.minimum(start.min(axis=0), end.min(axis=0)) - voxel
    shape = (np.ceil((np.maximum(start.max(axis=0), end.max(axis=0)) - low) / voxel) + 2).astype(int)
    if np.prod(shape.astype(float)) > 5e7:
        return Watched(0, 0)
    free = np.zeros(int(np.prod(shape)), dtype=np.int32)
    steps = np.arange(0.5, float(length.max()) / voxel, 1.0) * voxel
    for distance in steps:
        alive = distance < length - 2 * voxel
        at = start[alive] + (end[alive] - start[alive]) * (distance / length[alive])[:, None]
        free += np.bincount(_flat_index(at, low, voxel, shape), minlength=len(free)).astype(np.int32)
    occupied = np.zeros(len(free), dtype=np.int32)
    occupied += np.bincount(_flat_index(end, low, voxel, shape), minlength=len(free)).astype(np.int32)
    inside = ((p_other > low) & (p_other < low + (shape - 1) * voxel)).all(axis=1)
    where = _flat_index(p_other[inside], low, voxel, shape)
    # A voxel with landmarks is a surface even when some rays graze it.
    is_free = (free[where] >= MIN_RAYS_PER_VOXEL) & (free[where] > 4 * occupied[where])
    watched = is_free | (occupied[where] > 0)
    return Watched(int(np.count_nonzero(watched)), int(np.count_nonzero(is_free)))


def _flat_index(p: FloatArray, low: FloatArray, voxel: float, shape: IntArray) -> IntArray:
    index = np.floor((p - low) / voxel).astype(np.int64)
    return (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
