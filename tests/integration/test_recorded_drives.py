"""Recorded drives end to end: SLAM maps a flat, another drive is localised in it, the tracker runs over it again."""

from __future__ import annotations

import pytest

from tests.support.drives.judging import judge_drive, summarise
from tests.support.drives.misfit import Misfit
from tests.support.drives.playback import play_back
from tests.support.drives.routes import MAPPED
from tests.support.drives.simulated import DriveOptions, make_drives


@pytest.mark.slow
def test_a_drive_is_recorded_once_and_judged_as_often_as_wanted() -> None:
    options = DriveOptions(mapping_rate_hz=12.0, image_rate_hz=2.0, plans=(MAPPED,), max_seconds=30.0)
    world = make_drives("small", 3, Misfit(1.0, 3), options)
    assert world.place_map is not None and world.quality is not None
    assert abs(world.quality.scale - 1.0) < 0.06 and world.quality.error_m < 0.2
    (drive,) = world.drives
    assert drive.hijack is not None and not drive.hijack.to_unmapped
    assert all(image.attempt.features is not None for image in drive.images)
    played = play_back(world.place_map, drive)
    judged = judge_drive(world.place_map, drive, played)
    summary = summarise([judged])
    assert summary.precision.count >= 0.9 * summary.precision.of > 0
    assert judged.noticed_s is not None and judged.noticed_s < 2.0
    again = play_back(world.place_map, drive)
    assert [a.state for _, a in again.answers] == [a.state for _, a in played.answers]
