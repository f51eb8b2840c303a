"""Robots built otherwise than they say."""

from __future__ import annotations

import pytest

from robot.simulation.config import BuildErrors, SimulationConfig
from tests.support.drives.misfit import Misfit, wrong_percent


def test_without_a_misfit_the_robot_is_built_as_told() -> None:
    assert Misfit(seed=7).built(SimulationConfig()) == SimulationConfig()
    assert Misfit(seed=7).name == "exact" and wrong_percent("exact") == 0.0


@pytest.mark.parametrize(("seed", "sign"), [(4, 1), (5, -1)])
def test_two_per_cent_bring_a_degree_a_centimetre_and_five_milliseconds(seed: int, sign: int) -> None:
    misfit = Misfit(2.0, seed)
    config = misfit.built(SimulationConfig())
    errors: BuildErrors = config.build
    assert errors.focal_percent == 2.0 * sign and wrong_percent(misfit.name) == 2.0
    assert abs(errors.pitch_deg) == abs(errors.yaw_deg) == 1.0
    shift_cm = (errors.forward_cm**2 + errors.left_cm**2 + errors.up_cm**2) ** 0.5
    assert shift_cm == pytest.approx(1.0) and errors.time_shift_ms == 5.0
    assert config.body.linear_efficiency == pytest.approx(SimulationConfig().body.linear_efficiency * (1 - 0.02 * sign))
    assert Misfit(2.0, seed).built(SimulationConfig()) == config
