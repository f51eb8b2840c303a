"""The current place of a robot, or in a map, whose calibration does not fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from station.model.calibration_fit import CalibrationFit
from station.model.place_map import PlaceMap
from station.places.joining.merge import append_navigation
from station.places.tracking.tracker import PlaceTracker
from tests.support.made_up_workers import focal_fit, turned_fit
from tests.support.places import SECOND, make_map, pose, seen


def recognised_in(place_map: PlaceMap) -> PlaceTracker:
    """A tracker that knows the robot to be at the second place."""
    tracker = PlaceTracker([place_map], place_map.navigation.calibration)
    tracker.estimator.on_candidates([seen(1.0, pose(2.8, 0.2))])
    return tracker


def mapped_with(fit: CalibrationFit | None, is_corrected: bool = False) -> PlaceMap:
    """By a robot of which the drive said this; `is_corrected`: the map was made with the corrected camera."""
    place_map = make_map()
    navigation = place_map.navigation
    told = navigation.calibration.camera if is_corrected else None
    report = replace(navigation.report, calibration_fit=fit, told_camera=told)
    return replace(place_map, navigation=replace(navigation, report=report))


@pytest.mark.parametrize("fit", [None, focal_fit(1.004)])
def test_a_calibration_that_fits_or_that_nobody_asked_about_changes_nothing(fit: CalibrationFit | None) -> None:
    tracker = recognised_in(mapped_with(fit))
    tracker.on_calibration_fit(fit)
    assert tracker.answer(SECOND).state == "known"


@pytest.mark.parametrize("scale", [0.975, 1.025])
def test_a_place_is_known_with_a_focal_length_that_is_corrected(scale: float) -> None:
    tracker = recognised_in(mapped_with(focal_fit(scale), is_corrected=True))
    tracker.on_calibration_fit(focal_fit(scale))
    assert tracker.answer(SECOND).state == "known"


@pytest.mark.parametrize("fit", [focal_fit(0.95), focal_fit(0.97), focal_fit(1.031), focal_fit(1.053), turned_fit(3.0)])
def test_a_robot_whose_calibration_nobody_can_correct_does_not_know_its_place(fit: CalibrationFit) -> None:
    tracker = recognised_in(make_map())
    tracker.on_calibration_fit(fit)
    answer = tracker.answer(SECOND)
    assert answer.state == "unknown" and answer.place is None and answer.distance is None
    assert answer.alternatives[0].id == "map-1"  # where it would be
    assert answer.reason == fit.sentence
    assert answer.reason.startswith("the calibration does not fit")


def test_the_place_is_known_again_once_the_calibration_fits() -> None:
    tracker = recognised_in(make_map())
    tracker.on_calibration_fit(focal_fit(0.97))
    assert tracker.answer(SECOND).state == "unknown"
    tracker.on_calibration_fit(focal_fit(0.995))
    assert tracker.answer(SECOND).state == "known"


@pytest.mark.parametrize(("scale", "is_corrected"), [(0.975, False), (0.97, True)])
def test_no_place_is_known_in_a_map_that_was_made_with_a_wrong_focal_length(scale: float, is_corrected: bool) -> None:
    """Before maps were corrected, or by more than is corrected with certainty."""
    answer = recognised_in(mapped_with(focal_fit(scale), is_corrected)).answer(SECOND)
    assert answer.state == "unknown" and "navigation that the map was made from" in answer.reason


def test_a_merged_navigation_fits_only_if_both_do() -> None:
    fits, misfits = mapped_with(focal_fit(1.0)).navigation, mapped_with(focal_fit(0.97)).navigation
    unasked = mapped_with(None).navigation
    for first, second in ((fits, misfits), (misfits, fits), (unasked, misfits)):
        merged = append_navigation(first, second, pose(0.0, 0.0))
        assert merged.report.calibration_fit == misfits.report.calibration_fit
    assert append_navigation(unasked, fits, pose(0.0, 0.0)).report.calibration_fit == fits.report.calibration_fit
