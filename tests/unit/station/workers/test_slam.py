"""What the SLAM worker's backend is given, and when."""

from __future__ import annotations

import msgspec
import pytest

from shared.calibration import REFERENCE_ROBOT
from station.model.frames import ImageFrame
from station.model.slam_update import SlamUpdate
from station.workers.slam import NavigationSlam

MS = 1_000_000
assert REFERENCE_ROBOT.camera is not None


@pytest.mark.parametrize("shift_ms", [-42, 0, 13])
@pytest.mark.parametrize("line_delay_us", [0, 30])
def test_a_frame_comes_after_the_imu_of_its_middle_row(shift_ms: int, line_delay_us: int) -> None:
    """Without the last milliseconds a rolling-shutter camera's pose is extrapolated, 20 times a second."""
    camera = msgspec.structs.replace(
        REFERENCE_ROBOT.camera, time_shift_s=shift_ms * 1e-3, line_delay_s=line_delay_us * 1e-6
    )
    updates: list[SlamUpdate] = []
    slam = NavigationSlam(updates.append)
    calibration = msgspec.structs.replace(REFERENCE_ROBOT, camera=camera)
    slam.begin("tests.support.made_up_workers:WitnessSlam", calibration, 0)
    for ms in range(0, 600, 4):
        slam.add_imu([(1000 + ms) * MS], [(0.0, 0.0, 0.0)], [(0.0, 0.0, 9.8)])
        if ms % 50 == 0 and ms >= 100:
            slam.add_frame(ImageFrame(ms, (1000 + ms) * MS, 0, b""))
    assert len(updates) >= 5
    for update in updates:
        middle_row_ns = update.t_robot_ns + shift_ms * MS + round(239.5 * line_delay_us * 1000)
        assert middle_row_ns - 4 * MS < int(update.message) <= middle_row_ns
