"""Space: what a navigation saw to be free, and which part of that its map knows.

A camera sees through free space up to the landmarks that it observes. So every keyframe carves a star of free cells
over the ground, and what several keyframes carved is free. A map knows the free space that its navigation's path
reaches without squeezing through what the path itself never passed: behind the door of a room that was only looked
into, it ends. Where nobody knows the map's scale, lengths follow how far its cameras saw; where nobody measured
gravity, the ground follows how its cameras were held (`making/scale.py`): the boundary turns and scales with the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray, IntArray
from station.model.navigation import Navigation
from station.places.making.scale import ground_rotation, units_per_metre
from station.places.space.sight import Sight, sights

Cells = npt.NDArray[np.bool_]

CELL_M = 0.1
SEEN_BY = 2  # keyframes that must have seen through a cell: one may hold false landmarks
FARTHEST_M = 6.0  # farther landmarks say little about where exactly space ends
PASSAGE_M = 1.0  # what is narrower ends the map where the path did not go through: doors are some 0.9 m wide
DRIVEN_M = 0.2  # this near the path space is free: the robot was there itself
AT_HAND_M = 0.4  # ... and known, also behind the cameras, unless it was seen to lie beyond a door
CARRIED_AT_HAND_M = 1.0  # a rig in somebody's hands swings about, and never looked behind itself
MAX_CELLS = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Columns over the ground, equally wide: `free[i, j]` from `low` on along x and y."""

    R_ground_map: FloatArray  # (3, 3) to axes whose z is up
    low: FloatArray  # (2,) map units, on the ground
    cell: float  # map units
    free: Cells  # seen through, or driven through
    known: Cells  # the part of it that belongs to the map, and what is at hand of the path

    @classmethod
    def of(cls, navigation: Navigation) -> Space:
        """What this navigation saw; nothing without keyframes."""
        R = ground_rotation(navigation)
        path = (_path(navigation) @ R.T)[:, :2]
        if not len(path):
            return cls(R, np.zeros(2), 1.0, *np.zeros((2, 0, 0), dtype=np.bool_))
        metre = units_per_metre(navigation)
        cell = CELL_M * metre
        low = path.min(axis=0) - FARTHEST_M * metre
        shape = np.ceil((path.max(axis=0) + FARTHEST_M * metre - low) / cell).astype(int)
        while np.prod(shape.astype(float)) > MAX_CELLS:  # a path through a whole building, or one that ran away
            cell, shape = 2 * cell, -(-shape // 2)
        seen = np.zeros(shape, dtype=np.int32)
        for sight in sights(navigation, R, FARTHEST_M * metre):
            _carve(seen, low, cell, sight)
        on_path = np.zeros(shape, dtype=np.bool_)
        on_path[tuple(np.floor((path - low) / cell).astype(int).T)] = True
        driven = _within(on_path, DRIVEN_M * metre / cell)
        free = (seen >= SEEN_BY) | driven
        at_hand_m = AT_HAND_M if navigation.calibration.has_wheels else CARRIED_AT_HAND_M
        reached = _reached(free, driven, 0.5 * PASSAGE_M * metre / cell)
        known = reached | driven | (_within(on_path, at_hand_m * metre / cell) & (seen < SEEN_BY))
        return cls(R, low, cell, free, known)

    def knows(self, p_map: FloatArray) -> Cells:
        """(n,) whether positions (n, 3) lie where the map knows its way."""
        index = np.floor(((p_map @ self.R_ground_map.T)[:, :2] - self.low) / self.cell).astype(np.int64)
        inside = np.all((index >= 0) & (index < self.known.shape), axis=1)
        found = np.zeros(len(p_map), dtype=np.bool_)
        found[inside] = self.known[tuple(index[inside].T)]
        return found


def _path(navigation: Navigation) -> FloatArray:
    """(n, 3) finite positions of the cameras and of the body."""
    p = np.concatenate([navigation.keyframes.T_world_cam[:, :3, 3], navigation.trajectory.T_world_body[:, :3, 3]])
    return np.asarray(p[np.isfinite(p).all(axis=1)])


def _carve(seen: IntArray, low: FloatArray, cell: float, sight: Sight) -> None:
    """Count one more keyframe for the cells that it saw through."""
    begin = np.maximum(np.floor((sight.eye - sight.farthest - low) / cell).astype(int), 0)
    end = np.minimum(np.ceil((sight.eye + sight.farthest - low) / cell).astype(int), seen.shape)
    if np.any(end <= begin):
        return
    x, y = (low[i] + (np.arange(begin[i], end[i]) + 0.5) * cell for i in range(2))
    middles = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    window = seen[begin[0] : end[0], begin[1] : end[1]]
    window += sight.sees_through(middles.reshape(-1, 2)).reshape(window.shape)


def _within(cells: Cells, distance: float) -> Cells:
    """Cells no farther than `distance` (cells) from some of these."""
    return np.asarray(ndimage.distance_transform_edt(~cells) <= distance, dtype=np.bool_)


def _reached(free: Cells, driven: Cells, radius: float) -> Cells:
    """The free cells that a disc of this radius (cells) covers wherever it can roll to from where the robot drove.

    Opening by reconstruction (Vincent, IEEE Trans. Image Processing 1993).
    """
    wide = ndimage.distance_transform_edt(free) > radius
    labels, _ = ndimage.label(wide, np.ones((3, 3)))
    entered = np.unique(labels[driven & wide])
    return np.asarray(free & _within(np.isin(labels, entered) & wide, radius + 1.0), dtype=np.bool_)
