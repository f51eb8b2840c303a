"""Furniture that was pushed between two drives: the later one is placed where it truly lies, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.files.navigation_folder import load_navigation
from station.places.joining.align import align_navigation
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig
from station.places.registration.result import Registration
from tests.support.days import made_up_days

pytestmark = pytest.mark.computing


def align_second_day(room: int, folder: Path) -> tuple[Registration, float]:
    """How the room's second drive is placed on its first, and by how much its landmarks are off then (median, m)."""
    first, second = made_up_days(room, folder)[:2]
    navigation = load_navigation(second.folder)
    found = align_navigation(build_map(load_navigation(first.folder)), navigation, PlacesConfig())
    assert found.T_target_source is not None
    placed = navigation.landmarks.p_world @ found.T_target_source[:3, :3].T + found.T_target_source[:3, 3]
    known = np.isfinite(second.p_true[:, 0])
    return found, float(np.median(np.linalg.norm(placed[known] - second.p_true[known], axis=1)))


def test_sides_that_disagree_are_no_reason_to_refuse_where_nothing_else_fits(tmp_path: Path) -> None:
    found, off_m = align_second_day(7, tmp_path)
    assert found.measured["sides apart"] > 1.0 and found.measured["beside"] < 0.5
    assert found.accepted, found.reasons
    assert off_m < 0.02


def test_an_answer_decimetres_beside_the_right_one_is_never_accepted(tmp_path: Path) -> None:
    found, off_m = align_second_day(6, tmp_path)
    assert off_m > 0.1 and not found.accepted  # one that is found right is no case for this test
    assert any("can slide" in reason for reason in found.reasons), found.reasons
