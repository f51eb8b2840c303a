"""Places as modes of a density: hill climbing with merging by prominence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray, IntArray
from station.places.voxels import Cells

CHUNK = 4096  # cells whose neighbours are held in memory at once


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Which hill each cell stands on."""

    label: IntArray  # (C,) 0..n-1
    density: FloatArray  # (C,)
    peak: FloatArray  # (n,) density on top of each hill
    prominence: FloatArray  # (n,) 1 - saddle / peak: 1 stands alone, 0 is a shoulder of a neighbour


def equalising_weights(cells: Cells, radius: float) -> FloatArray:
    """(C,) weights that sum to the square root of the number of points in a ball.

    How many points SLAM finds on one poster changes from drive to drive far more than where the poster hangs. The
    square root halves (in logarithm) what that does to the density; weight 1 per cell would lift noise to furniture.
    """
    tree = cKDTree(cells.p)
    around = np.empty(len(cells.p))
    for start in range(0, len(cells.p), CHUNK):
        near = cKDTree(cells.p[start : start + CHUNK]).sparse_distance_matrix(tree, radius, output_type="coo_matrix")
        around[start : start + CHUNK] = np.bincount(near.row, cells.count[near.col], minlength=near.shape[0])
    return cells.count / np.sqrt(np.maximum(around, cells.count))


def smooth_density(p: FloatArray, weight: FloatArray, bandwidth: float) -> FloatArray:
    """(C,) Gaussian kernel density of the weighted cells at themselves, in weights per kernel."""
    tree = cKDTree(p)
    density = np.empty(len(p))
    for start in range(0, len(p), CHUNK):
        rows = p[start : start + CHUNK]
        distance = cKDTree(rows).sparse_distance_matrix(tree, 3.0 * bandwidth, output_type="coo_matrix")
        kernel = np.exp(-0.5 * (distance.data / bandwidth) ** 2) * weight[distance.col]
        density[start : start + CHUNK] = np.bincount(distance.row, kernel, minlength=len(rows))
    return density


def climb(p: FloatArray, density: FloatArray, radius: float, min_prominence: float) -> Modes:
    """Hills of the density on the graph of cells closer than `radius`.

    Cells join from the highest down; where two hills meet, the lower one is merged when it rises less than
    `min_prominence` of its own height above the saddle. Source: Chazal et al., JACM 60(6), 2013, algorithm 1, with
    a relative threshold, so that the density's unit does not matter.
    """
    order = np.argsort(-density, kind="stable")
    rank = np.empty(len(p), dtype=np.int64)
    rank[order] = np.arange(len(p))
    tree = cKDTree(p)
    parent = np.full(len(p), -1, dtype=np.int64)  # union-find; a root is the top of its hill
    saddle: dict[int, float] = {}

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = int(parent[i])
        return i

    for start in range(0, len(order), CHUNK):
        chunk = order[start : start + CHUNK]
        for i, near in zip(chunk.tolist(), tree.query_ball_point(p[chunk], radius), strict=True):
            higher = [j for j in near if rank[j] < rank[i]]
            if not higher:
                parent[i] = i
                continue
            parent[i] = root(min(higher, key=lambda j: rank[j]))
            for j in higher:
                a, b = root(i), root(j)
                if a == b:
                    continue
                low, high = (a, b) if rank[a] > rank[b] else (b, a)
                if density[i] > (1.0 - min_prominence) * density[low]:
                    parent[low] = high
                else:
                    for top in (low, high):
                        saddle[top] = max(saddle.get(top, 0.0), float(density[i]))
    roots = np.array([root(i) for i in range(len(p))], dtype=np.int64)
    tops, label = np.unique(roots, return_inverse=True)
    peak = density[tops]
    prominence = 1.0 - np.array([saddle.get(int(t), 0.0) for t in tops]) / peak
    return Modes(label=label.reshape(-1).astype(np.int64), density=density, peak=peak, prominence=prominence)
