"""What a check makes of the quantities that it found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray
from station.calibration.targetless.check import CalibrationCheck, check_calibration
from station.calibration.targetless.verdict import Quantity, too_vague
from station.commands.calibrate.check import is_written, lively, summary
from station.datasets import open_dataset
from tests.support.paths import RECORDINGS

STATIC = RECORDINGS / "euroc_v1_01_static"


def quantity(key: str, away: FloatArray, sigma: float, excited: str = "") -> Quantity:
    return Quantity(key, key, (" x", 1.0), away, np.full(len(away), sigma), known_to=0.2, borne=0.5, excited=excited)


def test_a_difference_of_many_sigmas_that_is_small_needs_no_repair() -> None:
    assert quantity("rotation_deg", np.array([0.3, 0.0, 0.0]), 0.05).fits


def test_a_large_difference_that_chance_explains_is_not_called_wrong() -> None:
    assert quantity("rotation_deg", np.array([0.8, 0.0, 0.0]), 0.3).fits


def test_what_the_motion_does_not_excite_is_never_observable_however_small_its_sigma() -> None:
    assert not quantity("rotation_deg", np.array([50.0, 0.0, 0.0]), 0.001, "one axis only").is_observable


def test_nothing_is_written_where_something_is_surely_wrong_and_too_vague_to_repair() -> None:
    shift = quantity("time_shift_s", np.array([0.1]), 0.1)
    vague = quantity("rotation_deg", np.array([5.0, 0.0, 0.0]), 0.4)
    assert "surely off" in too_vague([vague, shift])[0]
    assert too_vague([quantity("rotation_deg", np.array([0.1, 0.0, 0.0]), 0.4), shift]) == []


def test_a_person_is_told_small_units_and_scripts_are_told_si() -> None:
    shift = Quantity(
        "time shift", "time_shift_s", (" ms", 1e3), np.array([8.9e-5]), np.array([1.4e-4]), 3.3e-4, 1e-3, ""
    )
    assert shift.sentence == "the time shift fits: found 0.089 ms ± 0.14 ms from what was told"
    away, sigma = np.array([-0.0045]), np.array([0.01])
    focal = Quantity("focal length", "focal_length", (" %", 100.0), away, sigma, 0.015, 0.02, "")
    assert "0.45 % ± 1.0 %" in focal.sentence and focal.away[0] == -0.0045


def test_what_several_quantities_are_not_seen_by_is_said_once() -> None:
    hidden = [quantity(key, np.zeros(3), 0.1, "it turned about one axis only") for key in ("rotation", "position")]
    found = checked(*hidden, RIGHT_SHIFT)
    said = summary(found, [], Path("found.yaml"))
    assert said.count("one axis only") == 1 and "the rotation and the position are not observable" in said


def test_an_estimate_that_is_not_believed_says_nothing_of_any_quantity() -> None:
    hidden = quantity("rotation_deg", np.zeros(3), 0.1, "it turned about one axis only")
    reason = "the estimate did not settle: it turned about one axis only"
    found = CalibrationCheck(REFERENCE_CAMERA, [reason], None, [hidden, RIGHT_SHIFT])
    said = summary(found, [], Path("found.yaml"))
    assert said.count("one axis only") == 1 and "observable" not in said and "fits" not in said


def test_neither_reason_repeats_what_the_notes_say() -> None:
    vague = [quantity(key, np.zeros(1), 0.4) for key in ("rotation_deg", "time_shift_s")]
    said = summary(checked(*vague), [], Path("found.yaml"))
    assert said.count("known to") == 2 and "neither rotation_deg nor time_shift_s" in said


def checked(*quantities: Quantity) -> CalibrationCheck:
    return CalibrationCheck(REFERENCE_CAMERA, too_vague(list(quantities)), None, list(quantities), is_believed=True)


RIGHT_ROTATION = quantity("rotation_deg", np.zeros(3), 0.1)
RIGHT_POSITION = quantity("translation_m", np.zeros(3), 0.1)
RIGHT_SHIFT = quantity("time_shift_s", np.zeros(1), 0.1)


def test_it_fits_where_all_that_is_asked_is_seen_to() -> None:
    found = checked(RIGHT_ROTATION, RIGHT_POSITION, RIGHT_SHIFT)
    assert found.fits is True and found.repairs == [] and is_written(found)
    assert "the calibration fits" in summary(found, [], Path("found.yaml"))


@pytest.mark.parametrize(
    "unseen",
    [
        quantity("rotation_deg", np.array([0.9, 0.0, 0.0]), 0.4),
        quantity("rotation_deg", np.array([5.0, 0.0, 0.0]), 0.1, "one axis only"),
    ],
)
def test_it_is_not_said_to_fit_where_the_motion_does_not_show_how_the_camera_sits(unseen: Quantity) -> None:
    found = checked(unseen, RIGHT_POSITION, RIGHT_SHIFT)
    assert found.is_accepted and found.fits is None and not is_written(found)
    said = summary(found, [], Path("found.yaml"))
    assert "does not show rotation_deg" in said and "the calibration fits" not in said and "not written" in said


def test_what_is_seen_to_be_wrong_is_repaired_though_the_rest_is_not_seen() -> None:
    wrong = quantity("time_shift_s", np.array([2.0]), 0.1)
    found = checked(quantity("rotation_deg", np.zeros(3), 0.1, "one axis only"), RIGHT_POSITION, wrong)
    assert found.fits is False and found.repairs == ["time_shift_s"] and is_written(found)


class Silent:
    def step(self, description: str, total: int | None = None) -> None: ...
    def advance(self) -> None: ...


@pytest.mark.skipif(not STATIC.exists(), reason="../shared/data/euroc_v1_01_static is not there")
def test_a_recording_at_rest_says_that_nothing_is_observable() -> None:
    data = open_dataset(STATIC)
    found = check_calibration(lively(data, data.calibration, STATIC), Silent())
    assert not found.is_accepted and found.fits is None
    assert "nothing is observable" in found.reasons[0]
