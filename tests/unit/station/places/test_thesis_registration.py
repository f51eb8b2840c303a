"""The thesis' registration by itself."""

import numpy as np
import pytest

from shared.geometry import se3, so3_exp, transform
from station.places.joining.thesis_registration import register_as_thesis
from station.places.making.config import ThesisConfig
from tests.support.synthetic_home import furnished_room


def test_a_cloud_lies_on_itself_and_the_library_has_nothing_to_warn_of(capfd: pytest.CaptureFixture[str]) -> None:
    p = np.concatenate([furnished_room(2, density=200).p, [[40.0, -30.0, 5.0]]])  # and a landmark gone astray
    found = register_as_thesis(p, p[:900] + 1e-6, ThesisConfig(), normalise=False)
    assert found.T_target_source is not None
    np.testing.assert_allclose(found.T_target_source, np.eye(4), atol=1e-3)
    assert found.rmse < 1e-5
    assert capfd.readouterr().err == ""


def test_a_small_motion_is_found_and_a_normalised_one_too() -> None:
    p = np.concatenate([furnished_room(3, density=200).p, [[800.0, -600.0, 5.0]]])  # and a landmark gone far astray
    T = se3(so3_exp(np.array([0.0, 0.0, 0.05])), np.array([0.05, -0.03, 0.0]))
    found = register_as_thesis(transform(T, p), p, ThesisConfig(), normalise=False)
    assert found.T_target_source is not None
    np.testing.assert_allclose(found.T_target_source, T, atol=5e-3)
    blown_up = register_as_thesis(transform(T, p), 3.0 * p, ThesisConfig(), normalise=True)
    assert blown_up.scale == pytest.approx(1 / 3, rel=1e-6)
    assert blown_up.T_target_source is not None
    np.testing.assert_allclose(transform(blown_up.T_target_source, 3.0 * p), transform(T, p), atol=0.03)
