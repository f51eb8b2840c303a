"""A robot on wheels stands on the floor, upright: an image that has it float is a look-alike's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import Calibration, Rig
from shared.geometry import se3, so3_exp
from station.model.place_map import PlaceMap
from station.places.tracking.floor import Floor
from station.places.tracking.image_evidence import ImageEvidence, MatchFigures
from station.places.tracking.map_view import MapView
from tests.support.places import CONFIG, make_map, pose, seen


def level_map(rig: Rig = "wheels", is_level: bool = True) -> PlaceMap:
    place_map = make_map()
    navigation = place_map.navigation
    calibration = msgspec.structs.replace(navigation.calibration, rig=rig)
    report = replace(navigation.report, gravity_aligned=is_level)
    return replace(place_map, navigation=replace(navigation, calibration=calibration, report=report))


def figures(place_map: PlaceMap, calibration: Calibration, **where: Any) -> MatchFigures:
    evidence = ImageEvidence([MapView.of(place_map)], calibration, CONFIG)
    T = pose(where.get("x", 0.0), 0.0) @ se3(so3_exp(np.array([where.get("roll", 0.0), 0, 0])), np.zeros(3))
    T[2, 3] = where.get("height", 0.0)
    return evidence.figures(evidence.measured(seen(0.0, T)))


@given(
    height=st.floats(-1.0, 1.0), roll=st.floats(-1.0, 1.0), sigma=st.floats(0.01, 0.3), sigma_rad=st.floats(0.01, 0.3)
)
def test_height_and_tilt_are_counted_in_their_standard_deviations(
    height: float, roll: float, sigma: float, sigma_rad: float
) -> None:
    floor = Floor.of(level_map().navigation)
    assert floor is not None
    T = pose(2.0, 0.0) @ se3(so3_exp(np.array([roll, 0.0, 0.0])), np.zeros(3))
    T[2, 3] = height
    expected = (height / sigma) ** 2 + (roll / sigma_rad) ** 2
    assert floor.off(T, sigma, sigma_rad) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_pose_above_the_floor_or_tilted_is_less_credible() -> None:
    place_map = level_map()
    standing, floating, tilted = (
        figures(place_map, place_map.navigation.calibration, **where) for where in ({}, {"height": 0.4}, {"roll": 0.3})
    )
    assert standing.off_floor == pytest.approx(0.0, abs=1e-6)
    assert floating.off_floor is not None and floating.off_floor > 20
    assert tilted.off_floor is not None and tilted.off_floor > 20


@pytest.mark.parametrize(("rig", "is_level"), [("hand-held", True), ("unknown", True), ("wheels", False)])
def test_the_floor_of_a_map_made_by_hand_or_at_a_slant_is_not_known(rig: Rig, is_level: bool) -> None:
    assert Floor.of(level_map(rig, is_level).navigation) is None


def test_how_a_carried_rig_or_another_robot_stands_on_the_floor_is_not_known() -> None:
    place_map = level_map()
    own = place_map.navigation.calibration
    assert own.camera is not None
    carried = msgspec.structs.replace(own, rig="hand-held")
    other = msgspec.structs.replace(own, camera=msgspec.structs.replace(own.camera, fx=510.0))
    for calibration in (carried, other):
        found = figures(place_map, calibration, height=0.4)
        assert found.off_floor is None
        assert found.or_usual(CONFIG.fitted.usual).off_floor == CONFIG.fitted.usual.off_floor


def test_free_space_is_where_the_map_knows_its_way() -> None:
    place_map = level_map()
    near, far = (figures(place_map, place_map.navigation.calibration, x=x) for x in (3.0, 40.0))
    assert near.is_free and not far.is_free
