"""What a finished navigation says of the told camera: the map, unless it knows less than the drive's windows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT
from station.model.calibration_fit import FITS, MISFITS, UNKNOWN, CalibrationFit, contradicted, judge
from station.model.navigation import NavigationReport
from station.motion.head import NUM_ERRORS
from station.slam.ukf import finish
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.map.pose_log import PoseLog
from station.vision.camera_model import CameraModel

REPORT = NavigationReport("ukf", 0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, "metric", True, 0, {}, {})


def fit(scale: float, sigma: float) -> CalibrationFit:
    return judge((scale, sigma), np.zeros(3), np.full(3, 0.2), (0.0, 0.001))


NOTHING_SURE, RIGHT, WRONG = fit(1.0, 0.02), fit(1.0, 0.001), fit(0.95, 0.002)
AT_ODDS = contradicted(NOTHING_SURE, 20, 60.0)


@pytest.mark.parametrize(
    ("by_windows", "by_map", "expected"),
    [
        (WRONG, NOTHING_SURE, WRONG),  # places of such a map are not known
        (AT_ODDS, NOTHING_SURE, AT_ODDS),
        (WRONG, RIGHT, RIGHT),
        (RIGHT, WRONG, WRONG),
        (None, RIGHT, RIGHT),
        (WRONG, None, WRONG),
        (None, None, None),
    ],
)
def test_a_map_that_knows_nothing_of_its_camera_does_not_silence_the_windows(
    by_windows: CalibrationFit | None,
    by_map: CalibrationFit | None,
    expected: CalibrationFit | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (NOTHING_SURE.verdict, RIGHT.verdict, WRONG.verdict) == (UNKNOWN, FITS, MISFITS) and AT_ODDS.is_contradicted
    made: Any = SimpleNamespace(
        calibration=REFERENCE_ROBOT, keyframes=(), landmarks=(), fit=by_map, facts={}, messages=[]
    )
    monkeypatch.setattr(finish, "_from_views", lambda *_: made)
    memory: Any = SimpleNamespace(calibration_check=SimpleNamespace(finish=lambda: by_windows), poses=PoseLog())
    camera = CameraModel.of(REFERENCE_CAMERA, 1.0)
    navigation = finish.make_navigation(
        "one", memory, camera, REFERENCE_ROBOT, np.zeros(NUM_ERRORS), UkfConfig(), REPORT, None
    )
    assert navigation.report.calibration_fit == expected
