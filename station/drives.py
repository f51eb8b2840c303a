"""The drives of all robots: listed, deleted and brought back, and which of them somebody works on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

from shared.errors import DataError
from station.drive_library import DriveLibrary, DriveRecord
from station.events import Teller
from station.maps.editing import tidy_name
from station.navigation import NavigationReport
from station.refusals import Conflict, Unknown

T = TypeVar("T")


class Drives:
    """What is on disk, and the counts of the drives that are being recorded.

    One thread writes, so that records reach the disk in the order in which they were kept and a slow disk holds up no
    drive command. What is known in memory is the newest at once.
    """

    def __init__(self, library: DriveLibrary, events: Teller) -> None:
        self.library = library
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="drives")
        self._writing: set[asyncio.Future[None]] = set()
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

    def keep(self, drive: DriveRecord) -> asyncio.Future[None]:
        """Know it from now on, and write it; wait for the result where somebody is told that it is kept.

        A disk that does not take it is told as an event: then only this run of the station knows how the drive ended.
        """
        self.library.remember(drive)
        self.tell(drive)
        writing = asyncio.ensure_future(self._watch(self.in_order(self._write, drive)))
        self._writing.add(writing)
        writing.add_done_callback(self._writing.discard)
        return asyncio.shield(writing)  # who stops waiting does not take it back

    async def _watch(self, writing: asyncio.Future[None]) -> None:
        try:
            await writing
        except Unknown:
            pass  # it was deleted meanwhile
        except DataError as exc:
            self._events.say("navigation", str(exc), "error")

    def _write(self, drive: DriveRecord) -> None:
        """Raises Unknown, DataError."""
        self.library.get(drive.id)  # else its folder would come back
        self.library.write(drive)

    def in_order(self, work: Callable[..., T], *arguments: object) -> asyncio.Future[T]:
        """Let the thread do it that writes, after all that was asked of it before."""
        return asyncio.get_running_loop().run_in_executor(self._disk, work, *arguments)

    async def close(self) -> None:
        """Wait until everything is written; nothing can be kept any more."""
        await asyncio.gather(*self._writing, return_exceptions=True)
        await asyncio.to_thread(self._disk.shutdown)

    def tell(self, drive: DriveRecord) -> None:
        self._events.changed("navigation", drive, drive.id)

    async def rename(self, drive_id: str, name: str) -> DriveRecord:
        """Name a drive. Raises Unknown; Conflict while it is being recorded or finished.

        DataError for a bad name, or for a disk that does not take it: then the old name stays.
        """
        drive = self.library.get(drive_id)
        name = tidy_name(name, "a navigation's name")
        if drive.state in ("recording", "finishing"):
            raise Conflict(_still(drive))
        renamed = replace(drive, name=name)
        self.library.remember(renamed)  # at once: what is kept meanwhile keeps the name
        try:
            await self.in_order(self._write, renamed)
        except DataError:
            self.library.remember(replace(self.library.get(drive_id), name=drive.name))
            raise
        self.tell(self.library.get(drive_id))
        return self.library.get(drive_id)

    async def delete(self, drive_id: str) -> None:
        """Put a drive into the bin. Raises Unknown; Conflict while it is being recorded or finished."""
        drive = self.library.get(drive_id)
        if drive.state in ("recording", "finishing"):
            raise Conflict(_still(drive))
        self.reserve(drive_id)  # nothing begins to read it while it waits behind what is written
        try:
            await self.in_order(self.library.delete, drive_id)
        finally:
            self.release(drive_id)
        self._events.forget("navigation", drive_id)
        self._events.changed("navigation", None)

    async def restore(self, drive_id: str) -> DriveRecord:
        """Take a drive out of the bin. Raises Unknown."""
        drive = await self.in_order(self.library.restore, drive_id)
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
            raise Conflict(
                f"SLAM runs over {name} just now, or it goes into the bin; wait for the job or cancel it (GET /jobs)"
            )

    async def reprocessed(self, drive_id: str, report: NavigationReport) -> DriveRecord:
        """SLAM ran over a drive's recording again and left its navigation."""
        drive = replace(
            self.library.get(drive_id),
            state="ready",
            backend=report.backend,
            landmarks=report.landmarks,
            scale=report.scale,
            message="; ".join(report.messages) or f"{report.landmarks} landmarks",
        )
        await self.keep(drive)
        self._events.say("navigation", f"{drive.name} is ready: {report.landmarks} landmarks")
        return drive


def _still(drive: DriveRecord) -> str:
    doing = "being recorded; stop that first" if drive.state == "recording" else "being finished; wait, or cancel that"
    return f"{drive.name} is {doing}"
