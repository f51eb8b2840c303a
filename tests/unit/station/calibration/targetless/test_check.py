"""What a check makes of the quantities that it found."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray
from station.calibration.targetless.check import check_calibration
from station.calibration.targetless.verdict import Quantity, too_vague
from station.commands.calibrate.check import lively
from station.datasets import open_dataset
from tests.support.paths import RECORDINGS

STATIC = RECORDINGS / "euroc_v1_01_static"


def quantity(key: str, away: FloatArray, sigma: float, excited: str = "") -> Quantity:
    return Quantity(key, key, "x", away, np.full(len(away), sigma), known_to=0.2, borne=0.5, excited=excited)


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


class Silent:
    def step(self, description: str, total: int | None = None) -> None: ...
    def advance(self) -> None: ...


@pytest.mark.skipif(not STATIC.exists(), reason="../shared/data/euroc_v1_01_static is not there")
def test_a_recording_at_rest_says_that_nothing_is_observable() -> None:
    data = open_dataset(STATIC)
    found = check_calibration(lively(data, data.calibration, STATIC), Silent())
    assert not found.is_accepted and found.fits is None
    assert "nothing is observable" in found.reasons[0]
