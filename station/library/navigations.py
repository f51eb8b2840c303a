"""The navigations of all robots: listed, deleted and brought back, and which of them somebody works on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

from shared.errors import DataError
from station.errors import Conflict, Unknown
from station.events import Notifier
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.maps.editing import tidy_name
from station.model.navigation import NavigationReport

T = TypeVar("T")


class Navigations:
    """What is on disk, and the counts of the navigations that are being recorded.

    One thread writes, so that records reach the disk in the order in which they were kept and a slow disk holds up no
    drive command. What is known in memory is the newest at once.
    """

    def __init__(self, library: NavigationLibrary, events: Notifier) -> None:
        self.library = library
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="navigations")
        self._writing: set[asyncio.Future[None]] = set()
        self._events = events
        self._running: dict[str, Callable[[], NavigationRecord]] = {}  # id → its record of now
        self._reserved: set[str] = set()

    def list(self) -> list[NavigationRecord]:
        """All navigations, oldest first; running ones with their counts of now."""
        return [self.get(navigation.id) for navigation in self.library.list()]

    def get(self, navigation_id: str) -> NavigationRecord:
        """Raises Unknown."""
        counted = self._running.get(navigation_id)
        return self.library.get(navigation_id) if counted is None else counted()

    def ready(self, navigation_id: str) -> NavigationRecord:
        """One whose SLAM is done. Raises Unknown, Conflict."""
        navigation = self.library.get(navigation_id)
        if navigation.state != "ready":
            raise Conflict(f"{navigation.name} is {navigation.state}, not ready: {navigation.message}")
        return navigation

    def require_here(self, navigation_id: str) -> None:
        """Raises Unknown; Conflict where another station records or finishes it."""
        navigation = self.library.get(navigation_id)
        if self.library.is_elsewhere(navigation_id):
            doing = "recorded" if navigation.state == "recording" else "finished"
            raise Conflict(f"{navigation.name} is being {doing} by another station with this data folder; go there")

    async def look_elsewhere(self) -> Sequence[NavigationRecord]:
        """Know how navigations ended that other stations had under way. Returns those that a dead one left."""
        seen = await self.in_order(self.library.look_elsewhere)
        for navigation in seen.changed:
            self.notify(navigation)
        for navigation_id in seen.gone:
            self._forget(navigation_id)
        return seen.left

    def begin(self, navigation_id: str, counted: Callable[[], NavigationRecord]) -> None:
        """A navigation is being recorded until `end`; `counted` gives its record."""
        self._running[navigation_id] = counted

    def end(self, navigation_id: str) -> None:
        self._running.pop(navigation_id, None)

    def store(self, navigation: NavigationRecord) -> asyncio.Future[None]:
        """Know it from now on, and write it; wait for the result where somebody is told that it is kept.

        A disk that does not take it is told as an event: then only this run of the station knows how it ended.
        """
        self.library.remember(navigation)
        self.notify(navigation)
        writing = asyncio.ensure_future(self._watch(self.in_order(self._write, navigation)))
        self._writing.add(writing)
        writing.add_done_callback(self._writing.discard)
        return asyncio.shield(writing)  # who stops waiting does not take it back

    async def _watch(self, writing: asyncio.Future[None]) -> None:
        try:
            await writing
        except Unknown:
            pass  # it was deleted meanwhile
        except DataError as exc:
            self._events.notify("navigation", str(exc), "error")

    def _write(self, navigation: NavigationRecord) -> None:
        """Raises Unknown, DataError."""
        self.library.get(navigation.id)  # else its folder would come back
        self.library.write(navigation)

    def in_order(self, work: Callable[..., T], *arguments: object) -> asyncio.Future[T]:
        """Let the thread do it that writes, after all that was asked of it before."""
        return asyncio.get_running_loop().run_in_executor(self._disk, work, *arguments)

    async def close(self) -> None:
        """Wait until everything is written; nothing can be kept any more."""
        await asyncio.gather(*self._writing, return_exceptions=True)
        await asyncio.to_thread(self._disk.shutdown)
        self.library.close()

    def notify(self, navigation: NavigationRecord) -> None:
        self._events.changed("navigation", navigation, navigation.id)

    async def rename(self, navigation_id: str, name: str) -> NavigationRecord:
        """Name a navigation. Raises Unknown; Conflict while it is being recorded or finished.

        DataError for a bad name, or for a disk that does not take it: then the old name stays.
        """
        self.require_here(navigation_id)
        navigation = self.library.get(navigation_id)
        name = tidy_name(name, "a navigation's name")
        if navigation.state in ("recording", "finishing"):
            raise Conflict(_still(navigation))
        renamed = replace(navigation, name=name)
        self.library.remember(renamed)  # at once: what is kept meanwhile keeps the name
        try:
            await self.in_order(self._write, renamed)
        except DataError:
            self.library.remember(replace(self.library.get(navigation_id), name=navigation.name))
            raise
        self.notify(self.library.get(navigation_id))
        return self.library.get(navigation_id)

    async def delete(self, navigation_id: str) -> None:
        """Put a navigation into the bin. Raises Unknown; Conflict while it is being recorded or finished."""
        self.require_here(navigation_id)
        navigation = self.library.get(navigation_id)
        if navigation.state in ("recording", "finishing"):
            raise Conflict(_still(navigation))
        self.reserve(navigation_id)  # nothing begins to read it while it waits behind what is written
        try:
            await self.in_order(self.library.delete, navigation_id)
        finally:
            self.release(navigation_id)
        self._forget(navigation_id)

    def _forget(self, navigation_id: str) -> None:
        self._events.forget("navigation", navigation_id)
        self._events.changed("navigation", None)

    async def restore(self, navigation_id: str) -> NavigationRecord:
        """Take a navigation out of the bin. Raises Unknown."""
        navigation = await self.in_order(self.library.restore, navigation_id)
        self.notify(navigation)
        return navigation

    def reserve(self, navigation_id: str) -> None:
        """A job works on this navigation's files until `release`. Raises Conflict when one does already."""
        if navigation_id in self._reserved:
            name = self.library.get(navigation_id).name
            raise Conflict(
                f"SLAM runs over {name} just now, or it goes into the bin; wait for the job or cancel it (GET /jobs)"
            )
        self._reserved.add(navigation_id)

    def release(self, navigation_id: str) -> None:
        self._reserved.discard(navigation_id)

    async def reprocessed(self, navigation_id: str, report: NavigationReport) -> NavigationRecord:
        """SLAM ran over a navigation's recording again and left its navigation."""
        navigation = replace(
            self.library.get(navigation_id),
            state="ready",
            backend=report.backend,
            landmarks=report.landmarks,
            scale=report.scale,
            frames_skipped=0,
            message="; ".join(report.messages) or f"{report.landmarks} landmarks",
        )
        await self.store(navigation)
        self._events.notify("navigation", f"{navigation.name} is ready: {report.landmarks} landmarks")
        return navigation


def _still(navigation: NavigationRecord) -> str:
    doing = (
        "being recorded; stop that first" if navigation.state == "recording" else "being finished; wait, or cancel that"
    )
    return f"{navigation.name} is {doing}"
