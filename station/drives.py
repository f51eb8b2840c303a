"""The drives of all robots: listed, deleted and brought back, and which of them somebody works on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from shared.errors import DataError
from station.drive_library import DriveLibrary, DriveRecord
from station.events import Teller
from station.maps.editing import tidy_name
from station.navigation import NavigationReport
from station.refusals import Conflict


class Drives:
    """What is on disk, and the counts of the drives that are being recorded."""

    def __init__(self, library: DriveLibrary, events: Teller) -> None:
        self.library = library
        self._events = events
        self._running: dict[str, Callable[[], DriveRecord]] = {}  # drive → its record of now
        self._reserved: set[str] = set()

    def list(self) -> list[DriveRecord]:
        """All drives, oldest first; running ones with their counts of now."""
        return [self.get(drive.id) for drive in self.library.list()]

    def get(self, drive_id: str) -> DriveRecord:
        """Raises Unknown."""
        counted = self._running.get(drive_id)
        return self.library.get(drive_id) if counted is None else counted()

    def begin(self, drive_id: str, counted: Callable[[], DriveRecord]) -> None:
        """A drive is being recorded until `end`; `counted` gives its record."""
        self._running[drive_id] = counted

    def end(self, drive_id: str) -> None:
        self._running.pop(drive_id, None)

    def keep(self, drive: DriveRecord) -> None:
        """Also when the disk is full: then only this run of the station knows how the drive ended."""
        try:
            self.library.keep(drive)
        except DataError as exc:
            self.library.remember(drive)
            self._events.say("navigation", str(exc), "error")
        self.tell(drive)

    def tell(self, drive: DriveRecord) -> None:
        self._events.changed("navigation", drive, drive.id)

    def rename(self, drive_id: str, name: str) -> DriveRecord:
        """Name a drive. Raises Unknown; Conflict while it is being recorded or finished, DataError for a bad name."""
        drive = self.library.get(drive_id)
        name = tidy_name(name, "a navigation's name")
        if drive.state in ("recording", "finishing"):
            raise Conflict(_still(drive))
        drive = replace(drive, name=name)
        self.keep(drive)
        return drive

    async def delete(self, drive_id: str) -> None:
        """Put a drive into the bin. Raises Unknown; Conflict while it is being recorded or finished."""
        drive = self.library.get(drive_id)
        if drive.state in ("recording", "finishing"):
            raise Conflict(_still(drive))
        self._refuse_reserved(drive_id)
        await asyncio.to_thread(self.library.delete, drive_id)
        self._events.forget("navigation", drive_id)
        self._events.changed("navigation", None)

    async def restore(self, drive_id: str) -> DriveRecord:
        """Take a drive out of the bin. Raises Unknown."""
        drive = await asyncio.to_thread(self.library.restore, drive_id)
        self.tell(drive)
        return drive

    def reserve(self, drive_id: str) -> None:
        """A job works on this drive's files until `release`. Raises Conflict when one does already."""
        self._refuse_reserved(drive_id)
        self._reserved.add(drive_id)

    def release(self, drive_id: str) -> None:
        self._reserved.discard(drive_id)

    def _refuse_reserved(self, drive_id: str) -> None:
        if drive_id in self._reserved:
            name = self.library.get(drive_id).name
            raise Conflict(f"SLAM runs over {name} just now; wait for the job or cancel it (GET /jobs)")

    def reprocessed(self, drive_id: str, report: NavigationReport) -> DriveRecord:
        """SLAM ran over a drive's recording again and left its navigation."""
        drive = replace(
            self.library.get(drive_id),
            state="ready",
            backend=report.backend,
            landmarks=report.landmarks,
            scale=report.scale,
            message="; ".join(report.messages) or f"{report.landmarks} landmarks",
        )
        self.keep(drive)
        self._events.say("navigation", f"{drive.name} is ready: {report.landmarks} landmarks")
        return drive


def _still(drive: DriveRecord) -> str:
    doing = "being recorded; stop that first" if drive.state == "recording" else "being finished; wait, or cancel that"
    return f"{drive.name} is {doing}"
