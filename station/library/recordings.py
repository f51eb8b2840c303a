"""Care for the recordings on disk: ones that the station's end cut are recovered, ones beyond the limits removed.

What SLAM made of a recording stays when it is removed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

from shared.errors import DataError, RobotSystemError
from station.config import RecordingConfig
from station.events import Notifier
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.library.navigations import Navigations
from station.recordings.recovery import recover_recording

logger = logging.getLogger(__name__)
ELSEWHERE_CHECK_S = 5.0


@dataclass(frozen=True, slots=True)
class FinishedRecording:
    """The recording of a navigation that is over."""

    navigation_id: str
    started_wall_s: float  # seconds since 1970
    bytes: int
    age_s: float = 0.0  # as the station counts: its clock on the wall may be set


async def follow_elsewhere(navigations: Navigations, events: Notifier) -> None:
    """Follow what other stations with this data folder have under way; recover what one left that has died."""
    while True:
        await asyncio.sleep(ELSEWHERE_CHECK_S)
        try:
            await recover_recordings(navigations, await navigations.look_elsewhere(), events)
        except (RobotSystemError, OSError) as exc:  # it must not end the robots
            logger.warning("what other stations with this data folder recorded could not be read: %s", exc)


async def recover_recordings(
    navigations: Navigations, interrupted: Iterable[NavigationRecord], events: Notifier
) -> None:
    """Give the recordings of navigations that the station's end cut their own end, and say what was saved."""
    for navigation in interrupted:
        path = navigations.library.recording(navigation.id)
        try:
            recovery = await asyncio.to_thread(recover_recording, path) if path.is_file() else None
            if recovery is None:
                continue
            message = (
                f"interrupted; {recovery.seconds:.0f} s are recovered: run SLAM again to make a navigation of them"
            )
            if navigation in navigations.library.list():  # nobody deleted or named it meanwhile
                await navigations.store(replace(navigation, message=message, duration_s=recovery.seconds))
            events.notify("navigation", f"{navigation.name}: {recovery}", "warning")
        except RobotSystemError as exc:
            events.notify("navigation", f"{navigation.name}: {exc}", "error")


async def retain_recordings(library: NavigationLibrary, limits: RecordingConfig, events: Notifier) -> None:
    """Remove the recordings that are beyond the limits."""
    finished = await asyncio.to_thread(_with_ages, library)
    for old in to_remove(finished, round(limits.max_gb * 1e9), limits.max_days * 86_400.0):
        try:
            await asyncio.to_thread(remove_recording, library, old.navigation_id)
        except RobotSystemError as exc:
            events.notify("navigation", str(exc), "error")
            continue
        text = f"the recording of {old.navigation_id} was removed, as recordings.max_gb and max_days ask"
        events.notify("navigation", f"{text}; its trajectory and landmarks stay")


def _with_ages(library: NavigationLibrary) -> list[FinishedRecording]:
    """The recordings of navigations that are over, as old as they are by now."""
    finished = finished_recordings(library)
    there = [r.navigation_id for r in finished] + [n.id for n in library.deleted()]  # which may be restored
    ages_s = library.recording_ages.update(there, time.time(), time.monotonic())
    return [replace(r, age_s=ages_s[r.navigation_id]) for r in finished]


def finished_recordings(library: NavigationLibrary) -> list[FinishedRecording]:
    """The recordings of navigations that are over."""
    found = []
    for navigation in library.list():
        if navigation.state in ("ready", "failed"):
            with contextlib.suppress(OSError):  # there is none, or somebody deletes it just now
                if files := library.recording_files(navigation.id):
                    size = sum(file.stat().st_size for file in files)
                    found.append(FinishedRecording(navigation.id, navigation.started_wall_s, size))
    return found


def to_remove(recordings: Iterable[FinishedRecording], max_bytes: int, max_age_s: float) -> list[FinishedRecording]:
    """The ones to remove, oldest first. A limit of 0 is none."""
    newest_first = sorted(recordings, key=lambda r: (r.age_s, -r.started_wall_s, r.navigation_id))
    removed = []
    total = 0
    for recording in newest_first:
        total += recording.bytes
        is_old = max_age_s > 0 and recording.age_s > max_age_s
        if is_old or (max_bytes > 0 and total > max_bytes):
            removed.append(recording)
    return removed[::-1]


def remove_recording(library: NavigationLibrary, navigation_id: str) -> None:
    """Delete a recording; its navigation stays. Raises DataError."""
    try:
        for file in library.recording_files(navigation_id):
            file.unlink(missing_ok=True)
    except OSError as exc:
        path = library.recording(navigation_id)
        raise DataError(f"{path} cannot be deleted ({exc.strerror}); delete it by hand") from exc
