"""Records of navigations, also those that a dead station or an older version left."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from station.files.unwritable import Unwritable
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from tests.support.disk import unwritable


def test_a_navigation_that_a_dead_station_left_is_kept_as_failed(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    assert library.open() == []
    library.store(NavigationRecord(id="nav-1", name="one", state="recording", started_wall_s=1.0, backend="sfm"))
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "record.json").write_text("{")
    again = NavigationLibrary(tmp_path)
    assert [navigation.id for navigation in again.open()] == ["nav-1"]
    assert again.get("nav-1").state == "failed"


def test_a_record_under_its_old_name_still_opens(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    library.store(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))
    (tmp_path / "nav-1" / "record.json").rename(tmp_path / "nav-1" / "drive.json")
    again = NavigationLibrary(tmp_path)
    assert again.open() == []
    assert again.get("nav-1").name == "one"
    again.store(replace(again.get("nav-1"), name="two"))
    assert [path.name for path in (tmp_path / "nav-1").iterdir()] == ["record.json"]
    reopened = NavigationLibrary(tmp_path)
    reopened.open()
    assert reopened.get("nav-1").name == "two"


def test_a_navigation_whose_record_is_lost_is_known_by_its_recording(tmp_path: Path) -> None:
    for name in ("nav-a", "nav-b", ".bin"):
        (tmp_path / name).mkdir()
    (tmp_path / "nav-a" / "recording.mcap").write_bytes(b"x")
    (tmp_path / "nav-a" / "record.json").write_text('{"id": "nav-a", "na')
    interrupted = NavigationLibrary(tmp_path).open()
    assert [(navigation.id, navigation.state) for navigation in interrupted] == [("nav-a", "failed")]
    assert [navigation.id for navigation in NavigationLibrary(tmp_path).open()] == []  # it has a record again


def test_a_copied_folder_is_a_navigation_of_its_own_whatever_id_its_record_has(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    library.store(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))
    shutil.copytree(tmp_path / "nav-1", tmp_path / "nav-1-copy")
    stray = NavigationRecord(id="../out", name="stray", state="recording", started_wall_s=2.0, backend="sfm")
    for folder in (tmp_path / "nav-2", tmp_path / ".bin" / ".hidden"):
        folder.mkdir(parents=True)
        (folder / "record.json").write_bytes(msgspec.json.encode(stray))
    again = NavigationLibrary(tmp_path)
    assert [navigation.id for navigation in again.open()] == ["nav-2"]  # interrupted
    assert [navigation.id for navigation in again.list()] == ["nav-1", "nav-1-copy", "nav-2"]
    again.delete("nav-1-copy")
    assert [navigation.id for navigation in again.deleted()] == ["nav-1-copy"]
    assert (tmp_path / "nav-1").is_dir() and not (tmp_path / "nav-1-copy").exists()


@pytest.mark.parametrize("taken", ["before/navigation", "old"])
def test_a_navigation_whose_exchange_was_cut_by_a_kill_is_there_again(tmp_path: Path, taken: str) -> None:
    library = NavigationLibrary(tmp_path)
    library.store(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))
    old, fresh = (tmp_path / "nav-1" / ".new-x" / name for name in (taken, "fresh"))
    for folder in (old, fresh):
        folder.mkdir(parents=True)
    (old / "navigation.json").touch()
    assert NavigationLibrary(tmp_path).open() == []
    assert (library.navigation_folder("nav-1") / "navigation.json").exists()
    assert sorted(path.name for path in (tmp_path / "nav-1").iterdir()) == ["navigation", "record.json"]


def test_what_cannot_be_deleted_for_good_is_not_said_to_be(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path / "navigations")
    library.store(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))
    library.delete("nav-1")
    with unwritable(tmp_path), pytest.raises(Unwritable):
        library.purge("nav-1")
    assert [navigation.id for navigation in library.deleted()] == ["nav-1"]
    library.purge("nav-1")
    library.purge("nav-1")
    assert library.deleted() == ()


def test_the_bin_is_there_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = NavigationLibrary(tmp_path / "navigations")
    library.open()
    library.store(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", fail)
    library.delete("nav-1")
    assert [navigation.id for navigation in library.deleted()] == ["nav-1"]
