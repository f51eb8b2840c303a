"""The current place of a robot, or in a map, whose calibration does not fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from station.model.calibration_fit import CalibrationFit
from station.model.place_map import PlaceMap
from station.places.joining.merge import append_navigation
from station.places.tracking.tracker import PlaceTracker
from tests.support.made_up_workers import focal_fit
from tests.support.places import SECOND, make_map, pose, seen


def recognised_in(place_map: PlaceMap) -> PlaceTracker:
    """A tracker that knows the robot to be at the second place."""
    tracker = PlaceTracker([place_map], place_map.navigation.calibration)
    tracker.estimator.on_candidates([seen(1.0, pose(2.8, 0.2))])
    return tracker


def mapped_with(fit: CalibrationFit | None) -> PlaceMap:
    place_map = make_map()
    navigation = place_map.navigation
    return replace(place_map, navigation=replace(navigation, report=replace(navigation.report, calibration_fit=fit)))


@pytest.mark.parametrize("fit", [None, focal_fit(1.004)])
def test_a_calibration_that_fits_or_that_nobody_asked_about_changes_nothing(fit: CalibrationFit | None) -> None:
    tracker = recognised_in(mapped_with(fit))
    tracker.on_calibration_fit(fit)
    assert tracker.answer(SECOND).state == "known"


@pytest.mark.parametrize("scale", [0.95, 0.97, 1.031, 1.053])
def test_a_robot_whose_calibration_does_not_fit_does_not_know_its_place(scale: float) -> None:
    tracker = recognised_in(make_map())
    tracker.on_calibration_fit(focal_fit(scale))
    answer = tracker.answer(SECOND)
    assert answer.state == "unknown" and answer.place is None and answer.distance is None
    assert answer.alternatives[0].id == "map-1"  # where it would be
    assert answer.reason.startswith("the calibration does not fit: the focal length seems")


def test_the_place_is_known_again_once_the_calibration_fits() -> None:
    tracker = recognised_in(make_map())
    tracker.on_calibration_fit(focal_fit(0.97))
    tracker.on_calibration_fit(focal_fit(0.995))
    assert tracker.answer(SECOND).state == "known"


def test_no_place_is_known_in_a_map_whose_navigation_had_a_calibration_that_does_not_fit() -> None:
    answer = recognised_in(mapped_with(focal_fit(0.97))).answer(SECOND)
    assert answer.state == "unknown" and "navigation that the map was made from" in answer.reason


def test_a_merged_navigation_fits_only_if_both_do() -> None:
    fits, misfits = mapped_with(focal_fit(1.0)).navigation, mapped_with(focal_fit(0.97)).navigation
    unasked = mapped_with(None).navigation
    for first, second in ((fits, misfits), (misfits, fits), (unasked, misfits)):
        merged = append_navigation(first, second, pose(0.0, 0.0))
        assert merged.report.calibration_fit == misfits.report.calibration_fit
    assert append_navigation(unasked, fits, pose(0.0, 0.0)).report.calibration_fit == fits.report.calibration_fit
