"""What the station asks of a robot, as messages that are due to be sent."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

import msgspec

from shared.calibration import Calibration
from shared.calibration_yaml import calibration_digest
from shared.errors import LocalProtocolError
from shared.messages import (
    MAX_DRIVE_TTL_MS,
    AskDatagrams,
    CalibrationChanged,
    Capabilities,
    Drive,
    ErrorNotice,
    Heartbeat,
    Hijack,
    Join,
    PanTilt,
    Prove,
    Received,
    StationMessage,
    Stop,
    UndoCalibration,
    UseCalibration,
)
from station.errors import NoRobot

ANSWER_WITHIN_S = 2.0
WRITTEN_WITHIN_S = 10.0  # a file, onto a slow card
# Little is about to be sent at a time, and the most urgent first.
SENDING_ORDER: tuple[type[StationMessage], ...] = (
    Prove,
    Join,
    Stop,
    Hijack,
    Drive,
    PanTilt,
    Heartbeat,
    Received,
    AskDatagrams,
    UseCalibration,
    UndoCalibration,
)


class DueMessages:
    """Room for one message of each kind: the newest wins. One reader."""

    def __init__(self) -> None:
        self._due: dict[type[StationMessage], StationMessage] = {}
        self._fresh = asyncio.Event()

    def put(self, message: StationMessage) -> None:
        self._due[type(message)] = message
        self._fresh.set()

    def discard(self, kind: type[StationMessage]) -> None:
        self._due.pop(kind, None)

    def clear(self) -> None:
        self._due.clear()

    async def wait(self) -> None:
        """Until something was put since the last time."""
        await self._fresh.wait()
        self._fresh.clear()

    def pop(self) -> StationMessage | None:
        """The most urgent message; None when nothing is due."""
        kind = next((kind for kind in SENDING_ORDER if kind in self._due), None)
        return None if kind is None else self._due.pop(kind)


class LinkCommands:
    """Drive, stop, point, hijack; heartbeats share their count. All methods belong on the event loop."""

    def __init__(self, due: DueMessages, now_ns: Callable[[], int], late_ms: Callable[[], int] = lambda: 0) -> None:
        """`late_ms`: by how much a command may be late just now."""
        self.must_stand: Callable[[], bool] = lambda: False  # whether somebody handles the robot here
        self.on_command: Callable[[Drive | Stop], None] = lambda _: None  # who sends it by a second way
        self._late_ms = late_ms
        self._due = due
        self._now_ns = now_ns
        self._seq = 0  # of drive, stop and heartbeat
        self._is_connected = False
        self._able: Capabilities | None = None
        self._answer: asyncio.Future[ErrorNotice | None] | None = None  # somebody waits for what the robot says
        self._answer_seq = 0  # of the heartbeat behind the question
        self._stop_seq: int | None = None  # of a stop that the robot has not confirmed; 0: not sent either
        self._stop_is_confirmed = asyncio.Event()
        self._calibrated: asyncio.Future[ErrorNotice | None] | None = None  # somebody waits for another calibration
        self._wanted: Calibration | None = None  # that one; None: the one before

    def restart_count(self) -> None:
        """A connection was made; the robot counts anew for each."""
        self._seq = 0
        if self.awaits_stop:
            self._stop_seq = 0

    def open(self, able: Capabilities | None) -> None:
        """The robot let us in: from now on it hears commands, as far as it is able, a stop of before first."""
        self._is_connected, self._able = True, able
        if self.awaits_stop:
            self.stop(until_confirmed=True)

    def close(self) -> None:
        """There is no robot any more."""
        self._is_connected, self._able = False, None

    def drive(self, linear: float, angular: float, ttl_ms: int, most_ms: int = MAX_DRIVE_TTL_MS) -> bool:
        """Hold a velocity (m/s, rad/s) for `ttl_ms` (above the protocol's limit: the limit); newest wins.

        The time to live begins when a quick command would arrive. What a slow network takes of it is given on top, as
        far as `most_ms` and the protocol's limit allow, or the robot would stutter.

        Returns False, and sends nothing, when no robot is connected or it cannot drive.
        Raises LocalProtocolError when a number is not finite or out of the protocol's range.
        """
        ttl_ms = max(1, min(ttl_ms + self._late_ms(), most_ms, MAX_DRIVE_TTL_MS))
        try:
            command = Drive(
                seq=self._count(), t_station_ns=self._now_ns(), linear=linear, angular=angular, ttl_ms=ttl_ms
            )
        except ValueError as exc:
            raise LocalProtocolError(f"drive command refused: {exc}") from exc
        return self._put(command, self._able is not None and self._able.drive)

    def stop(self, *, until_confirmed: bool = False) -> bool:
        """Motors off now. False when no robot is connected (its own watchdog has stopped it by then).

        A connection may be dead and nobody know: with `until_confirmed` the stop is sent again over each new one until
        the robot has confirmed it. Meanwhile another station may drive it.
        """
        self._due.discard(Drive)
        seq = self._count() if self._is_connected else 0
        if until_confirmed:
            self._stop_seq = seq
            self._stop_is_confirmed.clear()
        if not self._is_connected:
            return False
        self._put(Stop(seq=seq))
        if until_confirmed:
            self.beat()  # the robot answers in order: its answer to what follows confirms the stop
        return True

    @property
    def awaits_stop(self) -> bool:
        """A stop is not confirmed yet."""
        return self._stop_seq is not None

    async def stop_is_confirmed(self, within_s: float) -> bool:
        """Whether the robot has done what the last stop that waits for it asked; waits for that so long at most."""
        if self.awaits_stop:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(within_s):
                    await self._stop_is_confirmed.wait()
        return not self.awaits_stop

    def forget_stop(self) -> None:
        """No stop waits any more: the robot has confirmed it, or is another one."""
        self._stop_seq = None
        self._stop_is_confirmed.set()

    def point(self, pan: float, tilt: float) -> bool:
        """Point the camera head (rad, positive left and up); newest wins. False when there is none."""
        try:
            command = PanTilt(pan=pan, tilt=tilt)
        except ValueError as exc:
            raise LocalProtocolError(f"pan-tilt command refused: {exc}") from exc
        return self._put(command, self._able is not None and self._able.pan_tilt)

    async def hijack(self, spot: tuple[float, float, float] | None) -> ErrorNotice | None:
        """Put a simulated robot down elsewhere: x m, y m, yaw rad, or None for a spot of its own choice.

        Returns why the robot refused, or None when it did as it was asked. Raises NoRobot when it said neither.
        """
        x, y, yaw = spot or (0.0, 0.0, 0.0)
        try:
            command = Hijack(x=x, y=y, yaw=yaw, anywhere=spot is None)
        except ValueError as exc:
            raise LocalProtocolError(f"hijack refused: {exc}") from exc
        if not self._put(command, self._able is not None and self._able.hijack):
            raise NoRobot("the robot is not connected just now; the link comes back by itself")
        # A robot speaks only to refuse, and in order: the answer to a heartbeat behind the question says it did not.
        self._answer = answer = asyncio.get_running_loop().create_future()
        self.beat()
        self._answer_seq = self._seq
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                return await answer
        except TimeoutError as exc:
            raise NoRobot("the robot did not answer; the link comes back by itself") from exc
        finally:
            if self._answer is answer:
                self._answer = None

    async def use_calibration(self, calibration: Calibration | None, present: Calibration) -> ErrorNotice | None:
        """Let the robot tell this calibration, or (None) the one before its present one; one question at a time.

        `present`: as it tells now. When another station changes that first, the robot refuses.
        Returns why the robot refused, or None when it tells it now. Raises NoRobot when it said neither.
        """
        digest = calibration_digest(present)
        question = (
            UndoCalibration(instead_of=digest)
            if calibration is None
            else UseCalibration(calibration=calibration, instead_of=digest)
        )
        if not self._put(question, self._is_connected):
            raise NoRobot("the robot is not connected just now; the link comes back by itself")
        self._calibrated = answer = asyncio.get_running_loop().create_future()
        self._wanted = calibration
        try:
            async with asyncio.timeout(WRITTEN_WITHIN_S):
                return await answer
        except TimeoutError as exc:
            raise NoRobot("the robot did not answer; GET /calibration says which calibration it tells") from exc
        finally:
            self._calibrated = None
            self._due.discard(type(question))  # nobody would hear what became of it

    def receive_calibration(self, changed: CalibrationChanged) -> None:
        """The robot tells another calibration now: perhaps the one that we asked for, perhaps another station's."""
        if not isinstance(is_ours := changed.is_answer, bool):  # an older robot, which does not say
            # By the words of its file: the robot tells what it reads there, without what no station changes.
            wanted = self._wanted or changed.calibration
            is_ours = calibration_digest(changed.calibration) == calibration_digest(wanted)
        if is_ours:
            _resolve(self._calibrated, None)

    def beat(self) -> None:
        must_stand = True if self.must_stand() else msgspec.UNSET
        self._put(Heartbeat(seq=self._count(), t_station_ns=self._now_ns(), must_stand=must_stand))

    def receive_beat(self, seq: int) -> None:
        """The robot answered this heartbeat, and refused nothing before it."""
        if seq >= self._answer_seq:
            _resolve(self._answer, None)
        if self._stop_seq and seq > self._stop_seq:
            self.forget_stop()

    def receive_notice(self, notice: ErrorNotice) -> None:
        if notice.about == "hijack":
            _resolve(self._answer, notice)
        elif notice.about == "calibration":
            _resolve(self._calibrated, notice)

    def _put(self, message: StationMessage, is_possible: bool = True) -> bool:
        if is_possible:
            self._due.put(message)
            if isinstance(message, Drive | Stop):
                self.on_command(message)
        return is_possible

    def _count(self) -> int:
        self._seq += 1
        return self._seq


def _resolve(answer: asyncio.Future[ErrorNotice | None] | None, refusal: ErrorNotice | None) -> None:
    if answer is not None and not answer.done():
        answer.set_result(refusal)
