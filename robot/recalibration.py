"""Another calibration by a station's order: refused in a sentence, or written, and told to all stations."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping

import msgspec

from robot.commands import notice
from robot.own_calibration import OwnCalibration, summary
from robot.station_client import StationClient
from shared.calibration_yaml import calibration_digest
from shared.errors import RobotSystemError
from shared.messages import CalibrationChanged, Refusal, UndoCalibration, UseCalibration
from shared.session import Event

logger = logging.getLogger(__name__)


class Recalibration:
    """One order at a time, and none while the robot is driven: who drives counts on what the robot told."""

    def __init__(
        self, own: OwnCalibration, clients: Mapping[int, StationClient], is_driven: Callable[[], bool]
    ) -> None:
        """`clients`: all connections, by number, as they are at any time."""
        self.own = own
        self._clients = clients
        self._is_driven = is_driven
        self.tasks: asyncio.TaskGroup | None = None  # of the server, while it serves
        self.is_running = False

    def order(self, client: StationClient, message: UseCalibration | UndoCalibration) -> None:
        """Begin to carry it out; or say to the client why not."""
        reason = self._why_not() or self._why_outdated(message)
        if reason or self.tasks is None:
            client.put(notice("not_allowed", reason, about="calibration"))
            return
        self.is_running = True
        self.tasks.create_task(self._change(client, message))

    def _why_not(self) -> str:
        """In a sentence; empty: it may change now."""
        if self.is_running:
            return "another calibration is just being written; try again"
        if self._is_driven():
            return "the robot is being driven; let go, then change its calibration"
        if older := [c.station_name for c in self._clients.values() if c.is_joined and not c.knows_calibration_changed]:
            return (
                f"{', '.join(older)} runs an older release, which cannot be told of another calibration;"
                " disconnect it, or install the robot's release there"
            )
        return self.own.origin.fixed

    def _why_outdated(self, message: UseCalibration | UndoCalibration) -> str:
        """In a sentence; empty: it was made of what the robot tells now."""
        if message.instead_of in (msgspec.UNSET, calibration_digest(self.own.current)):
            return ""
        return "another station changed the robot's calibration meanwhile; look at it, then decide anew"

    async def _change(self, client: StationClient, message: UseCalibration | UndoCalibration) -> None:
        own = self.own
        try:
            if isinstance(message, UseCalibration):
                await asyncio.to_thread(own.use, message.calibration)
            else:
                await asyncio.to_thread(own.undo)
        except RobotSystemError as exc:
            client.put(notice("out_of_range", str(exc), about="calibration"))
            return
        finally:
            self.is_running = False
        logger.info("%s changed the calibration: %s", client.station_name, summary(own.current))
        changed = CalibrationChanged(calibration=own.current, origin=own.origin)
        for other in self._clients.values():
            if other.is_joined:
                other.put(msgspec.structs.replace(changed, is_answer=other is client))
            else:  # its hello told the one before
                other.end(Event.REFUSAL, Refusal(reason="the robot's calibration has just changed; connect again"))
