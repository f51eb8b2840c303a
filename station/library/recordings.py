"""Care for the recordings on disk: ones that the station's end cut are recovered, ones beyond the limits removed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from dataclasses import replace

from shared.errors import RobotSystemError
from station.config import RecordingConfig
from station.events import Notifier
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.library.navigations import Navigations
from station.library.retention import to_remove
from station.recordings.recovery import recover_recording


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
                await navigations.keep(replace(navigation, message=message, duration_s=recovery.seconds))
            events.notify("navigation", f"{navigation.name}: {recovery}", "warning")
        except RobotSystemError as exc:
            events.notify("navigation", f"{navigation.name}: {exc}", "error")


async def retain_recordings(library: NavigationLibrary, limits: RecordingConfig, events: Notifier) -> None:
    """Remove the recordings that are beyond the limits; what SLAM made of them stays."""
    kept = await asyncio.to_thread(library.finished_recordings)
    for old in to_remove(kept, round(limits.max_gb * 1e9), limits.max_days * 86_400.0, time.time()):
        try:
            await asyncio.to_thread(library.remove_recording, old.navigation_id)
        except RobotSystemError as exc:
            events.notify("navigation", str(exc), "error")
            continue
        text = f"the recording of {old.navigation_id} was removed, as recordings.max_gb and max_days ask"
        events.notify("navigation", f"{text}; its trajectory and landmarks stay")
