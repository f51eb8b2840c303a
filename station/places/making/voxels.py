"""Points → occupied cells: how often a surface was seen must not decide where a place is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    p: FloatArray  # (C, 3) mean of the points in each cell
    count: IntArray  # (C,) points in each cell
    cell_of_point: IntArray  # (M,) index into the cells
    size: float  # edge of a cell, map units


def voxelise(p: FloatArray, *, smallest: float, max_cells: int) -> Cells:
    """Cells of edge `smallest`, or larger (doubling the volume) until at most `max_cells` are occupied."""
    size = smallest
    while True:
        # From the cloud's own corner: the origin of a map is an accident.
        key = np.floor((p - p.min(axis=0)) / size).astype(np.int64)
        _, cell_of_point, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
        if len(count) <= max_cells:
            break
        size *= 2 ** (1 / 3)
    cell_of_point = cell_of_point.reshape(-1)
    total = np.zeros((len(count), 3))
    np.add.at(total, cell_of_point, p)
    return Cells(p=total / count[:, None], count=count, cell_of_point=cell_of_point, size=size)
