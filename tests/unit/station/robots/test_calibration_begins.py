"""When a guided calibration begins, and what ends it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest

from shared.calibration import REFERENCE_ROBOT
from shared.messages import Capabilities, Hello
from station.errors import Conflict
from station.events import Events
from station.robots.guided_calibration import GuidedCalibration
from station.workers.calibration_interface import PrintedBoard

BOARD = PrintedBoard("aprilgrid", "A4")
ABLE = Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False)
HELLO = Hello(
    protocol=2, robot_id="robot", name="Robot", session_id="run", capabilities=ABLE, calibration=REFERENCE_ROBOT
)
NO_CAMERA = msgspec.structs.replace(REFERENCE_ROBOT, camera=None)


@pytest.mark.parametrize("other", [{"session_id": "other"}, {"calibration": NO_CAMERA}])
async def test_a_beginning_counts_as_busy_and_is_void_when_the_robot_changes(
    tmp_path: Path, other: dict[str, object]
) -> None:
    guided = GuidedCalibration(tmp_path, Events(), lambda _: None)
    beginning = asyncio.create_task(guided.start(HELLO, "camera", BOARD))
    await asyncio.sleep(0)
    assert guided.is_busy
    with pytest.raises(Conflict, match="is going on"):
        await guided.start(HELLO, "camera", BOARD)
    guided.on_connected(msgspec.structs.replace(HELLO, **other))
    with pytest.raises(Conflict, match="another one was connected"):
        await beginning
    assert not guided.is_busy and guided.session is None and not any(tmp_path.iterdir())
