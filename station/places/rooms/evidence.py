"""What a navigation's cameras and body say of the ground: free, taken, or never seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray
from station.model.floor_plan import FREE, OCCUPIED, UNSEEN
from station.model.navigation import Navigation
from station.places.making.scale import units_per_metre
from station.places.rooms.lengths import FLOOR_PERCENT, SKIRTING_M, WALL_M
from station.places.space.observed import Observed
from station.places.space.space import Cells, Space

CELL_M = 0.5 * WALL_M
LINTEL_M = 2.0  # landmarks above stand in nobody's way
MIN_LANDMARKS = 3  # in a cell and its eight neighbours, so that single false ones stand nowhere
SEEN_THROUGH = 2.0  # times as often as its landmarks were observed: a cell over which one sees, or a false landmark
SPECK_M2 = 0.1  # what is less, all around seen to be free, is a table leg or a sector that no landmark filled


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Evidence on a grid whose cell [i, j] begins at `low` + (i, j) * `cell`."""

    R_ground_map: FloatArray  # (3, 3)
    low: FloatArray  # (2,)
    cell: float  # map units
    unit: float  # map units per metre
    free: Cells  # seen through or driven through, and nothing stands there
    space: Space  # on the same grid
    occupied: Cells
    visits: npt.NDArray[np.int64]  # (n, 2) cells of the body's path, in its order

    @property
    def state(self) -> npt.NDArray[np.uint8]:
        """(X, Y) as a plan has it."""
        return np.where(self.occupied, OCCUPIED, np.where(self.free, FREE, UNSEEN)).astype(np.uint8)

    def cells_of(self, p: FloatArray) -> npt.NDArray[np.int64]:
        """(n, 2) the cells of ground positions (n, 2), inside the grid or not."""
        return np.floor((p - self.low) / self.cell).astype(np.int64)


def gather_evidence(navigation: Navigation, R_ground_map: FloatArray) -> Ground:
    """Free space as `space` carves it, less the cells in which landmarks stand that nobody looked through."""
    unit = units_per_metre(navigation)
    space = Space.of(navigation, R_ground_map, CELL_M)
    seen = Observed.of(navigation)
    p = seen.p_map @ R_ground_map.T
    is_standing = _stands(p, unit)
    standing = p[is_standing, :2]
    observations = seen.num_observations[is_standing]
    centres = (navigation.keyframes.T_world_cam[:, :3, 3] @ R_ground_map.T)[:, :2]
    body = (navigation.trajectory.T_world_body[:, :3, 3] @ R_ground_map.T)[:, :2]
    body = body if len(body) else centres
    visits = np.floor((body[np.isfinite(body).all(axis=1)] - space.low) / space.cell).astype(np.int64)
    count, observed = np.zeros(space.free.shape), np.zeros(space.free.shape)
    index = np.floor((standing - space.low) / space.cell).astype(np.int64)
    inside = np.all((index >= 0) & (index < space.free.shape), axis=1)
    np.add.at(count, tuple(index[inside].T), 1)
    np.add.at(observed, tuple(index[inside].T), observations[inside])
    near = np.round(9 * ndimage.uniform_filter(count, 3, mode="constant"))
    is_dense = (count > 0) & (near >= MIN_LANDMARKS)
    occupied = is_dense & (SEEN_THROUGH * observed >= space.seen) & ~space.driven
    free = without_specks(space.free & ~occupied, SPECK_M2 * (unit / space.cell) ** 2)
    return Ground(
        R_ground_map=R_ground_map,
        low=space.low,
        cell=space.cell,
        unit=unit,
        free=free,
        space=space,
        occupied=occupied & ~free,
        visits=visits,
    )


def without_specks(free: Cells, most: float) -> Cells:
    """With the holes filled that have no more cells than that."""
    holes, count = ndimage.label(~free)
    if not count:
        return free
    size = np.bincount(holes.ravel(), minlength=count + 1)
    return np.asarray(free | ((holes > 0) & (size[holes] <= most)), dtype=np.bool_)


def _stands(p: FloatArray, unit: float) -> Cells:
    """(n,) which landmarks (n, 3) stand in the way of somebody on the floor."""
    finite: Cells = np.asarray(np.isfinite(p).all(axis=1), dtype=np.bool_)
    if not finite.any():
        return finite
    above = above_floor(p[:, 2]) / unit
    found = finite & (above > SKIRTING_M) & (above < LINTEL_M)
    return np.asarray(found, dtype=np.bool_)


def above_floor(z: FloatArray) -> FloatArray:
    """(n,) heights of landmarks at z (n,), in its unit; some finite."""
    return z - np.percentile(z[np.isfinite(z)], FLOOR_PERCENT)
