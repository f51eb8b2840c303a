"""The recorded drives on disk: `<root>/<id>/` with drive.json, recording.mcap and, when SLAM is done, navigation/."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from shared.errors import DataError
from station.maps.bucket import Unwritable, cannot_write, flush, why_unwritable
from station.refusals import Unknown
from station.retention import KeptRecording

DriveState = Literal["recording", "finishing", "ready", "failed"]
BIN = ".bin"  # the folder of deleted drives
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}")


@dataclass(frozen=True, slots=True)
class DriveRecord:
    """One recorded drive and how far its SLAM is."""

    id: str
    name: str
    state: DriveState
    started_wall_s: float  # seconds since 1970
    backend: str
    message: str = ""  # in a sentence
    robot_id: str = ""
    robot: str = ""  # what the station called it
    duration_s: float = 0.0
    frames: int = 0
    frames_skipped: int = 0  # by a SLAM worker that was too slow; the recording has them
    imu_samples: int = 0
    imu_lost: int = 0
    slam_failures: int = 0  # pictures or samples that SLAM refused
    landmarks: int = 0
    scale: Literal["metric", "arbitrary", ""] = ""


class DriveLibrary:
    """All drives in one folder. What writes, moves or removes waits for the disk: call it in one thread."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self.unwritable = ""  # a sentence, when `open` found that nothing can be written
        self._drives: dict[str, DriveRecord] = {}

    def open(self) -> list[DriveRecord]:
        """Read what is there. Drives that were under way when the station ended are kept as failed, and returned.

        Where nothing can be written they are only known as failed until the station ends; `unwritable` says why then.
        Raises DataError: there is no such folder and none can be made.
        """
        interrupted = []
        self.unwritable = ""
        try:
            data = self._root.parent
            if not self._root.is_dir() and (not data.is_dir() or why_unwritable(data) is None):
                self._root.mkdir(parents=True)
            here = sorted(self._root.iterdir()) if self._root.is_dir() else []
        except OSError as exc:
            raise DataError(f"{self._root} cannot be used ({exc.strerror}); choose another folder with --data") from exc
        if (told := why_unwritable(self._root)) is not None:
            self.unwritable = str(cannot_write(self._root, told))
        folders = [path for path in here if _ID.fullmatch(path.name) and path.is_dir()]
        for folder in folders:
            try:
                drive = msgspec.json.decode((folder / "drive.json").read_bytes(), type=DriveRecord)
            except (OSError, msgspec.DecodeError):
                if not (folder / "recording.mcap").is_file():
                    continue  # half a drive of a killed station, in which nothing was recorded yet
                drive = _without_record(folder)
            if drive.state in ("recording", "finishing"):
                drive = replace(drive, state="failed", message="the station ended before this navigation was finished")
                try:
                    self.keep(drive)
                except Unwritable:
                    self.remember(drive)
                interrupted.append(drive)
            self._drives[drive.id] = drive
        return interrupted

    def list(self) -> list[DriveRecord]:
        """Oldest first."""
        known = list(self._drives.values())  # in one step: another thread may add to them
        return sorted(known, key=lambda d: (d.started_wall_s, d.id))

    def get(self, drive_id: str) -> DriveRecord:
        """Raises Unknown."""
        if drive_id not in self._drives:
            raise Unknown(f"there is no navigation {drive_id!r}; GET /navigations lists them")
        return self._drives[drive_id]

    def new_id(self) -> str:
        """A name from the clock on the wall, unused so far."""
        stem = time.strftime("nav-%Y%m%d-%H%M%S", time.localtime())
        number, candidate = 1, stem
        while any((folder / candidate).exists() for folder in (self._root, self._root / BIN)):
            number += 1
            candidate = f"{stem}-{number}"
        return candidate

    def folder(self, drive_id: str) -> Path:
        """Where a drive's files are."""
        if not _ID.fullmatch(drive_id):
            raise Unknown(f"there is no navigation {drive_id!r}; GET /navigations lists them")
        return self._root / drive_id

    def navigation_folder(self, drive_id: str) -> Path:
        return self.folder(drive_id) / "navigation"

    def keep(self, drive: DriveRecord) -> None:
        """Write a drive's record and know it. Raises Unwritable."""
        self.write(drive)
        self.remember(drive)

    def write(self, drive: DriveRecord) -> None:
        """Write a drive's record, whole or not at all; when this returns it survives a power cut. Raises Unwritable."""
        folder = self.folder(drive.id)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            scratch = folder / ".drive.json"
            with scratch.open("w", encoding="utf-8") as file:
                file.write(json.dumps(msgspec.to_builtins(drive), indent=1) + "\n")
                file.flush()
                os.fsync(file.fileno())
            os.replace(scratch, folder / "drive.json")
            for changed in (folder, self._root):  # the names too survive a power cut
                flush(changed)
        except OSError as exc:
            raise cannot_write(folder, exc) from exc

    def remember(self, drive: DriveRecord) -> None:
        """Know it as long as the station runs. Returns at once."""
        self._drives[drive.id] = drive

    def recording(self, drive_id: str) -> Path:
        """Where a drive's recording is, or would be."""
        return self.folder(drive_id) / "recording.mcap"

    def _recorded(self, drive_id: str) -> Sequence[Path]:
        """The recording, and what its recovery kept of a damaged one (recovery.py)."""
        return sorted(self.folder(drive_id).glob("recording.mcap*"))

    def finished_recordings(self) -> Sequence[KeptRecording]:
        """The recordings of drives that are over."""
        kept = []
        for drive in self.list():
            if drive.state in ("ready", "failed"):
                with contextlib.suppress(OSError):  # there is none, or somebody deletes it just now
                    if files := self._recorded(drive.id):
                        size = sum(file.stat().st_size for file in files)
                        kept.append(KeptRecording(drive.id, drive.started_wall_s, size))
        return kept

    def remove_recording(self, drive_id: str) -> None:
        """Delete a recording and keep its drive."""
        try:
            for file in self._recorded(drive_id):
                file.unlink(missing_ok=True)
        except OSError as exc:
            raise DataError(
                f"{self.recording(drive_id)} cannot be deleted ({exc.strerror}); delete it by hand"
            ) from exc

    def delete(self, drive_id: str) -> None:
        """Forget a drive; `restore` brings it back until it is purged. Raises Unknown."""
        self.get(drive_id)
        try:
            (self._root / BIN).mkdir(exist_ok=True)
            os.rename(self.folder(drive_id), self._root / BIN / drive_id)
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc
        del self._drives[drive_id]

    def deleted(self) -> tuple[DriveRecord, ...]:
        """Drives that can be restored."""
        found = []
        for folder in sorted((self._root / BIN).glob("*")):
            try:
                found.append(msgspec.json.decode((folder / "drive.json").read_bytes(), type=DriveRecord))
            except (OSError, msgspec.DecodeError):
                continue
        return tuple(found)

    def restore(self, drive_id: str) -> DriveRecord:
        """Bring a deleted drive back. Raises Unknown."""
        drive = next((drive for drive in self.deleted() if drive.id == drive_id), None)
        if drive is None:
            raise Unknown(f"there is no deleted navigation {drive_id!r}; GET /bin lists what can be restored")
        try:
            os.rename(self._root / BIN / drive_id, self.folder(drive_id))
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc
        self._drives[drive_id] = drive
        return drive

    def purge(self, drive_id: str) -> None:
        """Delete a deleted drive's files for good."""
        self.folder(drive_id)  # its id is no path
        shutil.rmtree(self._root / BIN / drive_id, ignore_errors=True)

    def discard(self, drive_id: str) -> None:
        """Remove the files of a drive that is not known, or not any more."""
        shutil.rmtree(self.folder(drive_id), ignore_errors=True)


def _without_record(folder: Path) -> DriveRecord:
    """A drive of which only the recording is left."""
    started_s = (folder / "recording.mcap").stat().st_mtime
    return DriveRecord(folder.name, folder.name, "recording", started_s, "unknown")
