"""The files a drive begins with: its recording, then its record. Making them waits for the disk: do it in a thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from shared.errors import RobotSystemError
from shared.messages import Hello
from station.drive_library import DriveLibrary, DriveRecord
from station.events import LogLine
from station.link import LinkListener
from station.place_report import PlaceReport
from station.slam.backend import SlamUpdate


class DriveRecorder(LinkListener, Protocol):
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


MakeRecorder = Callable[[Path], DriveRecorder | None]


def make_drive(
    library: DriveLibrary, make_recorder: MakeRecorder, hello: Hello, name: str, backend: str, robot: str
) -> tuple[DriveRecord, DriveRecorder | None]:
    """A drive that is recorded from now on; the library does not list it yet. Raises DataError when there is no room.

    Args:
        name: for a person; empty: the time of day.
        robot: what the station calls it.
    """
    drive_id = library.new_id()
    drive = DriveRecord(
        id=drive_id,
        name=name or time.strftime("%-d %b, %H:%M", time.localtime()),
        state="recording",
        started_wall_s=time.time(),
        backend=backend,
        message="recording",
        robot_id=hello.robot_id,
        robot=robot,
    )
    # Before the drive is kept: one that cannot be recorded never was.
    recorder: DriveRecorder | None = None
    try:
        recorder = make_recorder(library.recording(drive_id))
        library.write(drive)
    except RobotSystemError:
        unmake_drive(library, drive, recorder)
        raise
    return drive, recorder


def unmake_drive(library: DriveLibrary, drive: DriveRecord, recorder: DriveRecorder | None) -> None:
    """Nothing was recorded: as if it had never been."""
    if recorder is not None:
        recorder.close()
    library.discard(drive.id)
