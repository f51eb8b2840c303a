"""Places as modes of a density: hill climbing with merging by prominence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray, IntArray
from station.places.making.voxels import Cells

CHUNK = 4096  # cells whose neighbours are held in memory at once
KERNEL_REACH = 3.0  # bandwidths at which a Gaussian ends
MIN_SADDLE = 0.5  # of the lower hill's height: across a deeper valley nothing belongs together, however few its points


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


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """A smoothed density at the cells, and how sure it is."""

    value: FloatArray  # (C,) weights per kernel
    sigma: FloatArray  # (C,) its standard deviation, as if each point had come by chance
    weight: FloatArray  # (C,) of the cells
    tree: cKDTree  # of the cells
    bandwidth: float

    def lowest_between(self, a: FloatArray, b: FloatArray) -> float:
        """The least density along the segment from a to b (3,), both ends left out; inf for a short one.

        Between points nearer than the bandwidth a density smoothed by it has no valley to speak of.
        """
        pieces = int(np.ceil(np.linalg.norm(b - a) / self.bandwidth))
        lowest = float("inf")
        for k in range(1, pieces):
            q = a + (b - a) * (k / pieces)
            near = self.tree.query_ball_point(q, KERNEL_REACH * self.bandwidth)
            squared = ((self.tree.data[near] - q) ** 2).sum(axis=1)
            lowest = min(lowest, float(self.weight[near] @ np.exp(-0.5 * squared / self.bandwidth**2)))
        return lowest


def smooth_density(p: FloatArray, weight: FloatArray, bandwidth: float) -> Density:
    """Gaussian kernel density of the weighted cells at themselves.

    Its variance is that of a weighted Poisson process, sum (w K)^2.
    """
    tree = cKDTree(p)
    value, variance = np.empty(len(p)), np.empty(len(p))
    for start in range(0, len(p), CHUNK):
        rows = p[start : start + CHUNK]
        distance = cKDTree(rows).sparse_distance_matrix(tree, KERNEL_REACH * bandwidth, output_type="coo_matrix")
        kernel = np.exp(-0.5 * (distance.data / bandwidth) ** 2) * weight[distance.col]
        value[start : start + CHUNK] = np.bincount(distance.row, kernel, minlength=len(rows))
        variance[start : start + CHUNK] = np.bincount(distance.row, kernel**2, minlength=len(rows))
    return Density(value, np.sqrt(variance), weight, tree, bandwidth)


def climb(
    p: FloatArray,
    density: Density,
    *,
    reach: float,
    min_prominence: float,
    min_significance: float,
    max_span: float = np.inf,
) -> Modes:
    """Hills of the density on the graph of cells closer than `reach`.

    Cells join from the highest down. Two cells are connected at the lowest density on the way between them, so that
    a longer reach bridges gaps between landmarks but never a valley: it changes little. Where two hills meet, the
    lower one becomes part of the other when it rises less than `min_prominence` of its own height, or less than
    `min_significance` of its standard deviations, above the saddle: another drive would not see it. Peaks farther
    apart than `max_span` stay two hills, so that an evenly covered wall does not become one. Source: Chazal et al.,
    "Persistence-based clustering in Riemannian manifolds" (ToMATo), JACM 60(6), 2013, algorithm 1; the valleys, the
    relative threshold, the significance and the span are ours.
    """
    value = density.value
    rise = np.maximum(min_prominence * value, min_significance * density.sigma)
    order = np.argsort(-value, kind="stable")
    rank = np.empty(len(p), dtype=np.int64)
    rank[order] = np.arange(len(p))
    top = np.full(len(p), -1, dtype=np.int64)  # of the hill that a cell joined; that hill may have joined another since
    parent: dict[int, int] = {}  # union-find over tops
    saddle: dict[int, float] = {}

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    def meet(a: int, b: int, level: float) -> None:
        a, b = root(a), root(b)
        if a == b:
            return
        low, high = (a, b) if rank[a] > rank[b] else (b, a)
        is_part = value[low] - level < rise[low] and level >= MIN_SADDLE * value[low]
        if is_part and np.linalg.norm(p[low] - p[high]) <= max_span:
            parent[low] = high
            return
        for peak in (low, high):
            saddle[peak] = max(saddle.get(peak, 0.0), level)

    for start in range(0, len(order), CHUNK):
        chunk = order[start : start + CHUNK]
        begin, higher = _higher_around(p, rank, chunk, density.tree, reach)
        for k, i in enumerate(chunk.tolist()):
            mine = higher[begin[k] : begin[k + 1]]
            _, first = np.unique(top[mine], return_index=True)
            level: dict[int, float] = {}  # of every hill in reach: at which density the cell is connected with it
            for j in mine[np.sort(first)].tolist():  # the nearest cell of each
                hill = root(int(top[j]))
                if hill not in level:
                    level[hill] = min(float(value[i]), density.lowest_between(p[i], p[j]))
            uphill = next((hill for hill, at in level.items() if at == value[i]), None)  # the nearest without a valley
            if uphill is None:
                parent[i] = i
            top[i] = i if uphill is None else uphill
            for hill, at in sorted(level.items(), key=lambda item: -item[1]):
                meet(int(top[i]), hill, at)
    roots = np.array([root(i) for i in top.tolist()], dtype=np.int64)
    tops, label = np.unique(roots, return_inverse=True)
    peak = value[tops]
    prominence = 1.0 - np.array([saddle.get(int(t), 0.0) for t in tops]) / peak
    return Modes(label=label.reshape(-1).astype(np.int64), density=value, peak=peak, prominence=prominence)


def _higher_around(
    p: FloatArray, rank: IntArray, chunk: IntArray, tree: cKDTree, reach: float
) -> tuple[IntArray, IntArray]:
    """Of the k-th cell of a chunk: the higher cells within reach, nearest first, at begin[k] : begin[k + 1]."""
    near = cKDTree(p[chunk]).sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    is_higher = rank[near.col] < rank[chunk[near.row]]
    row, col = near.row[is_higher], near.col[is_higher]
    order = np.argsort(row + 0.5 * near.data[is_higher] / reach, kind="stable")  # by row, within it by distance
    return np.searchsorted(row[order], np.arange(len(chunk) + 1)), col[order].astype(np.int64)
