"""Landmarks that arrive while the robot drives."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.robots.live_slam import PointBuffer


@given(counts=st.lists(st.integers(0, 3000), max_size=6))
def test_point_buffer_keeps_all_points_in_order(counts: list[int]) -> None:
    buffer, total = PointBuffer(), 0
    for count in counts:
        p = np.arange(total, total + count, dtype=np.float32)[:, None].repeat(3, axis=1)
        buffer.add(p, np.full((count, 3), 7, np.uint8))
        total += count
    p, rgb = buffer.since(0)
    assert len(buffer) == total == len(p) and (p[:, 0] == np.arange(total)).all() and (rgb == 7).all()
    assert len(buffer.since(total)[0]) == 0
