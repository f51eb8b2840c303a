"""Counts how many keyframes saw through each cell: one sight more costs a window of cells, whatever came before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.places.space.sight import Sight

SEEN_BY = 2  # keyframes that must have seen through a cell: one may hold false landmarks
FARTHEST_M = 6.0  # farther landmarks say little about where exactly space ends
MAX_CELLS = 4_000_000
MOST = np.iinfo(np.uint16).max


@dataclass(slots=True, eq=False)
class Carving:
    """A grid that sights are added to. Cell [i, j] begins at `low` + (i, j) * `cell`."""

    low: FloatArray  # (2,) map units, on the ground
    cell: float  # map units
    seen: npt.NDArray[np.uint16]  # keyframes that saw through each cell

    @classmethod
    def around(cls, path: FloatArray, metre: float, cell_m: float) -> Carving:
        """Room for what can be seen from a path (n, 2)."""
        low, high = path.min(axis=0) - FARTHEST_M * metre, path.max(axis=0) + FARTHEST_M * metre
        cell = cell_m * metre
        shape = np.ceil((high - low) / cell).astype(int)
        while np.prod(shape.astype(float)) > MAX_CELLS:  # a path through a whole building, or one that ran away
            cell, shape = 2 * cell, -(-shape // 2)
        return cls(low, cell, np.zeros(shape, dtype=np.uint16))

    def add(self, sight: Sight) -> None:
        """Count one more keyframe for the cells that it saw through."""
        far = float(sight.reach.max())
        begin = np.maximum(np.floor((sight.eye - far - self.low) / self.cell).astype(int), 0)
        end = np.minimum(np.ceil((sight.eye + far - self.low) / self.cell).astype(int), self.seen.shape)
        if np.any(end <= begin):
            return
        x, y = (self.low[i] + (np.arange(begin[i], end[i]) + 0.5) * self.cell for i in range(2))
        middles = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        window = self.seen[begin[0] : end[0], begin[1] : end[1]]
        through = sight.sees_through(middles.reshape(-1, 2)).reshape(window.shape)
        window += through & (window < MOST)
