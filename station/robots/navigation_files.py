"""The files a navigation begins with: its recording, then its record. Call it in a thread: it waits for the disk."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from shared.errors import RobotSystemError
from shared.messages import Hello
from station.events import LogLine
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.model.place_answer import PlaceReport
from station.model.slam_update import SlamUpdate
from station.robots.link_events import LinkListener


class NavigationRecorder(LinkListener, Protocol):
    """Writes what the link delivers into a file, in a thread of its own; calls return at once."""

    @property
    def error(self) -> str:
        """Why it ended by itself, in a sentence; empty while it works."""
        ...

    def on_command(self, driver: str, linear: float, angular: float, ttl_ms: int) -> None: ...

    def on_slam(self, update: SlamUpdate) -> None: ...

    def on_answer(self, report: PlaceReport) -> None: ...

    def on_log(self, line: LogLine) -> None: ...

    def close(self) -> object: ...


MakeRecorder = Callable[[Path], NavigationRecorder | None]


def make_navigation(
    library: NavigationLibrary, make_recorder: MakeRecorder, hello: Hello, name: str, backend: str, robot: str
) -> tuple[NavigationRecord, NavigationRecorder | None]:
    """A navigation that is recorded from now on; the library does not list it yet. Raises DataError: there is no room.

    Args:
        name: for a person; empty: the time of day.
        robot: what the station calls it.
    """
    navigation_id = library.new_id()
    while not library.hold(navigation_id):
        navigation_id = library.new_id()
    navigation = NavigationRecord(
        id=navigation_id,
        name=name or time.strftime("%-d %b, %H:%M", time.localtime()),
        state="recording",
        started_wall_s=time.time(),
        backend=backend,
        message="recording",
        robot_id=hello.robot_id,
        robot=robot,
    )
    # Before the navigation is kept: one that cannot be recorded never was.
    recorder: NavigationRecorder | None = None
    try:
        recorder = make_recorder(library.recording(navigation_id))
        library.write(navigation)
    except RobotSystemError:
        unmake_navigation(library, navigation, recorder)
        raise
    return navigation, recorder


def unmake_navigation(
    library: NavigationLibrary, navigation: NavigationRecord, recorder: NavigationRecorder | None
) -> None:
    """Nothing was recorded: as if it had never been."""
    if recorder is not None:
        recorder.close()
    library.discard(navigation.id)
