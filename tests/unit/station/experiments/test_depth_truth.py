"""Walls of a plan beside the depth's own."""

from __future__ import annotations

import numpy as np
import pytest

from station.experiments.depth_truth import WallOffsets


def test_walls_that_depth_has_no_points_on_are_in_the_share_of_all_alone() -> None:
    offsets = WallOffsets(np.array([0.01, -0.02, 0.2, -0.3]), np.array([True, True, True, False]), 5)
    results = offsets.results()
    assert results["within_5_cm"] == pytest.approx(2 / 5)
    assert results["measured_m"] == pytest.approx(0.3)
    assert results["measured_within_5_cm"] == pytest.approx(2 / 3)


def test_without_a_wall_there_is_no_share() -> None:
    results = WallOffsets(np.empty(0), np.empty(0, dtype=np.bool_), 0).results()
    assert results["within_5_cm"] is None
    assert results["measured_within_5_cm"] is None
