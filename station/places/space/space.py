"""Space: what a navigation saw to be free or taken, and which part of that its map knows.

A camera sees through free space up to the landmarks that it observes. So every keyframe carves a star of free cells
over the ground, and what several keyframes carved is free. A map knows the free space that its navigation's path
reaches without squeezing through what the path itself never passed: behind the door of a room that was only looked
into, it ends. No room hides in what is narrower than a passage between parts that are known, such as the gap between
two ways along which the camera looked ahead. Where nobody knows the map's scale, lengths follow how far its cameras
saw; where nobody measured gravity, the ground follows how its cameras were held (`making/scale.py`): the boundary turns
and scales with the map.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray
from station.model.navigation import Navigation
from station.places.making.scale import ground_rotation, units_per_metre
from station.places.space.carving import FARTHEST_M, SEEN_BY, Carving
from station.places.space.sight import sights

Cells = npt.NDArray[np.bool_]

CELL_M = 0.1
PASSAGE_M = 1.2  # what is narrower ends the map where the path did not go through: doors are up to 1.1 m wide
DRIVEN_M = 0.2  # this near the path space is free: the robot was there itself
GUESSED_PASSAGE_M = 1.4  # ... where the metre is a guess, which may be short by a cell or two of a door
AT_HAND_M = 0.4  # ... and known, also behind the cameras, unless it was seen to lie beyond a door
SEEN_UP_TO = 0.9  # a ray ends this share of the way to its point,
BEFORE_M = 0.2  # and this before it: sights end short of landmarks
STEPS = 30  # along a ray
CARRIED_AT_HAND_M = 1.0  # a rig in somebody's hands swings about, and never looked behind itself


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Columns over the ground, equally wide: `free[i, j]` from `low` on along x and y."""

    R_ground_map: FloatArray  # (3, 3) to axes whose z is up
    low: FloatArray  # (2,) map units, on the ground
    cell: float  # map units
    metre: float  # map units
    passage: float  # map units: the map ends at what is narrower
    free: Cells  # seen through, or driven through
    driven: Cells  # of it: by the robot's body
    at_hand: Cells  # of the path, and not seen to lie beyond a door
    known: Cells  # the part of it that belongs to the map, and what is at hand of the path
    seen: npt.NDArray[np.uint16]  # how many keyframes saw through each cell

    @classmethod
    def of(cls, navigation: Navigation, R_ground_map: FloatArray | None = None, cell_m: float = CELL_M) -> Space:
        """What this navigation saw; nothing without keyframes. `R_ground_map`: other axes on the ground."""
        R = ground_rotation(navigation) if R_ground_map is None else R_ground_map
        path = (_path(navigation) @ R.T)[:, :2]
        if not len(path):
            none = np.zeros((0, 0), dtype=np.bool_)
            return cls(R, np.zeros(2), 1.0, 1.0, PASSAGE_M, none, none, none, none, np.zeros((0, 0), np.uint16))
        metre = units_per_metre(navigation)
        carving = Carving.around(path, metre, cell_m)
        for sight in sights(navigation, R, FARTHEST_M * metre):
            carving.add(sight)
        passage = metre * (PASSAGE_M if navigation.is_metric else GUESSED_PASSAGE_M)
        return cls.carved(carving, R, path, metre, passage, has_wheels=navigation.calibration.has_wheels)

    @classmethod
    def carved(
        cls,
        carving: Carving,
        R_ground_map: FloatArray,
        path: FloatArray,
        metre: float,
        passage: float,
        *,
        has_wheels: bool,
    ) -> Space:
        """What was carved from sights along a path (n, 2) on the ground."""
        low, cell, seen = carving.low, carving.cell, carving.seen
        on_path = np.zeros(seen.shape, dtype=np.bool_)
        on_path[tuple(np.floor((path - low) / cell).astype(int).T)] = True
        driven = within(on_path, DRIVEN_M * metre / cell)
        free = (seen >= SEEN_BY) | driven
        at_hand_m = AT_HAND_M if has_wheels else CARRIED_AT_HAND_M
        at_hand = within(on_path, at_hand_m * metre / cell) & (seen < SEEN_BY)
        return cls(R_ground_map, low, cell, metre, passage, free, driven, at_hand, driven, seen).ending_at(())

    def ending_at(self, lines: Iterable[FloatArray]) -> Space:
        """The same where the map ends at these lines (2, 2) on the ground: doors that the path did not go through.

        Who stands on such a line is in the map still.
        """
        half_passage = 0.5 * self.passage / self.cell
        shut = np.zeros_like(self.free)
        for line in lines:
            shut |= cells_on(line, self.low, self.cell, self.free.shape)
        reached = reached_from(self.driven, self.free & ~shut, half_passage)
        known = reached | (shut & self.free) | self.driven | self.at_hand
        return replace(self, known=closed(known, half_passage))

    def knows(self, p_map: FloatArray) -> Cells:
        """(n,) whether positions (n, 3) lie where the map knows its way."""
        return self.among(self.known, p_map)

    def shows(self, eye_map: FloatArray, p_map: FloatArray) -> Cells:
        """(n,) whether points (n, 3) can be seen from an eye (3,), as far as free space tells: nothing else is between.

        Landmarks tell less: where a wall shows none, those behind it are not hidden by others.
        """
        d = p_map - eye_map
        far = np.linalg.norm(d, axis=1)
        until = np.clip(SEEN_UP_TO - BEFORE_M * self.metre / np.maximum(far, 1e-9), 0.0, None)
        on_the_way = eye_map + np.linspace(0.0, 1.0, STEPS)[:, None, None] * until[:, None] * d
        free = self.among(self.free, on_the_way.reshape(-1, 3)).reshape(STEPS, len(p_map))
        return np.asarray(free.all(axis=0), dtype=np.bool_)

    def among(self, cells: Cells, p_map: FloatArray) -> Cells:
        """(n,) whether positions (n, 3) lie in some of these cells."""
        index = np.floor(((p_map @ self.R_ground_map.T)[:, :2] - self.low) / self.cell).astype(np.int64)
        inside = np.all((index >= 0) & (index < cells.shape), axis=1)
        found = np.zeros(len(p_map), dtype=np.bool_)
        found[inside] = cells[tuple(index[inside].T)]
        return found


def _path(navigation: Navigation) -> FloatArray:
    """(n, 3) finite positions of the cameras and of the body."""
    p = np.concatenate([navigation.keyframes.T_world_cam[:, :3, 3], navigation.trajectory.T_world_body[:, :3, 3]])
    return np.asarray(p[np.isfinite(p).all(axis=1)])


def cells_on(line: FloatArray, low: FloatArray, cell: float, shape: tuple[int, ...]) -> Cells:
    """Cells that a line (2, 2) leads through or by, so close that nothing gets through between them."""
    x, y = (low[k] + (np.arange(shape[k]) + 0.5) * cell for k in range(2))
    return np.asarray(distance_to(line, np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)) <= cell)


def distance_to(line: FloatArray, p: FloatArray) -> FloatArray:
    """(...,) of points (..., 2) to a line that ends (2, 2)."""
    d = line[1] - line[0]
    along = np.clip((p - line[0]) @ d / max(float(d @ d), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - line[0] - along[..., None] * d, axis=-1))


def within(cells: Cells, distance: float) -> Cells:
    """Cells no farther than `distance` (cells) from some of these."""
    return np.asarray(ndimage.distance_transform_edt(~cells) <= distance, dtype=np.bool_)


def reached_from(entered: Cells, free: Cells, radius: float) -> Cells:
    """The free cells that a disc of this radius (cells) covers wherever it can roll to from some that were entered.

    Opening by reconstruction (Vincent, IEEE Trans. Image Processing 1993).
    """
    wide = ndimage.distance_transform_edt(free) > radius
    labels, _ = ndimage.label(wide, np.ones((3, 3)))
    parts = np.unique(labels[entered & wide])
    return np.asarray(free & within(np.isin(labels, parts) & wide, radius + 1.0), dtype=np.bool_)


def closed(cells: Cells, radius: float) -> Cells:
    """Those cells, and all others that no disc of this radius (cells) covers without touching one of them."""
    margin = int(radius) + 2  # the disc fits beside all of them
    outside = ndimage.distance_transform_edt(~np.pad(cells, margin)) > radius
    closed = ndimage.distance_transform_edt(~outside) > radius
    return np.asarray(cells | closed[margin:-margin, margin:-margin], dtype=np.bool_)
