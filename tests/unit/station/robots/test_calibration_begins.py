"""When a guided calibration begins, and what ends it."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import msgspec
import pytest

from shared.calibration import REFERENCE_ROBOT
from shared.messages import Capabilities, Hello
from station.errors import Conflict
from station.events import Events, LogLine
from station.model.place_answer import PlaceReport
from station.model.slam_update import SlamUpdate
from station.robots import guided_calibration
from station.robots.guided_calibration import GuidedCalibration
from station.robots.link_events import IgnoringListener
from station.workers.calibration_interface import PrintedBoard
from tests.support.link import until

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


class Recorder(IgnoringListener):
    """Writes nothing."""

    def __init__(self, error: str) -> None:
        self.error = error
        self.is_closed = False

    def on_slam(self, update: SlamUpdate) -> None: ...

    def on_answer(self, report: PlaceReport) -> None: ...

    def on_log(self, line: LogLine) -> None: ...

    def on_command(self, driver: str, linear: float, angular: float, ttl_ms: int) -> None: ...

    def close(self) -> None:
        self.is_closed = True


@pytest.mark.parametrize(
    ("error", "longest_s", "words"), [("the disk is full", 1800.0, "disk is full"), ("", 0.0, "nobody finished it")]
)
async def test_a_recording_that_fails_or_that_nobody_finishes_ends_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: str, longest_s: float, words: str
) -> None:
    monkeypatch.setattr(guided_calibration, "LONGEST_S", longest_s)
    recorder = Recorder(error)
    guided = GuidedCalibration(tmp_path, Events(), lambda _: recorder)
    session = await guided.start(HELLO, "camera", BOARD)
    await until(lambda: recorder.is_closed)
    ended = guided.get(session.id)
    assert ended.state == "failed" and words in ended.message and not guided.is_busy
    await guided.close()


async def test_of_old_recordings_the_newest_are_kept(tmp_path: Path) -> None:
    for day in range(1, 10):
        (tmp_path / f"cal-2020010{day}-120000").mkdir()
        os.utime(tmp_path / f"cal-2020010{day}-120000", (0, 0))
    guided = GuidedCalibration(tmp_path, Events(), lambda _: None)
    session = await guided.start(HELLO, "camera", BOARD)
    kept = sorted(folder.name for folder in tmp_path.iterdir())
    assert kept == [*(f"cal-2020010{day}-120000" for day in range(6, 10)), session.id]
    await guided.close()
