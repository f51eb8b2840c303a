"""One robot of the station and everything that is its own: nothing in here is shared with another robot.

link → navigation being recorded, its SLAM; current place; pages. Plain methods, as in `app.py`; the event loop only
carries messages.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shared.calibration import Calibration
from shared.messages import CameraFrame, Capabilities, DriveApplied, ErrorNotice, Hello, Status
from shared.repetition import Repetition
from station.access.paired_robots import PairedRobots
from station.calibration.guidance import GuidedKind
from station.calibration.target import Target
from station.config import RobotConfig, StationConfig
from station.errors import Conflict, NoRobot, NotCapable, OutOfRange
from station.events import Broadcast, Events
from station.library.active_maps import ActiveMaps
from station.library.navigation_records import NavigationRecord
from station.library.navigations import Navigations
from station.model.calibration_fit import MISFITS, CalibrationFit, newer, why_misfit
from station.model.map_store import StoreAddress
from station.model.place_map import Grouping
from station.robots.ahead import AheadWatch
from station.robots.current_navigation import CurrentNavigation
from station.robots.current_place import CurrentPlace
from station.robots.driving import Driving
from station.robots.guided_calibration import CalibrationSession, GuidedCalibration
from station.robots.link import RobotLink
from station.robots.link_events import CheckedPictures, IgnoringListener
from station.robots.link_state import LinkState
from station.robots.navigation_files import NavigationRecorder
from station.workers.calibration_interface import PrintedBoard
from station.workers.place_interface import PlaceEvent, PlaceProgram
from station.workers.request import ProgramName
from station.workers.scheduling import ComputeSlots

MAX_STOP_LINES = 8
STOP_CONFIRMED_WITHIN_S = 0.15  # whoever pressed STOP hears within 0.2 s what became of it
MAX_WARNINGS = 20  # different ones of one robot in a minute
STATUS_HOLDS_NS = 2_000_000_000  # the robot tells it once a second; one that was lost must keep nobody from driving
HIJACK_NOTICE = "the simulated robot is picked up to be put down elsewhere"


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """A camera image and when it came."""

    frame: CameraFrame
    t_station_ns: int  # arrival
    t_captured_ns: int | None  # the capture in the station's clock; None before the clocks are known


@dataclass(frozen=True, slots=True)
class Shared:
    """What a session uses and does not own."""

    config: StationConfig
    store: StoreAddress  # of the maps
    active_maps: ActiveMaps
    navigations: Navigations
    paired: PairedRobots
    make_recorder: Callable[[Path], NavigationRecorder | None]
    place_program: ProgramName[PlaceProgram, PlaceEvent]  # what the localisation workers run
    slots: ComputeSlots  # of the localisation workers of all robots


class RobotSession(IgnoringListener):
    """One robot: what runs for it, and what a person can ask of it."""

    def __init__(self, robot: RobotConfig, events: Events, shared: Shared, path: str = "") -> None:
        """`path` is what stands before the station's calls to this robot; nothing before those to the first one."""
        config = shared.config
        self.name = robot.name
        self.path = path
        self.config = robot
        self.events = events
        self.active_maps = shared.active_maps
        self.camera: Broadcast[SeenFrame] = Broadcast()
        self._driver: str | None = None  # as was notified
        self._last_driver: str | None = None
        self._logged_stops: set[tuple[str, str]] = set()  # who and why, since it moved last
        self._warnings = Repetition(MAX_WARNINGS)
        self._hijacking = asyncio.Lock()
        self._calibrating = asyncio.Lock()
        self.applied: DriveApplied | None = None
        self._name = config.name
        self._status: tuple[Status, int] | None = None  # the newest of this connection, and when it came
        self.current_place = CurrentPlace(
            shared.store,
            config.localization,
            events,
            shared.place_program,
            on_report=lambda report: self.current_navigation.on_answer(report),
            slots=shared.slots,
            may_look=lambda: self._knows_camera,
        )
        self.current_navigation = CurrentNavigation(
            shared.navigations,
            config.slam,
            events,
            shared.make_recorder,
            on_pose=self.current_place.receive_pose,
            on_fit=self._receive_fit,
            recordings=config.recordings,
            robot=robot.name,
        )
        self.guided_calibration = GuidedCalibration(config.data_dir / "calibrations", events, shared.make_recorder)
        events.on_line = self.current_navigation.on_log
        self.ahead = AheadWatch(events)
        parts = (self.current_navigation, self.current_place, self.guided_calibration, self.ahead)
        listeners = CheckedPictures(self._refuse_picture, *parts, self)
        self._paired = shared.paired
        self.link = RobotLink(robot.host, robot.port, listeners, station_name=config.name, robots=shared.paired)
        self.link.on_refused = lambda reason: self._warn("link", f"no robot is connected: {reason}")
        self.link.commands.must_stand = lambda: self.must_stand != ""
        self.driving = Driving(
            self.link.commands,
            config.drive,
            self._capabilities,
            robot=lambda: self.link.state.robot,
            on_driver=self._notify_driver,
            on_silence=lambda text: events.notify("drive", text, "warning"),
            on_command=self.current_navigation.on_command,
            must_stand=lambda: self.must_stand,
            other_station=lambda: self.other_station,
            why_alone=lambda: self.link.state.reason,
        )

    async def run(self) -> None:
        """Run until cancelled. The link ends first, and with it the motors."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.driving.run(), name=f"drive timer of {self.name}")
            tasks.create_task(self.link.run(), name=f"link to {self.name}")
            tasks.create_task(self.current_place.run(), name=f"localisation of {self.name}")
            tasks.create_task(self.ahead.run(), name=f"what is ahead of {self.name}")
            tasks.create_task(self._every_second(), name=f"second of {self.name}")

    async def close(self) -> None:
        """Close the navigation being recorded, and end the workers."""
        closing = (self.current_navigation.close(), self.current_place.close(), self.guided_calibration.close())
        # One that fails must not keep the other open.
        for end in await asyncio.gather(*closing, return_exceptions=True):
            if isinstance(end, BaseException):
                raise end

    @property
    def state(self) -> LinkState:
        return self.link.state

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong, in sentences: in the robot as it says, and with the file that says which robots are paired.

        A robot that is connected stays so while that file is damaged, but is not met again after the connection ends.
        """
        status = self.link.state.status
        damage = (self._paired.damage,) if self._paired.damage else ()
        return (*damage, *(status.faults if status else ()))

    # What a person asks

    @property
    def head_must_rest(self) -> str:
        """Why the camera head must look straight ahead, in a sentence; empty when it may turn.

        The calibration tells where the camera is while it does; otherwise only one SLAM backend knows where it is.
        """
        if self.current_navigation.head_must_rest:
            return "a navigation is being recorded, and the camera must look straight ahead for it; stop that first"
        if self.guided_calibration.is_busy:
            return "the robot is being calibrated, and the camera must look straight ahead for it; finish that first"
        return ""

    @property
    def _knows_camera(self) -> bool:
        """Whether the calibration tells where the camera is: of one that looks aside, where its head's pivot is."""
        return self.driving.looks_ahead or self._knows_head

    @property
    def _knows_head(self) -> bool:
        hello = self.link.state.hello
        return hello is not None and hello.calibration.head is not None

    @property
    def looks_aside(self) -> str:
        """Why the place is not looked for just now, in a sentence; empty when it is.

        It would be looked for as from where the calibration has the camera, and the robot put where it is not.
        """
        if self.active_maps.first is None or self._knows_camera:
            return ""
        return "the camera looks aside; the place is looked for again when it looks straight ahead (pan 0, tilt 0)"

    @property
    def other_station(self) -> str | None:
        """The other station that drives the robot, as it said lately; it refuses our commands then."""
        if self._status is None:
            return None
        status, t_station_ns = self._status
        is_old = time.monotonic_ns() - t_station_ns > STATUS_HOLDS_NS
        is_ours = status.you_drive or status.driver == self._name  # by a connection of before
        return None if is_ours or is_old else status.driver

    @property
    def must_stand(self) -> str:
        """Why the robot may not move, in a sentence; empty when it may."""
        return self.guided_calibration.must_stand

    def point(self, driver: str, pan: float, tilt: float) -> None:
        """Point the camera head (rad). Raises as Driving.point, and Conflict while it must look straight ahead."""
        if (pan or tilt) and (reason := self.head_must_rest):
            raise Conflict(reason)
        self.driving.point(driver, pan, tilt)

    def stop(self, by: str, why: str | None = None) -> bool:
        """Motors off now, and a line on who said it and why; none for an empty `why`, which is letting go.

        Said again while nothing moves it is no news, and one rest has no more than MAX_STOP_LINES: a program that
        repeats, also one with ever other reasons, would leave the log no room for other lines. False when no robot is
        connected. What is no letting go is sent again over each new connection until the robot has confirmed it.
        """
        if self.driving.is_moving:
            self._logged_stops.clear()
        said = (by, why or "")
        is_news = said not in self._logged_stops and len(self._logged_stops) < MAX_STOP_LINES
        is_sent = self.driving.stop(by, until_confirmed=why != "")
        if is_news and (why or (why is None and is_sent)):
            self._logged_stops.add(said)
            self.events.notify("drive", f"{by} stopped: {why}" if why else f"{by} stopped the robot")
        return is_sent

    async def stop_is_confirmed(self) -> bool:
        """Whether the robot has confirmed the last stop within STOP_CONFIRMED_WITHIN_S; the log is told when not."""
        is_confirmed = await self.link.commands.stop_is_confirmed(STOP_CONFIRMED_WITHIN_S)
        if not is_confirmed:
            self._warn("link", "STOP was sent, and the robot has not confirmed it yet; it is sent again until it has")
        return is_confirmed

    async def hijack(self, spot: tuple[float, float, float] | None) -> None:
        """Put a simulated robot down at x m, y m, yaw rad of its world, or (None) wherever it likes.

        Raises NoRobot, NotCapable for a real one, OutOfRange or Conflict with the robot's own words.
        """
        able = self._capabilities()
        if able is None:
            raise NoRobot("no robot is connected")
        if not able.hijack:
            raise NotCapable("this robot cannot be moved by a message; only a simulated one can")
        async with self._hijacking:
            self.driving.stop()
            refusal = await self.link.commands.hijack(spot)
        if refusal is not None:
            raise (OutOfRange if refusal.code == "out_of_range" else Conflict)(refusal.message)
        self.events.notify("hijack", HIJACK_NOTICE, "warning")

    @property
    def why_calibration_fixed(self) -> str:
        """Why the robot takes no other calibration, in a sentence; empty when it does."""
        hello = self.link.state.hello
        if hello is None:
            return "no robot is connected"
        if hello.calibration_origin is None:
            return "this robot takes no calibration from a station; update sentinel-robot on it"
        return hello.calibration_origin.fixed

    async def use_calibration(self, make: Callable[[Hello], Calibration] | None) -> None:
        """Let the robot tell what `make` makes of its hello from now on, or (None) what it told before the present.

        `make` is called when earlier orders are through: an order is completed by what the robot tells then.

        Raises NoRobot, NotCapable for an older robot, Conflict while a navigation is recorded or with the robot's own
        words, OutOfRange where these say what is wrong with it.
        """
        async with self._calibrating:
            hello = self.link.state.hello
            if hello is None:
                raise NoRobot("no robot is connected")
            if hello.calibration_origin is None:
                raise NotCapable(self.why_calibration_fixed)
            if self.current_navigation.is_busy:
                raise Conflict("a navigation is being recorded with the present calibration; stop it first")
            if self.guided_calibration.is_busy:
                raise Conflict("the robot is being calibrated; finish that, or give it up")
            wanted = None if make is None else make(hello)
            refusal = await self.link.commands.use_calibration(wanted, hello.calibration)
        if refusal is not None:
            raise (OutOfRange if refusal.code == "out_of_range" else Conflict)(refusal.message)

    async def start_calibration(self, kind: GuidedKind, board: Target | PrintedBoard | None) -> CalibrationSession:
        """Look at a calibration board and record. The robot stands meanwhile, unless its wheels are measured.

        Raises NoRobot, NotCapable, Conflict, DataError.
        """
        state = self.link.state
        if not state.connected or state.hello is None:
            raise NoRobot("no robot is connected; there is nothing to calibrate")
        if self.current_navigation.is_busy:
            raise Conflict("a navigation is being recorded; stop it first")
        self._require_calibration_at_rest()
        if not self.driving.head_is_centred:
            raise Conflict("the camera looks aside; let it look straight ahead (pan 0, tilt 0) before you calibrate")
        self.driving.stop()
        return await self.guided_calibration.start(state.hello, kind, board)

    def _require_calibration_at_rest(self) -> None:
        if self._calibrating.locked():
            raise Conflict("another calibration is just being written; try again")

    async def start_navigation(self, name: str) -> NavigationRecord:
        """Record from now on. Raises NoRobot, NotCapable, Conflict, DataError."""
        state = self.link.state
        if not state.connected or state.hello is None:
            raise NoRobot("no robot is connected; there is nothing to record")
        if not state.hello.capabilities.camera:
            raise NotCapable("this robot has no camera; SLAM needs one")
        if self.guided_calibration.is_busy:
            raise Conflict("the robot is being calibrated; finish that, or give it up")
        self._require_calibration_at_rest()
        if not self.driving.head_is_centred:
            raise Conflict("the camera looks aside; let it look straight ahead (pan 0, tilt 0) before you record")
        return await self.current_navigation.start(state.hello, name)

    # What the station's maps mean for it

    async def look_in_active_maps(self) -> None:
        active = self.active_maps.all
        if active and not self._knows_head:
            self.driving.centre_head()
        self.events.changed("robot")
        await self.current_place.use_maps(tuple(one.place_map.id for one in active))

    def regroup(self) -> None:
        """Places or rooms of the active map are others, or have other names."""
        self.current_place.regroup(Grouping.of(self.active_maps.require_first().place_map))

    # What the link delivers, after navigation and place had it

    def on_connected(self, hello: Hello) -> None:
        self.events.notify("link", f"connected to {hello.name}")
        if self.link.commands.awaits_stop:
            self.events.notify("link", "the STOP that the robot had not confirmed was sent to it again", "warning")
        self.events.changed("robot")

    def on_calibration(self, hello: Hello) -> None:
        told = "" if hello.calibration_origin is None else f": {hello.calibration_origin.source}"
        self.events.notify("calibration", f"{hello.name} tells another calibration{told}")
        self.events.changed("calibration")
        self.events.changed("robot")

    def on_disconnected(self, reason: str) -> None:
        self._status = None
        self.events.notify("link", f"robot lost: {reason}", "warning")
        self.events.changed("robot")

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        captured = self.link.to_station_ns(frame.t_robot_ns)
        # The clocks of robot and station are known to a millisecond or so; no picture comes before it was taken.
        self.camera.put(SeenFrame(frame, t_station_ns, None if captured is None else min(captured, t_station_ns)))

    def on_gap(self, num_samples: int) -> None:
        self._warn("link", f"{num_samples} inertial samples were lost", "gap")

    def on_drive_applied(self, applied: DriveApplied) -> None:
        self.applied = applied

    def on_status(self, status: Status) -> None:
        self._status = (status, time.monotonic_ns())
        self.events.changed("robot")

    def on_notice(self, notice: ErrorNotice) -> None:
        if notice.fatal:
            self.events.notify("robot", notice.message, "error")
        else:
            self._warn("robot", notice.message)

    def _warn(self, topic: str, text: str, key: str = "") -> None:
        """A robot may say the same many times a second, or ever other things: the log keeps room for other lines."""
        if (line := self._warnings.news(text, key)) is not None:
            self.events.notify(topic, line, "warning")

    def _refuse_picture(self, why: str) -> None:
        self._warn("camera", f"the robot's picture {why}; it is neither shown, recorded nor computed with", "picture")

    def _receive_fit(self, hello: Hello, fit: CalibrationFit) -> None:
        """What SLAM says of the calibration in this hello; pages are told when it means something else than before."""
        before, now = self.current_place.calibration_fit, self.link.state.hello
        if now is None or now.calibration != hello.calibration or newer(before, fit) == before:
            return
        self.current_place.receive_fit(fit)
        if fit.verdict == MISFITS and not why_misfit(before):
            self.events.notify("calibration", fit.sentence, "warning")
        self.events.changed("robot")

    def _notify_driver(self, driver: str | None) -> None:
        """Who has the wheel, to the pages; a line where it is in other hands than before, not at every pause."""
        before, self._driver = self._driver, driver
        if driver is not None and driver != self._last_driver:
            self._last_driver = driver
            self.events.notify("drive", f"{driver} drives" if before is None else f"{driver} took over from {before}")
        self.events.changed("driver", driver)

    def _capabilities(self) -> Capabilities | None:
        state = self.link.state
        return state.hello.capabilities if state.connected and state.hello is not None else None

    async def _every_second(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            self.current_navigation.refresh()
            self.current_place.refresh(self.looks_aside)
            self.events.changed("robot")
