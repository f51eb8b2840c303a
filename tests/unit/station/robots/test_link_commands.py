"""What goes to the robot first, and what is never sent."""

from __future__ import annotations

import asyncio

import msgspec
import pytest

from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.messages import (
    CalibrationChanged,
    CalibrationOrigin,
    Capabilities,
    Drive,
    Heartbeat,
    PanTilt,
    StationMessage,
    Stop,
    UndoCalibration,
    UseCalibration,
)
from station.errors import NoRobot
from station.robots import link_commands
from station.robots.link_commands import DueMessages, LinkCommands


def drive(seq: int) -> Drive:
    return Drive(seq=seq, t_station_ns=0, linear=0.1, angular=0.0, ttl_ms=200)


async def test_a_stop_goes_first_and_of_each_kind_only_the_newest() -> None:
    due = DueMessages()
    for message in (Heartbeat(seq=1, t_station_ns=0), drive(2), PanTilt(pan=0.0, tilt=0.0), drive(3), Stop(seq=4)):
        due.put(message)
    async with asyncio.timeout(60):
        await due.wait()
    sent = [due.pop() for _ in range(5)]
    assert [type(message) for message in sent] == [Stop, Drive, PanTilt, Heartbeat, type(None)]
    assert sent[1] == drive(3)


def test_what_is_discarded_is_not_sent() -> None:
    due = DueMessages()
    due.put(drive(1))
    due.discard(Drive)
    assert due.pop() is None


ABLE = Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False)


def connected() -> tuple[LinkCommands, DueMessages]:
    due = DueMessages()
    commands = LinkCommands(due, lambda: 0)
    commands.open(ABLE)
    return commands, due


def reconnect(commands: LinkCommands, due: DueMessages) -> list[type[StationMessage]]:
    """What is said first over the new connection."""
    commands.close()
    due.clear()
    commands.restart_count()
    commands.open(ABLE)
    return said(due)


def said(due: DueMessages) -> list[type[StationMessage]]:
    return [type(message) for message in iter(due.pop, None)]


async def test_a_stop_is_said_again_over_each_new_connection_until_it_is_confirmed() -> None:
    commands, due = connected()
    assert commands.stop(until_confirmed=True) and said(due) == [Stop, Heartbeat]
    for _ in range(2):
        commands.receive_beat(1)  # to a heartbeat of before
        assert not await commands.stop_is_confirmed(0.0)
        assert reconnect(commands, due) == [Stop, Heartbeat]
    commands.receive_beat(2)
    assert await commands.stop_is_confirmed(0.0)
    assert reconnect(commands, due) == []


async def test_a_stop_that_nobody_heard_waits_for_the_robot() -> None:
    commands, due = connected()
    commands.close()
    assert not commands.stop(until_confirmed=True)
    commands.receive_beat(9)
    assert reconnect(commands, due) == [Stop, Heartbeat]


async def test_the_stations_own_stop_and_one_for_another_robot_are_said_once() -> None:
    commands, due = connected()
    assert commands.stop() and said(due) == [Stop]
    assert reconnect(commands, due) == []
    commands.stop(until_confirmed=True)
    commands.forget_stop()
    assert await commands.stop_is_confirmed(60.0)
    assert reconnect(commands, due) == []


def with_focal_length(fx: float) -> Calibration:
    assert REFERENCE_ROBOT.camera is not None
    return msgspec.structs.replace(REFERENCE_ROBOT, camera=msgspec.structs.replace(REFERENCE_ROBOT.camera, fx=fx))


def changed(fx: float, is_answer: bool | msgspec.UnsetType) -> CalibrationChanged:
    origin = CalibrationOrigin(source="its calibration.yaml")
    return CalibrationChanged(calibration=with_focal_length(fx), origin=origin, is_answer=is_answer)


@pytest.mark.parametrize("wanted", [with_focal_length(1001.0), None], ids=["order", "undo"])
async def test_another_stations_change_is_no_answer_to_our_order(wanted: Calibration | None) -> None:
    commands, due = connected()
    asking = asyncio.create_task(commands.use_calibration(wanted, REFERENCE_ROBOT))
    await asyncio.sleep(0)
    assert said(due) == [UseCalibration if wanted else UndoCalibration]
    commands.receive_calibration(changed(1001.0, is_answer=False))  # even one that says the same
    await asyncio.sleep(0)
    assert not asking.done()
    commands.receive_calibration(changed(1001.0, is_answer=True))
    assert await asking is None


async def test_of_an_older_robot_the_same_numbers_are_the_answer() -> None:
    commands, _ = connected()
    asking = asyncio.create_task(commands.use_calibration(with_focal_length(1001.0), REFERENCE_ROBOT))
    await asyncio.sleep(0)
    commands.receive_calibration(changed(900.0, is_answer=msgspec.UNSET))
    await asyncio.sleep(0)
    assert not asking.done()
    commands.receive_calibration(changed(1001.0, is_answer=msgspec.UNSET))
    assert await asking is None


async def test_an_order_that_nobody_waits_for_any_more_is_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_commands, "WRITTEN_WITHIN_S", 0.0)
    commands, due = connected()
    with pytest.raises(NoRobot, match="did not answer"):
        await commands.use_calibration(with_focal_length(1001.0), REFERENCE_ROBOT)
    assert said(due) == []
