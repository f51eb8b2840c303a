"""What is said of a calibration, by what a drive knows of it."""

from __future__ import annotations

import numpy as np
import pytest

from station.model.calibration_fit import (
    CalibrationFit,
    contradicted,
    judge,
    newer,
    why_doubtful,
    why_misfit,
    why_unsure,
)

KNOWN, UNKNOWN = 0.002, 0.01  # standard deviations of a focal length that is known, and is not


def fit_of(
    focal: float = 1.0, sigma: float = KNOWN, turned_deg: float = 0.0, turned_sigma_deg: float = 0.2,
    shift_s: float = 0.0, shift_sigma_s: float = 0.001,
) -> CalibrationFit:  # fmt: skip
    sigmas = np.array([turned_sigma_deg, 0.2, 0.2])
    return judge((focal, sigma), np.array([turned_deg, 0.0, 0.0]), sigmas, (shift_s, shift_sigma_s))


@pytest.mark.parametrize(
    ("fit", "seems"),
    [
        (fit_of(focal=0.95, sigma=UNKNOWN), "the focal length seems 5.3% too long, give or take 1.0%"),
        (fit_of(turned_deg=5.0, turned_sigma_deg=1.5), "the camera seems turned by 5.0 degrees, give or take 1.5"),
        (fit_of(shift_s=-0.04, shift_sigma_s=0.01), "images seem taken 40 ms earlier than told, give or take 10 ms"),
    ],
)
def test_a_large_error_that_is_ill_known_is_said_and_said_to_be_so(fit: CalibrationFit, seems: str) -> None:
    """It neither fits nor is a misfit: the first window of a right calibration has said 4.5 %."""
    assert fit.verdict == "not known yet"
    assert "not known yet" in fit.sentence and seems in fit.sentence and "drive on" in fit.sentence
    assert why_misfit(fit) == "" and why_doubtful(fit) == fit.sentence


def test_a_small_error_that_is_ill_known_is_no_doubt() -> None:
    fit = fit_of(focal=0.99, sigma=UNKNOWN)
    assert fit.verdict == "not known yet" and "seems" not in fit.sentence and why_doubtful(fit) == ""


def test_what_is_known_not_to_fit_is_said_without_what_is_not_known() -> None:
    fit = fit_of(focal=0.95, sigma=UNKNOWN, turned_deg=5.0)
    assert fit.verdict == "does not fit" and "5.0 degrees" in fit.sentence and "focal" not in fit.sentence
    assert why_doubtful(fit) == why_misfit(fit) == fit.sentence


def test_a_drive_that_has_just_begun_undoes_nothing_that_is_known() -> None:
    fits, misfits, begun = fit_of(), fit_of(focal=0.95), fit_of(focal=0.95, sigma=UNKNOWN)
    assert newer(None, begun) == begun
    assert newer(fits, begun) == fits and newer(misfits, begun) == misfits
    assert newer(begun, fits) == fits
    assert newer(fits, misfits) == misfits and newer(misfits, fits) == fits
    again = fit_of(sigma=UNKNOWN)
    assert newer(begun, again) == again


def test_image_and_imu_at_odds_again_and_again_is_a_misfit_whatever_the_numbers() -> None:
    ill_known = fit_of(focal=0.8, sigma=0.1)
    fit = contradicted(ill_known, 12, 69.0)
    assert fit.verdict == "does not fit" and fit.is_contradicted
    assert "contradicted each other 12 times in 69 s, the focal length seems 25.0% too long" in fit.sentence
    assert why_misfit(fit) == why_unsure(fit) == fit.sentence


@pytest.mark.parametrize(("times", "within_s"), [(0, 0.0), (1, 2.0), (3, 90.0), (10, 600.0)])
def test_a_few_contradictions_are_chance(times: int, within_s: float) -> None:
    fit = fit_of(sigma=UNKNOWN)
    assert contradicted(fit, times, within_s) == fit


def test_what_windows_know_is_not_overruled_by_contradictions() -> None:
    fits, misfits = fit_of(), fit_of(focal=0.95)
    assert contradicted(fits, 12, 69.0) == fits and contradicted(misfits, 12, 69.0) == misfits
