"""Which of a robot's pictures pages get."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from shared.messages import CameraFrame
from station.app import Station
from station.config import StationConfig

JPEG = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
HUGE = JPEG.replace(b"\x00\x30\x00\x40", b"\xff\xff\xff\xff", 1)  # 65,535 pixels wide and high, by its header
assert HUGE != JPEG


def frame(jpeg: bytes, width: int = 64) -> CameraFrame:
    return CameraFrame(seq=1, t_robot_ns=1, exposure_ns=0, width=width, height=48, skipped=0, jpeg=jpeg)


async def test_a_picture_of_the_announced_size_is_shown(tmp_path: Path) -> None:
    robot = Station(StationConfig(data_dir=tmp_path)).first
    robot.on_frame(frame(JPEG), 1)
    assert robot.camera.newest is not None and robot.camera.newest.frame.jpeg == JPEG


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (frame(JPEG, width=640), "is 64x48 pixels, announced were 640x48"),
        (frame(HUGE), "has 65535x65535 pixels, more than the"),
        (frame(b"<script>"), "is not a readable JPEG"),
    ],
)
async def test_a_picture_of_another_size_is_not_shown_and_said_once(
    tmp_path: Path, sent: CameraFrame, said: str
) -> None:
    station = Station(StationConfig(data_dir=tmp_path))
    for _ in range(50):
        station.first.on_frame(sent, 1)
    assert station.first.camera.newest is None
    lines = [line.text for line in station.first.events.log]
    assert len(lines) == 1 and f"the robot's picture {said}" in lines[0] and "not shown" in lines[0]
