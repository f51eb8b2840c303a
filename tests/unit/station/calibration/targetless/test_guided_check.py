"""The check at the end of a guided recording, in the fields that the page and *Use it* read."""

from __future__ import annotations

import pytest

from station.api.schema.calibration_session import CheckResult
from station.calibration.targetless.guided import estimate_check
from tests.support.paths import RECORDINGS

STATIC = RECORDINGS / "euroc_v1_01_static"


@pytest.mark.skipif(not STATIC.exists(), reason="../shared/data/euroc_v1_01_static is not there")
def test_a_recording_at_rest_is_refused_with_the_remedy() -> None:
    result = CheckResult.model_validate(estimate_check(STATIC, lambda _share, _text: None))
    assert not result.accepted and result.fits is None and result.repairs == []
    assert any("carry it by hand" in reason for reason in result.reasons)
