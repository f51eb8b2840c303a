"""Which recordings go when there are too many or they are too old: a clock that is set takes none away."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from station.config import RecordingConfig
from station.events import Events
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.library.recording_ages import RecordingAges
from station.library.recordings import FinishedRecording, retain_recordings, to_remove

DAY_S = 86_400.0
NOW_S = 1.8e9
LIMITS = RecordingConfig(max_days=30.0)


def test_the_oldest_recordings_go_first() -> None:
    finished = [FinishedRecording(str(day), 0.0, 10, age_s=(5 - day) * DAY_S) for day in range(5)]
    assert to_remove(finished, 0, 0) == []
    assert [r.navigation_id for r in to_remove(finished, 25, 0)] == ["0", "1", "2"]
    assert [r.navigation_id for r in to_remove(finished, 0, 3.5 * DAY_S)] == ["0", "1"]
    assert [r.navigation_id for r in to_remove(finished, 45, 4.5 * DAY_S)] == ["0"]


class Station:
    """Its recordings and its clocks; each start reads anew what is on the disk."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder = folder
        self.wall_s, self.run_s = NOW_S, 0.0
        monkeypatch.setattr(time, "time", lambda: self.wall_s)
        monkeypatch.setattr(time, "monotonic", lambda: self.run_s)
        self.start()

    def start(self) -> None:
        self.library = NavigationLibrary(self._folder)
        self.library.open()

    def record(self) -> Path:
        record = NavigationRecord(self.library.new_id(), "Flat", "ready", self.wall_s, "ukf")
        self.library.store(record)
        path = self.library.recording(record.id)
        path.write_bytes(b"mcap")
        return path

    async def retain(self) -> None:
        await retain_recordings(self.library, LIMITS, Events())


@pytest.mark.parametrize("wrong_s", [-1.7e9, 3e8])
async def test_a_station_that_starts_with_a_clock_off_by_years_removes_no_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong_s: float
) -> None:
    station = Station(tmp_path, monkeypatch)
    before = station.record()
    await station.retain()
    station.wall_s += wrong_s  # an empty battery, and the network is late
    station.start()
    await station.retain()
    since = station.record()
    await station.retain()
    station.wall_s = NOW_S + 100.0  # it has been set right
    await station.retain()
    assert before.exists() and since.exists()


async def test_a_recording_goes_when_the_station_has_lived_long_enough_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    station = Station(tmp_path, monkeypatch)
    old = station.record()
    for day in range(1, 32):
        await station.retain()
        assert old.exists()
        station.wall_s += DAY_S
        station.run_s += DAY_S
        if day == 10:
            young = station.record()
        if day % 7 == 0:  # it is off for an hour
            station.wall_s += 3600.0
            station.run_s = 0.0
            station.start()
    await station.retain()
    assert not old.exists() and young.exists()


async def test_a_recording_in_the_bin_ages_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    station = Station(tmp_path, monkeypatch)
    old = station.record()
    await station.retain()
    station.library.delete(old.parent.name)
    station.wall_s, station.run_s = station.wall_s + 31 * DAY_S, station.run_s + 31 * DAY_S
    await station.retain()
    station.library.restore(old.parent.name)
    assert old.exists()
    await station.retain()
    assert not old.exists()


def test_ages_that_cannot_be_written_are_counted_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ages = RecordingAges(tmp_path / "file" / "ages.json")
    ages.update(["a"], NOW_S, 0.0)
    assert ages.update(["a", "b"], NOW_S + 1e9, 5.0) == {"a": 5.0, "b": 0.0}
