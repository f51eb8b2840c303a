"""A point cloud as the page gets it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

NO_PLACE = 255


def pack_points(
    p: npt.NDArray[np.floating], rgb: npt.NDArray[np.uint8], place: npt.NDArray[np.uint8] | None = None
) -> bytes:
    """Points as 16 bytes each, little endian: x y z float32, r g b uint8, place uint8 (255: none)."""
    table = np.empty(len(p), dtype=[("p", "<f4", 3), ("rgb", "u1", 3), ("place", "u1")])
    table["p"], table["rgb"] = p, rgb
    table["place"] = NO_PLACE if place is None else place
    return table.tobytes()
