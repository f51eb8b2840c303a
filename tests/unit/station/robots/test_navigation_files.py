"""A navigation that was begun is there after a power cut: its folder, its recording's name and its record."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from station.library.navigation_records import NavigationLibrary
from station.recordings.recorder import Recorder
from station.robots.navigation_files import make_navigation
from tests.support.recordings import HELLO


def test_the_names_of_a_new_navigation_are_flushed_up_to_the_data_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[Path] = []
    monkeypatch.setattr(os, "fsync", lambda fd: flushed.append(Path(os.readlink(f"/proc/self/fd/{fd}"))))
    library = NavigationLibrary(tmp_path / "data" / "navigations")
    library.open()
    assert flushed == [tmp_path, tmp_path / "data", tmp_path / "data" / "navigations"]  # the last for the bin
    del flushed[:]
    navigation, recorder = make_navigation(
        library, lambda path: Recorder(path, min_free_bytes=0), HELLO, "Flat", "sfm", "attic"
    )
    assert recorder is not None
    recorder.close()
    folder = library.folder(navigation.id)
    assert {folder.parent, folder} <= set(flushed)
    library.close()
