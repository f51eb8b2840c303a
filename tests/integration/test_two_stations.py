"""Two stations on one data folder: what one records or finishes the other leaves alone, until that one has died."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from station.errors import Conflict
from station.events import Events
from station.library.navigation_records import LEFT, NavigationLibrary
from station.library.navigations import Navigations
from station.library.recordings import recover_recordings
from station.recordings.recorder import Recorder
from station.robots.navigation_files import make_navigation
from tests.support.paths import ROOT
from tests.support.recordings import HELLO

FOLDER = "navigations"


def be_a_station(data: Path) -> None:
    """Record a navigation, then go on as far as the test asks, a line at a time."""
    library = NavigationLibrary(data / FOLDER)
    library.open()
    navigation, recorder = make_navigation(
        library, lambda path: Recorder(path, min_free_bytes=0), HELLO, "Flat", "sfm", "attic"
    )
    assert recorder is not None
    recorder.on_connected(HELLO)
    print(navigation.id, flush=True)
    sys.stdin.readline()
    recorder.close()
    library.store(replace(navigation, state="finishing", message="SLAM"))
    print("finishing", flush=True)
    sys.stdin.readline()
    library.store(replace(navigation, state="ready", message="7 landmarks"))
    print("ready", flush=True)
    sys.stdin.readline()


@dataclass(frozen=True, slots=True)
class OtherStation:
    """A process that records a navigation in the same data folder."""

    process: subprocess.Popen[str]
    navigation_id: str

    def go_on(self) -> str:
        """Its next state."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def die(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def other_station(data: Path) -> Iterator[OtherStation]:
    code = f"import pathlib, {__name__} as test; test.be_a_station(pathlib.Path({str(data)!r}))"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        try:
            yield OtherStation(process, process.stdout.readline().strip())
        finally:
            process.kill()


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("state", ["recording", "finishing"])
async def test_what_another_station_has_under_way_is_left_to_it_until_it_dies(tmp_path: Path, state: str) -> None:
    with other_station(tmp_path) as other:
        if state == "finishing":
            assert other.go_on() == "finishing"
        library = NavigationLibrary(tmp_path / FOLDER)
        before = files_of(library.folder(other.navigation_id))
        assert library.open() == []
        navigations = Navigations(library, Events())
        assert [(n.id, n.state) for n in navigations.list()] == [(other.navigation_id, state)]
        assert "another station" in navigations.list()[0].message
        for forbidden in (navigations.delete(other.navigation_id), navigations.rename(other.navigation_id, "Mine")):
            with pytest.raises(Conflict, match="by another station"):
                await forbidden
        assert await navigations.look_elsewhere() == []
        assert files_of(library.folder(other.navigation_id)) == before

        other.die()
        left = await navigations.look_elsewhere()
        assert [(n.id, n.state, n.message) for n in left] == [(other.navigation_id, "failed", LEFT)]
        await recover_recordings(navigations, left, Events())
        await navigations.rename(other.navigation_id, "Mine")
        await navigations.delete(other.navigation_id)
        await navigations.close()


def test_a_station_that_starts_after_another_died_finds_its_navigation_failed(tmp_path: Path) -> None:
    with other_station(tmp_path) as other:
        other.die()
        left = NavigationLibrary(tmp_path / FOLDER).open()
        assert [(n.id, n.state) for n in left] == [(other.navigation_id, "failed")]


async def test_how_it_ended_at_another_station_is_known(tmp_path: Path) -> None:
    with other_station(tmp_path) as other:
        library = NavigationLibrary(tmp_path / FOLDER)
        library.open()
        navigations = Navigations(library, Events())
        assert (other.go_on(), other.go_on()) == ("finishing", "ready")
        assert await navigations.look_elsewhere() == []  # nobody left it
        assert navigations.ready(other.navigation_id).message == "7 landmarks"
        await navigations.rename(other.navigation_id, "Mine")
        await navigations.close()


async def test_a_navigation_that_is_gone_elsewhere_is_forgotten(tmp_path: Path) -> None:
    with other_station(tmp_path) as other:
        library = NavigationLibrary(tmp_path / FOLDER)
        library.open()
        navigations = Navigations(library, Events())
        shutil.rmtree(library.folder(other.navigation_id))
        assert await navigations.look_elsewhere() == []
        assert library.list() == [] and not library.is_elsewhere(other.navigation_id)
        await navigations.close()


def test_two_stations_that_begin_in_the_same_second_have_a_folder_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second one took the first one's for its own that could not be recorded, and removed it."""
    one, two = NavigationLibrary(tmp_path), NavigationLibrary(tmp_path)
    first, recorder = make_navigation(one, lambda path: Recorder(path, min_free_bytes=0), HELLO, "One", "sfm", "attic")
    free = iter([first.id, f"{first.id}-2"])
    monkeypatch.setattr(two, "new_id", lambda: next(free))  # it looked before the first one's folder was there
    second, other = make_navigation(two, lambda path: Recorder(path, min_free_bytes=0), HELLO, "Two", "sfm", "attic")
    assert recorder is not None and other is not None
    recorder.close()
    other.close()
    one.close()
    two.close()
    assert second.id == f"{first.id}-2"
    assert all((tmp_path / made.id / "recording.mcap").is_file() for made in (first, second))
