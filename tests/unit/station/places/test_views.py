"""Which views are new."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.places.making.scale import USUAL_VIEWING_M
from station.places.tracking.views import RecentViews
from tests.support.places import SECOND, pose

ANGLE = st.floats(-3.0, 3.0)


@given(yaws=st.lists(ANGLE, min_size=1, max_size=20), now=ANGLE)
def test_a_view_is_as_new_as_it_differs_from_the_most_similar_one(yaws: list[float], now: float) -> None:
    views = RecentViews(memory_s=15.0)
    for k, yaw in enumerate(yaws):
        views.add(k * SECOND // 4, pose(0.0, 0.0, yaw), is_failed=True)
    turns = [abs((now - yaw + np.pi) % (2 * np.pi) - np.pi) for yaw in yaws]
    assert views.change(len(yaws) * SECOND // 4, pose(0.0, 0.0, now)) == pytest.approx(min(turns), abs=1e-6)


def test_way_counts_by_how_far_things_usually_are() -> None:
    views = RecentViews(memory_s=15.0)
    views.add(0, pose(0.0, 0.0, 0.3), is_failed=False)
    assert views.change(SECOND, pose(0.1, 0.0, 0.3)) == pytest.approx(0.1 / USUAL_VIEWING_M)


def test_a_view_is_new_again_when_it_is_forgotten() -> None:
    views = RecentViews(memory_s=15.0)
    assert views.change(0, pose(0.0, 0.0)) == np.inf
    views.add(0, pose(0.0, 0.0), is_failed=True)
    views.add(10 * SECOND, pose(0.0, 0.0, 1.0), is_failed=True)
    assert views.change(14 * SECOND, pose(0.0, 0.0)) == 0.0
    assert views.change(16 * SECOND, pose(0.0, 0.0)) == pytest.approx(1.0)
    views.clear()
    assert views.change(16 * SECOND, pose(0.0, 0.0)) == np.inf


def test_where_it_was_recognised_a_view_is_new_once_another_was_looked_at() -> None:
    views = RecentViews(memory_s=15.0)
    views.add(0, pose(0.0, 0.0, 1.0), is_failed=True)
    views.add(SECOND, pose(0.0, 0.0), is_failed=False)
    assert views.change(2 * SECOND, pose(0.0, 0.0)) == 0.0  # nothing has moved since
    views.add(2 * SECOND, pose(0.0, 0.0, 0.6), is_failed=True)
    assert views.change(3 * SECOND, pose(0.0, 0.0)) == pytest.approx(0.6)
    assert views.change(3 * SECOND, pose(0.0, 0.0, 1.0)) == pytest.approx(0.0, abs=1e-6)
