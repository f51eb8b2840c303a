"""Laws of the table of observations."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.model.navigation import Landmarks


@given(keyframe=st.lists(st.integers(0, 6), max_size=40), beyond=st.integers(0, 3))
def test_every_observation_belongs_to_its_keyframe_once_and_in_order(keyframe: list[int], beyond: int) -> None:
    count = len(keyframe)
    landmarks = Landmarks(
        p_world=np.zeros((1, 3)),
        rgb=np.zeros((1, 3), dtype=np.uint8),
        cov_world=np.zeros((1, 3, 3)),
        observed_landmark=np.zeros(count, dtype=np.int64),
        observed_keyframe=np.array(keyframe, dtype=np.int64),
        observed_uv_px=np.zeros((count, 2)),
    )
    num_keyframes = max(keyframe, default=-1) + 1 + beyond
    rows = landmarks.observations_by_keyframe(num_keyframes)
    assert [seen.tolist() for seen in rows] == [
        [row for row in range(count) if keyframe[row] == k] for k in range(num_keyframes)
    ]
