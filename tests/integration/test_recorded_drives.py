"""Recorded drives end to end: SLAM maps a flat, another drive is localised in it, the tracker runs over it again."""

from __future__ import annotations

import numpy as np
import pytest

from station.model.best_camera import corrected
from station.places.localisation.localizer import Attempt
from tests.support.drives.judging import judge_drive, summarise
from tests.support.drives.misfit import Misfit
from tests.support.drives.playback import play_back
from tests.support.drives.recorded import LookedAt, RecordedDrive, SlamFit
from tests.support.drives.routes import MAPPED
from tests.support.drives.simulated import DriveOptions, make_drives
from tests.support.made_up_workers import focal_fit
from tests.support.places import SECOND, make_map, pose, seen

pytestmark = pytest.mark.computing


def test_a_drive_that_found_its_calibration_wrong_is_played_back_with_that() -> None:
    place_map = make_map()
    calibration = place_map.navigation.calibration
    looks = [LookedAt(s * SECOND, attempt_at(s), np.eye(4), 0.0, False) for s in range(1, 4)]
    events = (*looks[:2], SlamFit(2 * SECOND, focal_fit(0.95)), looks[2])
    played = play_back(place_map, RecordedDrive("drive", calibration, events, None, 3.0))
    assert [answer.state for _, answer in played.answers] == ["known", "known", "unknown"]


def attempt_at(t_s: float) -> Attempt:
    """Recognised at the second place."""
    found = seen(t_s, pose(2.8, 0.2))
    return Attempt(found, (found,), "found", 400, 100, 0.9)


@pytest.mark.slow
def test_a_drive_is_recorded_once_and_judged_as_often_as_wanted() -> None:
    options = DriveOptions(mapping_rate_hz=12.0, image_rate_hz=2.0, plans=(MAPPED,), max_seconds=30.0)
    world = make_drives("small", 3, Misfit(1.0, 3), options)
    assert world.place_map is not None and world.quality is not None
    assert abs(world.quality.scale - 1.0) < 0.06 and world.quality.error_m < 0.2
    report, camera = world.place_map.navigation.report, world.place_map.navigation.calibration.camera
    (drive,) = world.drives
    told = drive.calibration.camera
    assert told is not None and report.calibration_fit is not None and report.told_camera == told
    assert camera is not None and camera.fx == pytest.approx(
        corrected(told, report.calibration_fit).camera.fx, rel=1e-3
    )
    assert abs(camera.fx / told.fx - 1.0) > 0.003  # told 1 % wrong
    assert drive.hijack is not None and not drive.hijack.to_unmapped
    assert all(image.attempt.features is not None for image in drive.images)
    played = play_back(world.place_map, drive)
    judged = judge_drive(world.place_map, drive, played)
    summary = summarise([judged])
    assert summary.precision.count >= 0.9 * summary.precision.of > 0
    assert judged.noticed_s is not None and judged.noticed_s < 2.0
    again = play_back(world.place_map, drive)
    assert [a.state for _, a in again.answers] == [a.state for _, a in played.answers]
