"""Points as the page gets them."""

from __future__ import annotations

import numpy as np

from station.model.points import pack_points


def test_points_are_packed_in_sixteen_bytes() -> None:
    packed = pack_points(np.array([[1.0, 2.0, 3.0]]), np.array([[4, 5, 6]], np.uint8), np.array([9], np.uint8))
    assert packed == np.array([1, 2, 3], "<f4").tobytes() + bytes([4, 5, 6, 9])
