"""Which of a robot's pictures pages, recordings, SLAM and localisation get."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from shared.messages import CameraFrame
from station.app import Station
from station.config import StationConfig
from station.recordings.playback import replay
from station.recordings.recorder import Recorder
from station.robots.session import RobotSession
from tests.support.recordings import HELLO

JPEG = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
HUGE = JPEG.replace(b"\x00\x30\x00\x40", b"\xff\xff\xff\xff", 1)  # 65,535 pixels wide and high, by its header
assert HUGE != JPEG


def frame(jpeg: bytes, width: int = 64) -> CameraFrame:
    return CameraFrame(seq=1, t_robot_ns=1, exposure_ns=0, width=width, height=48, skipped=0, jpeg=jpeg)


def deliver(robot: RobotSession, picture: CameraFrame) -> None:
    """As the link does when it has received it."""
    robot.link._receive(picture, 1)


async def test_a_picture_of_the_announced_size_is_shown(tmp_path: Path) -> None:
    robot = Station(StationConfig(data_dir=tmp_path)).first
    deliver(robot, frame(JPEG))
    assert robot.camera.newest is not None and robot.camera.newest.frame.jpeg == JPEG


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (frame(JPEG, width=640), "is 64x48 pixels, announced were 640x48"),
        (frame(HUGE), "has 65535x65535 pixels, more than the"),
        (frame(b"<script>"), "is not a readable JPEG"),
    ],
)
async def test_a_picture_of_another_size_is_neither_shown_nor_recorded_nor_used_and_said_once(
    tmp_path: Path, sent: CameraFrame, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    station = Station(StationConfig(data_dir=tmp_path))
    taken: list[CameraFrame] = []
    for part in (station.first.current_navigation, station.first.current_place, station.first.guided_calibration):
        monkeypatch.setattr(part, "on_frame", lambda picture, _: taken.append(picture))
    for _ in range(50):
        deliver(station.first, sent)
    assert station.first.camera.newest is None and taken == []
    lines = [line.text for line in station.first.events.log]
    assert len(lines) == 1 and f"the robot's picture {said}" in lines[0] and "neither shown, recorded" in lines[0]


async def test_a_replay_leaves_out_what_is_not_the_picture_that_was_announced(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    recorder = Recorder(tmp_path / "drive.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    for seq, jpeg in enumerate((JPEG, HUGE, b"<script>", JPEG), start=1):
        recorder.on_frame(replace(frame(jpeg), seq=seq, t_robot_ns=seq * 1_000_000), seq)
    recorder.close()
    shown = [picture.number async for picture in replay(tmp_path / "drive.mcap", speed=16)]
    assert set(shown) <= {0, 3} and 3 in shown
    assert [r.getMessage() for r in caplog.records if "not shown" in r.getMessage()] == [
        f"{tmp_path / 'drive.mcap'}: picture 1 has 65535x65535 pixels, more than the 67108864 that are decoded;"
        " such ones are not shown"
    ]
