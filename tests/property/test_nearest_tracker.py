"""However points move from step to step, the tracked neighbours are those the tree would name."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from station.places.registration.cloud import prepare_cloud
from station.places.registration.nearest import NearestTracker


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    steps=st.lists(st.tuples(st.floats(0.0, 0.5), st.floats(0.05, 1.5)), min_size=1, max_size=6),
)
def test_tracked_neighbours_are_those_of_the_tree(seed: int, steps: list[tuple[float, float]]) -> None:
    rng = np.random.default_rng(seed)
    target = prepare_cloud(rng.uniform(0, 3, (200, 3)), rng)
    points = rng.uniform(-1, 4, (60, 3))
    tracker = NearestTracker(target, len(points))
    for size, reach in steps:
        points = points + size * rng.normal(size=3) + 0.1 * size * rng.normal(size=points.shape)
        index, near = tracker.find(points, reach)
        distance, expected = target.tree.query(points)
        assert np.array_equal(near, distance < reach)
        assert np.array_equal(index[near], expected[near])
