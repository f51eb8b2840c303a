"""The navigations on disk: `<root>/<id>/` with record.json, recording.mcap and, when SLAM is done, navigation/."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import stat
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, BinaryIO, Literal

import msgspec

from shared.bounded import MAX_SETTINGS_BYTES, read_file, shown
from shared.disk import flush, make_folder, replace_file, settle_folders
from shared.errors import DataError
from shared.text import PRINTABLE
from station.errors import Unknown
from station.files.unwritable import Unwritable, cannot_write, why_unwritable
from station.library.dated_id import free_dated_id
from station.library.recording_ages import RecordingAges
from station.recordings import writer_lock

NavigationState = Literal["recording", "finishing", "ready", "failed"]
RECORD = "record.json"
RECORDING = "recording.mcap"
NAVIGATION = "navigation"
OLD_RECORD = "drive.json"  # its name until November 2026
AGES = "recording_ages.json"
BIN = ".bin"  # the folder of deleted navigations
HELD = ".held"  # in a navigation's folder, locked by the station that records or finishes it
LEFT = "the station ended before this navigation was finished"
UNDER_WAY: tuple[NavigationState, ...] = ("recording", "finishing")
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}")


@dataclass(frozen=True, slots=True)
class NavigationRecord:
    """One recorded navigation and how far its SLAM is."""

    id: str
    name: Annotated[str, msgspec.Meta(pattern=PRINTABLE)]
    state: NavigationState
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


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """What became of navigations that other stations had under way."""

    changed: list[NavigationRecord] = field(default_factory=list)
    left: list[NavigationRecord] = field(default_factory=list)  # of these: by a station that ended before
    gone: list[str] = field(default_factory=list)  # ids


class NavigationLibrary:
    """All navigations in one folder. What writes, moves or removes waits for the disk: call it in one thread."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self.recording_ages = RecordingAges(root / AGES)
        self.unwritable = ""  # a sentence, when `open` found that nothing can be written
        self._navigations: dict[str, NavigationRecord] = {}
        self._held: dict[str, BinaryIO] = {}  # of the navigations that this station has under way
        self._elsewhere: set[str] = set()  # navigations that another station has under way

    def open(self) -> list[NavigationRecord]:
        """Read what is there. Returns those that were under way when the station ended; they are failed now.

        Those that another station has under way are left to it. Where nothing can be written they are only known as
        failed until the station ends; `unwritable` says why then.
        Raises DataError: there is no such folder and none can be made.
        """
        interrupted = []
        self.unwritable = ""
        try:
            data = self._root.parent
            if not self._root.is_dir() and (not data.is_dir() or why_unwritable(data) is None):
                make_folder(self._root)
            here = sorted(self._root.iterdir()) if self._root.is_dir() else []
        except OSError as exc:
            raise DataError(f"{self._root} cannot be used ({exc.strerror}); choose another folder with --data") from exc
        if (told := why_unwritable(self._root)) is not None:
            self.unwritable = str(cannot_write(self._root, told))
        with contextlib.suppress(OSError):
            make_folder(self._root / BIN)  # now: a disk that is full by then has no room for a folder
        folders = [path for path in here if _ID.fullmatch(path.name) and path.is_dir()]
        for folder in folders:
            settle_folders(folder, NAVIGATION)
            if (left := self._learn(folder)) is not None:
                interrupted.append(left)
        return interrupted

    def look_elsewhere(self) -> Elsewhere:
        """Read again what other stations had under way when this one began; what its station left is failed."""
        seen = Elsewhere()
        for navigation_id in sorted(self._elsewhere):
            known = self._navigations[navigation_id]
            if (left := self._learn(self.folder(navigation_id))) is not None:
                seen.left.append(left)
            now = self._navigations.get(navigation_id)
            if now is None:
                seen.gone.append(navigation_id)
            elif now != known:
                seen.changed.append(now)
        return seen

    def is_elsewhere(self, navigation_id: str) -> bool:
        """Whether another station has it under way."""
        return navigation_id in self._elsewhere

    def _learn(self, folder: Path) -> NavigationRecord | None:
        """Know the navigation in a folder. Returns it where its station left it under way; it is failed now."""
        found, is_held = _find(folder), False
        if found is not None and found.state in UNDER_WAY:
            is_held = self._is_held_elsewhere(folder)
            found = found if is_held else _find(folder)  # its station may have ended it between the two
        self._elsewhere.discard(folder.name)
        if found is None:
            self._navigations.pop(folder.name, None)
        elif found.state not in UNDER_WAY:
            self.remember(found)
        elif is_held:
            self._elsewhere.add(found.id)
            self.remember(replace(found, message="another station with this data folder works on it"))
        else:
            found = replace(found, state="failed", message=LEFT)
            try:
                self.store(found)
            except Unwritable:
                self.remember(found)
            return found
        return None

    def _is_held_elsewhere(self, folder: Path) -> bool:
        if folder.name in self._held:
            return False
        try:
            with (folder / HELD).open("rb") as file:
                return writer_lock.is_being_written(file)
        except OSError:
            return False

    def hold(self, navigation_id: str) -> bool:
        """Have a new navigation under way until its record is written as ended, or this program ends.

        False: another station began one of this name. Raises Unwritable.
        """
        folder = self.folder(navigation_id)
        try:
            make_folder(self._root)
            folder.mkdir()  # of two stations one makes it, also where files cannot be locked
            flush(self._root)
            file = (folder / HELD).open("wb")
        except FileExistsError:
            return False
        except OSError as exc:
            raise cannot_write(folder, exc) from exc
        writer_lock.hold(file)
        self._held[navigation_id] = file
        return True

    def _let_go(self, navigation_id: str) -> None:
        if (file := self._held.pop(navigation_id, None)) is not None:
            with file, contextlib.suppress(OSError):
                (self.folder(navigation_id) / HELD).unlink()

    def close(self) -> None:
        """Let go of what is still under way: whoever opens the folder next finds it interrupted."""
        while self._held:
            self._held.popitem()[1].close()

    def list(self) -> list[NavigationRecord]:
        """Oldest first."""
        known = list(self._navigations.values())  # in one step: another thread may add to them
        return sorted(known, key=lambda d: (d.started_wall_s, d.id))

    def get(self, navigation_id: str) -> NavigationRecord:
        """Raises Unknown."""
        if navigation_id not in self._navigations:
            raise Unknown(f"there is no navigation {shown(navigation_id)}; GET /navigations lists them")
        return self._navigations[navigation_id]

    def new_id(self) -> str:
        """A name from the clock on the wall, unused so far."""
        folders = (self._root, self._root / BIN)
        return free_dated_id("nav", lambda candidate: any((folder / candidate).exists() for folder in folders))

    def folder(self, navigation_id: str) -> Path:
        """Where a navigation's files are."""
        if not _ID.fullmatch(navigation_id):
            raise Unknown(f"there is no navigation {shown(navigation_id)}; GET /navigations lists them")
        return self._root / navigation_id

    def navigation_folder(self, navigation_id: str) -> Path:
        return self.folder(navigation_id) / NAVIGATION

    def store(self, navigation: NavigationRecord) -> None:
        """Write a navigation's record and know it. Raises Unwritable."""
        self.write(navigation)
        self.remember(navigation)

    def write(self, navigation: NavigationRecord) -> None:
        """Write a record, whole or not at all; when this returns it survives a power cut. Raises Unwritable."""
        folder = self.folder(navigation.id)
        try:
            make_folder(folder)
            content = json.dumps(msgspec.to_builtins(navigation), indent=1) + "\n"
            replace_file(folder / RECORD, content.encode(), scratch=folder / f".{RECORD}")
            (folder / OLD_RECORD).unlink(missing_ok=True)
        except OSError as exc:
            raise cannot_write(folder, exc) from exc
        if navigation.state not in UNDER_WAY:
            self._let_go(navigation.id)

    def remember(self, navigation: NavigationRecord) -> None:
        """Know it as long as the station runs. Returns at once."""
        self._navigations[navigation.id] = navigation

    def recording(self, navigation_id: str) -> Path:
        """Where a navigation's recording is, or would be."""
        return self.folder(navigation_id) / RECORDING

    def recording_files(self, navigation_id: str) -> Sequence[Path]:
        """The recording, and what its recovery left of a damaged one (recovery.py)."""
        return sorted(self.folder(navigation_id).glob(f"{RECORDING}*"))

    def delete(self, navigation_id: str) -> None:
        """Forget a navigation; `restore` brings it back until it is purged. Raises Unknown."""
        self.get(navigation_id)
        self._let_go(navigation_id)
        try:
            make_folder(self._root / BIN)
            os.rename(self.folder(navigation_id), self._root / BIN / navigation_id)
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc
        del self._navigations[navigation_id]

    def deleted(self) -> tuple[NavigationRecord, ...]:
        """Those that can be restored."""
        found = []
        for folder in sorted((self._root / BIN).glob("*")):
            if not _ID.fullmatch(folder.name):
                continue
            try:
                found.append(_read_record(folder))
            except (OSError, msgspec.DecodeError):
                continue
        return tuple(found)

    def restore(self, navigation_id: str) -> NavigationRecord:
        """Bring a deleted navigation back. Raises Unknown."""
        navigation = next((navigation for navigation in self.deleted() if navigation.id == navigation_id), None)
        if navigation is None:
            raise Unknown(f"there is no deleted navigation {shown(navigation_id)}; GET /bin lists what can be restored")
        try:
            os.rename(self._root / BIN / navigation_id, self.folder(navigation_id))
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc
        self._navigations[navigation_id] = navigation
        return navigation

    def purge(self, navigation_id: str) -> None:
        """Delete a deleted navigation's files for good. Raises Unwritable."""
        self.folder(navigation_id)  # its id is no path
        try:
            shutil.rmtree(self._root / BIN / navigation_id)
        except FileNotFoundError:
            pass
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc

    def discard(self, navigation_id: str) -> None:
        """Remove the files of a navigation that is not known, or not any more."""
        held = self._held.pop(navigation_id, None)
        shutil.rmtree(self.folder(navigation_id), ignore_errors=True)
        if held is not None:  # its name may be another station's by now
            held.close()


def _read_record(folder: Path) -> NavigationRecord:
    """Raises OSError, msgspec.DecodeError: there is none, or it is damaged."""
    named = folder / RECORD
    path = named if named.exists() else folder / OLD_RECORD
    record = msgspec.json.decode(read_file(path, MAX_SETTINGS_BYTES), type=NavigationRecord)
    return replace(record, id=folder.name)  # somebody may have copied or renamed the folder


def _find(folder: Path) -> NavigationRecord | None:
    """The navigation in a folder; None where a killed station had recorded nothing of it yet."""
    try:
        return _read_record(folder)
    except (OSError, msgspec.DecodeError):
        return _without_record(folder)


def _without_record(folder: Path) -> NavigationRecord | None:
    """A navigation of which only the recording is left."""
    try:
        recording = (folder / RECORDING).stat()
    except OSError:
        return None
    if not stat.S_ISREG(recording.st_mode):
        return None
    return NavigationRecord(folder.name, folder.name, "recording", recording.st_mtime, "unknown")
