"""Who drives a robot through this station, what is refused, and what stops it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from shared.messages import MAX_DRIVE_TTL_MS, Capabilities, Drive
from station.config import DriveConfig
from station.errors import Conflict, NoRobot, NotDriver, OutOfRange
from station.robots import holds
from station.robots.driving import DriveLink, Driving
from station.robots.link_commands import DueMessages, LinkCommands
from station.robots.link_state import RobotIdentity

MS = 1_000_000
ABLE = Capabilities(camera=True, imu=True, drive=True, pan_tilt=True, battery=False, hijack=False)
ANNA, BERTA = RobotIdentity("anna", b"a"), RobotIdentity("berta", b"b")


def test_who_takes_over_has_time_for_the_first_command_and_keeps_the_wheel_by_commands() -> None:
    clock = [0]
    desk = driving(Link(), clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.take_over("ben")
    clock[0] = 4900 * MS
    assert desk.driver == "ben" and desk.lease_left_s == pytest.approx(1.1)
    for _ in range(10):  # once a second, as long as a command may hold
        desk.drive("ben", 0.1, 0.0, 1000)
        clock[0] += 1000 * MS
        with pytest.raises(NotDriver, match="ben drives"):
            desk.drive("anna", 0.1, 0.0, 200)
    clock[0] += 1000 * MS
    assert desk.driver is None
    desk.drive("anna", 0.1, 0.0, 200)
    assert desk.driver == "anna"


def test_taking_over_for_good_is_not_possible() -> None:
    clock = [0]
    desk = driving(Link(), clock)
    desk.take_over("ben")
    clock[0] = 6000 * MS
    assert desk.driver is None


class Link:
    """Keeps what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, float, int] | str] = []

    def drive(self, linear: float, angular: float, ttl_ms: int, most_ms: int = MAX_DRIVE_TTL_MS) -> bool:
        self.told.append((linear, angular, ttl_ms))
        return True

    def stop(self, *, until_confirmed: bool = False) -> bool:
        self.told.append("stop")
        return True

    def point(self, pan: float, tilt: float) -> bool:
        return True


def driving(link: Link, clock: list[int]) -> Driving:
    return desk_of(link, ABLE, now_ns=lambda: clock[0])


def desk_of(
    link: DriveLink,
    able: Capabilities | None,
    config: DriveConfig | None = None,
    robot: Callable[[], RobotIdentity | None] = lambda: ANNA,
    **options: Any,
) -> Driving:
    return Driving(link, config or DriveConfig(), lambda: able, robot, lambda _: None, lambda _: None, **options)


def test_a_take_over_stops_the_robot_and_the_same_driver_does_not() -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.take_over("anna")
    assert link.told == [(0.1, 0.0, 200)]
    desk.take_over("ben")
    assert link.told[-1] == "stop"
    with pytest.raises(NotDriver, match="ben drives"):
        desk.drive("anna", 0.1, 0.0, 200)


def test_a_stop_by_somebody_else_holds_until_the_driver_lets_go() -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("anna", 0.1, 0.0, 1000)
    clock[0] = 590 * MS  # a long command: she has been silent, but not since the stop
    desk.stop("ben")
    for _ in range(100):  # she holds on
        clock[0] += 30 * MS
        with pytest.raises(Conflict, match="let go of the joystick once"):
            desk.drive("anna", 0.1, 0.0, 200)
    assert link.told[-1] == "stop" and desk.driver == "anna" and not desk.is_moving
    clock[0] += 700 * MS
    desk.drive("anna", 0.1, 0.0, 200)
    assert link.told[-1] == (0.1, 0.0, 200)


def test_a_stop_holds_against_a_program_that_repeats_once_a_second() -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("program", 0.1, 0.0, 1000)
    desk.stop("ben")
    for _ in range(10):
        clock[0] += 1000 * MS
        with pytest.raises(Conflict, match="let go of the joystick once"):
            desk.drive("program", 0.1, 0.0, 1000)
    assert link.told == [(0.1, 0.0, MAX_DRIVE_TTL_MS), "stop"]
    clock[0] += 1500 * MS  # silent half a second after its last command would have ended
    desk.drive("program", 0.1, 0.0, 1000)
    assert len(link.told) == 3


def test_a_recorder_that_fails_does_not_keep_the_robot_from_stopping() -> None:
    def fail(*_: object) -> None:
        raise OSError("disk full")

    link = Link()
    desk = desk_of(link, None, on_command=fail)
    with pytest.raises(OSError, match="disk full"):
        desk.stop("anna")
    assert link.told == ["stop"]


@pytest.mark.parametrize("lets_go", ["zero", "stop", "release"])
def test_zero_stop_and_release_are_letting_go(lets_go: str) -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.stop(None)
    with pytest.raises(Conflict):
        desk.drive("anna", 0.1, 0.0, 200)
    {"zero": lambda: desk.drive("anna", 0.0, 0.0, 200), "stop": lambda: desk.stop("anna")}.get(
        lets_go, lambda: desk.release("anna")
    )()
    desk.drive("anna", 0.1, 0.0, 200)
    assert link.told[-1] == (0.1, 0.0, 200)


def test_a_drivers_own_stop_holds_nobody() -> None:
    link = Link()
    desk = driving(link, [0])
    desk.drive("anna", 0.1, 0.0, 200)
    desk.stop("anna")
    desk.drive("anna", 0.1, 0.0, 200)
    desk.take_over("ben")
    desk.drive("ben", 0.2, 0.0, 200)
    assert link.told == [(0.1, 0.0, 200), "stop", (0.1, 0.0, 200), "stop", (0.2, 0.0, 200)]


@pytest.mark.parametrize(
    ("linear", "angular", "ttl_ms"),
    [(0.6, 0, 200), (0, 2.5, 200), (float("nan"), 0, 200), (0, float("inf"), 200), (0, 0, 0), (0, 0, 1001)],
)
def test_commands_out_of_range_are_refused_and_do_not_take_the_wheel(
    linear: float, angular: float, ttl_ms: int
) -> None:
    link = Link()
    desk = driving(link, [0])
    with pytest.raises(OutOfRange):
        desk.drive("anna", linear, angular, ttl_ms)
    assert desk.driver is None and link.told == []


async def test_a_robot_that_must_stand_refuses_to_move_with_the_reason_and_may_be_stopped() -> None:
    link, reasons = Link(), ["a board is held before it"]
    desk = desk_of(link, ABLE, must_stand=lambda: reasons[-1])
    with pytest.raises(Conflict, match="a board is held before it"):
        desk.drive("page", 0.1, 0.0, 200)
    assert link.told == []
    desk.drive("page", 0.0, 0.0, 200)
    assert desk.stop("page") and link.told == [(0.0, 0.0, 200), "stop"]
    reasons.append("")
    desk.drive("page", 0.1, 0.0, 200)
    assert link.told[-1] == (0.1, 0.0, 200)


@pytest.mark.parametrize("age_ms", [0, 120])
def test_on_a_late_network_no_repetition_lets_the_robot_move_longer_than_the_driver_said(age_ms: int) -> None:
    clock = [0]
    commands = LinkCommands(DueMessages(), lambda: clock[0], late_ms=lambda: 200)
    able = Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False)
    commands.open(able)
    sent: list[Drive] = []
    commands.on_command = lambda message: sent.append(message) if isinstance(message, Drive) else None
    config = DriveConfig(repeat_ms=20)
    desk = desk_of(commands, able, config, now_ns=lambda: clock[0])

    async def drive_and_fall_silent() -> None:
        desk.drive("anna", 0.1, 0.0, MAX_DRIVE_TTL_MS - age_ms, age_ms)
        timer = asyncio.create_task(desk.run())
        while desk.is_moving:
            clock[0] += 5 * MS
            await asyncio.sleep(0.01)
        timer.cancel()

    asyncio.run(drive_and_fall_silent())
    ends_ns = [drive.t_station_ns + drive.ttl_ms * MS for drive in sent]
    said_ns = sent[0].t_station_ns - age_ms * MS
    assert len(sent) > 1
    assert max(ends_ns) <= said_ns + (MAX_DRIVE_TTL_MS + 1) * MS  # rounded up to whole milliseconds


async def test_a_stop_holds_through_a_standstill_of_the_station() -> None:
    """Its loop stood still for 0.8 s while the joystick was held; what was said then is read at once."""
    link, clock = Link(), [0]
    desk = driving(link, clock)
    timer = asyncio.create_task(desk.run())
    await asyncio.sleep(0.01)  # it has looked once
    desk.drive("anna", 0.1, 0.0, 200)
    desk.stop("ben")
    clock[0] = 800 * MS
    with pytest.raises(Conflict, match="let go"):
        desk.drive("anna", 0.1, 0.0, 200)
    timer.cancel()
    await asyncio.gather(timer, return_exceptions=True)


def test_a_stop_holds_while_commands_come_too_late() -> None:
    clock = [0]
    desk = driving(Link(), clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.stop("ben")
    clock[0] = 600 * MS
    desk.note_late("anna")
    clock[0] = 800 * MS
    with pytest.raises(Conflict, match="let go"):
        desk.drive("anna", 0.1, 0.0, 200)


def test_who_cannot_drive_hears_why_no_robot_is_connected() -> None:
    why = "10.77.0.12:7400 is Anna's, and Berta is there"
    desk = desk_of(Link(), None, why_alone=lambda: why)
    with pytest.raises(NoRobot, match=f"no robot is connected: {why}"):
        desk.drive("anna", 0.1, 0.0, 200)


class Fleet:
    """A desk whose robot a test exchanges."""

    def __init__(self) -> None:
        self.link, self.clock = Link(), [0]
        self.robot: RobotIdentity | None = ANNA
        self.able: Capabilities | None = ABLE
        self.desk = Driving(
            self.link,
            DriveConfig(),
            lambda: self.able,
            lambda: self.robot,
            lambda _: None,
            lambda _: None,
            now_ns=lambda: self.clock[0],
        )

    def wait(self, ms: int) -> None:
        self.clock[0] += ms * MS

    def hold(self, driver: str, ms: int, refused_with: str = "") -> None:
        """Hold the joystick; each of its commands is accepted or, with words, refused."""
        for _ in range(0, ms, 50):
            self.wait(50)
            if not refused_with:
                self.desk.drive(driver, 0.1, 0.0, 200)
                continue
            with pytest.raises((Conflict, NoRobot), match=refused_with):
                self.desk.drive(driver, 0.1, 0.0, 200)


@pytest.mark.parametrize(
    "other", [BERTA, RobotIdentity("berta", b"a"), RobotIdentity("anna", b"b"), RobotIdentity("anna", b"")]
)
@pytest.mark.parametrize("away_ms", [0, 5000])
def test_who_holds_on_while_another_robot_takes_the_place_of_the_first_moves_it_only_after_letting_go(
    other: RobotIdentity, away_ms: int
) -> None:
    fleet = Fleet()
    fleet.hold("joe", 500)
    fleet.able = None
    fleet.hold("joe", away_ms, "no robot is connected")
    fleet.robot, fleet.able = other, ABLE
    fleet.link.told.clear()
    fleet.hold("joe", 5000, "another robot than the one you drove is connected; let go of the joystick once")
    assert not fleet.link.told and fleet.desk.driver is None
    fleet.desk.drive("joe", 0.0, 0.0, 200)
    fleet.hold("joe", 100)
    assert fleet.link.told[-1] == (0.1, 0.0, 200)


@pytest.mark.parametrize("lets_go", [Driving.stop, Driving.release])
def test_stop_and_release_are_letting_go_for_another_robot_too(lets_go: Callable[[Driving, str], object]) -> None:
    fleet = Fleet()
    fleet.hold("joe", 500)
    fleet.robot = BERTA
    fleet.hold("joe", 1500, "let go of the joystick once")  # the wheel is free by then
    lets_go(fleet.desk, "joe")
    fleet.hold("joe", 100)


def test_drivers_of_ever_other_names_take_no_more_room_than_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(holds, "MAX_HOLDS", 3)
    heard = holds.Holds()
    for n in range(5):
        heard.hear(f"driver {n}", ANNA, 0)
    assert [heard.hear(f"driver {n}", BERTA, 0) for n in (4, 3, 2)] == [False] * 3
    assert heard.hear("driver 1", BERTA, 0)


def test_the_same_robot_goes_on_after_it_was_away() -> None:
    fleet = Fleet()
    fleet.hold("joe", 500)
    fleet.able = None
    fleet.hold("joe", 5000, "no robot is connected")
    fleet.able = ABLE
    fleet.hold("joe", 100)


def test_another_drivers_letting_go_frees_nobody_to_drive_another_robot() -> None:
    fleet = Fleet()
    fleet.hold("joe", 500)
    fleet.robot = BERTA
    fleet.hold("joe", 1500, "let go of the joystick once")  # the wheel is free by then
    for _ in range(40):
        fleet.desk.drive("anna", 0.0, 0.0, 200)  # takes and gives back the wheel
        fleet.desk.release("anna")
        fleet.hold("joe", 100, "let go of the joystick once")
    fleet.hold("anna", 100)


def test_a_hold_that_begins_while_no_robot_is_connected_means_the_one_that_was() -> None:
    fleet = Fleet()
    fleet.able = None
    fleet.hold("joe", 500, "no robot is connected")
    fleet.robot, fleet.able = BERTA, ABLE
    fleet.hold("joe", 500, "let go of the joystick once")
    fleet.wait(700)
    fleet.hold("joe", 100)


def test_before_any_robot_was_there_a_hold_means_the_first_one_that_comes() -> None:
    fleet = Fleet()
    fleet.robot = fleet.able = None
    fleet.hold("joe", 500, "no robot is connected")
    fleet.robot, fleet.able = ANNA, ABLE
    fleet.hold("joe", 500)
    fleet.robot = BERTA
    fleet.hold("joe", 500, "let go of the joystick once")


def test_a_program_that_repeats_once_a_second_holds_on_and_so_do_commands_that_come_too_late() -> None:
    fleet = Fleet()
    fleet.desk.drive("program", 0.1, 0.0, 1000)
    fleet.hold("joe's page", 50, "program drives")
    fleet.robot = BERTA
    for _ in range(5):
        for _ in range(5):
            fleet.wait(200)
            fleet.desk.note_late("joe's page")
        for driver, ttl_ms in (("program", 1000), ("joe's page", 200)):
            with pytest.raises(Conflict, match="let go of the joystick once"):
                fleet.desk.drive(driver, 0.1, 0.0, ttl_ms)
    fleet.wait(1500)
    fleet.desk.drive("program", 0.1, 0.0, 1000)


async def test_a_hold_lasts_through_a_standstill_of_the_station_also_for_another_robot() -> None:
    fleet = Fleet()
    timer = asyncio.create_task(fleet.desk.run())
    await asyncio.sleep(0.01)  # it has looked once
    fleet.hold("joe", 100)
    fleet.robot = BERTA
    fleet.wait(3000)
    with pytest.raises(Conflict, match="let go of the joystick once"):
        fleet.desk.drive("joe", 0.1, 0.0, 200)
    timer.cancel()
    await asyncio.gather(timer, return_exceptions=True)


async def test_a_long_command_is_repeated_to_no_other_robot() -> None:
    fleet = Fleet()
    fleet.desk.drive("program", 0.1, 0.0, 1000)
    fleet.robot = BERTA
    timer = asyncio.create_task(fleet.desk.run())
    while fleet.desk.is_moving:
        fleet.wait(150)
        await asyncio.sleep(0.005)
    assert fleet.link.told == [(0.1, 0.0, MAX_DRIVE_TTL_MS)]
    timer.cancel()
    await asyncio.gather(timer, return_exceptions=True)


def test_a_camera_head_that_is_being_turned_is_no_other_robots() -> None:
    fleet = Fleet()
    fleet.desk.point("joe", 0.1, 0.0)
    fleet.robot = BERTA
    with pytest.raises(Conflict, match="another robot"):
        fleet.desk.point("joe", 0.2, 0.0)
    fleet.wait(600)
    fleet.desk.point("joe", 0.2, 0.0)
