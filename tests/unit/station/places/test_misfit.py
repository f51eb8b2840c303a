"""The current place of a robot, or in a map, whose calibration does not fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from station.model.best_camera import misfit_of
from station.model.calibration_fit import CalibrationFit
from station.model.place_answer import RoomCandidate
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
    assert answer.is_withheld  # so that nobody draws the position as that of a robot that is known
    assert answer.reason == fit.sentence
    assert answer.reason.startswith("the calibration does not fit")


def test_neither_is_its_room_while_its_place_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    bath, hall = RoomCandidate("room-1", "Bath", 0.9), RoomCandidate("room-2", "Hall", 0.2)
    tracker, fit = recognised_in(make_map()), focal_fit(0.97)
    nowhere = tracker.answer(SECOND)
    lost = replace(nowhere, state="lost", place=None, distance=None, room=bath, room_alternatives=(hall,), doorway="d")
    monkeypatch.setattr(tracker.estimator, "answer", lambda _: lost)
    assert tracker.answer(SECOND) is lost
    tracker.on_calibration_fit(fit)
    withheld = tracker.answer(SECOND)
    assert withheld.state == "lost" and withheld.reason == fit.sentence
    assert withheld.room is None and withheld.doorway is None
    assert withheld.room_alternatives == (bath, hall)
    two = replace(lost, room=None, room_alternatives=(bath, hall), one_of_two=(bath, hall), doorway=None)
    assert two.withheld("why").one_of_two == () and two.withheld("why").room_alternatives == (bath, hall)


def test_an_answer_that_is_sure_of_nothing_keeps_its_reason() -> None:
    tracker = PlaceTracker([make_map()], make_map().navigation.calibration)
    before = tracker.answer(SECOND)
    tracker.on_calibration_fit(focal_fit(0.97))
    after = tracker.answer(SECOND)
    assert after.reason == before.reason and before.state != "known"
    assert after.is_withheld and not before.is_withheld


def test_the_place_is_known_again_once_the_calibration_fits() -> None:
    tracker = recognised_in(make_map())
    tracker.on_calibration_fit(focal_fit(0.97))
    assert tracker.answer(SECOND).state == "unknown"
    tracker.on_calibration_fit(focal_fit(0.995))
    assert tracker.answer(SECOND).state == "known" and not tracker.answer(SECOND).is_withheld


@pytest.mark.parametrize(("scale", "is_corrected"), [(0.975, False), (0.97, True)])
def test_no_place_is_known_in_a_map_that_was_made_with_a_wrong_focal_length(scale: float, is_corrected: bool) -> None:
    """Before maps were corrected, or by more than is corrected with certainty."""
    answer = recognised_in(mapped_with(focal_fit(scale), is_corrected)).answer(SECOND)
    assert answer.state == "unknown" and "navigation that the map was made from" in answer.reason


def test_no_place_is_known_in_a_joined_map_unless_both_calibrations_fit() -> None:
    fits, misfits, unasked = (mapped_with(fit) for fit in (focal_fit(1.0), focal_fit(0.97), None))
    for first, second in ((fits, misfits), (misfits, fits), (unasked, misfits)):
        joined = append_navigation(first.navigation, second.navigation, pose(0.0, 0.0))
        joined = append_navigation(joined, fits.navigation, pose(0.0, 0.0))
        answer = recognised_in(replace(first, navigation=joined)).answer(SECOND)
        assert answer.state == "unknown" and "3.1% too long" in answer.reason
        assert "3.1% too long" in misfit_of(joined.report)
    joined = append_navigation(unasked.navigation, fits.navigation, pose(0.0, 0.0))
    assert recognised_in(replace(fits, navigation=joined)).answer(SECOND).state == "known"
    assert misfit_of(joined.report) == ""


def test_a_joined_map_keeps_the_fit_of_the_camera_that_it_is_kept_with() -> None:
    """Else images of the first robot would be looked for with its camera corrected by what the second's drive said."""
    first, second = (mapped_with(focal_fit(scale), is_corrected=True).navigation for scale in (1.0, 0.975))
    joined = append_navigation(first, second, pose(0.0, 0.0))
    assert joined.calibration == first.calibration and joined.report.told_camera == first.report.told_camera
    assert joined.report.calibration_fit == first.report.calibration_fit
    assert "2.6% too long" in joined.report.messages[-1] and joined.report.unsure == ""  # it was corrected by that
