"""How long what was deleted is kept: a clock that is set takes nothing away."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from station.library.bin import KEEP_S, MAX_KEPT, Bin
from station.library.lived_time import MAX_AWAY_S

DAY_S = 86_400.0
NOW_S = 1.8e9


def opened(folder: Path) -> Bin:
    """As a station does that starts."""
    started = Bin(folder / "bin.json")
    started.open()
    return started


def due(looked_at: Bin) -> set[str]:
    return {entry.id for entry in looked_at.due()}


def test_the_bin_gives_up_what_is_old_or_too_much(tmp_path: Path) -> None:
    full = Bin(tmp_path / "bin.json")
    full.update({"navigation": [("old", "Old")]}, NOW_S, 0.0)
    names = [("old", "Old"), *((f"nav-{n}", f"Drive {n}") for n in range(MAX_KEPT))]
    full.update({"navigation": names}, NOW_S + 10.0, 10.0)
    assert due(full) == {"old"}
    again = opened(tmp_path)
    assert again.list() == full.list()
    again.update({"navigation": names[:2]}, NOW_S + 12.0, 0.0)
    again.update({"navigation": names[:2]}, NOW_S + KEEP_S, KEEP_S - 12.0)
    assert due(again) == {"old"}
    assert [entry.gone_wall_s for entry in again.list()] == [NOW_S + KEEP_S + 10.0, NOW_S + KEEP_S]
    again.update({"navigation": names[:2]}, NOW_S + KEEP_S + 10.0, KEEP_S - 2.0)
    assert due(again) == {"old", "nav-0"}


@pytest.mark.parametrize("jump_s", [8 * DAY_S, 1e9, -1e9])
def test_a_clock_that_jumps_while_the_station_runs_takes_nothing_away(tmp_path: Path, jump_s: float) -> None:
    deleted = {"map": [("flat", "Flat")]}
    running = Bin(tmp_path / "bin.json")
    running.update(deleted, NOW_S, 100.0)
    running.update(deleted, NOW_S + jump_s, 400.0)
    assert due(running) == set()
    assert running.list()[0].gone_wall_s == NOW_S + jump_s + KEEP_S - 300.0


def test_a_clock_that_jumps_before_a_start_takes_away_no_more_than_a_day(tmp_path: Path) -> None:
    deleted = {"map": [("flat", "Flat")]}
    Bin(tmp_path / "bin.json").update(deleted, NOW_S, 100.0)
    for start, clock_s in enumerate((NOW_S + 3e8, 0.0, NOW_S, NOW_S + DAY_S / 2)):
        started = opened(tmp_path)
        started.update(deleted, clock_s, 5.0)
        assert due(started) == set()
        assert started.list()[0].kept_s == MAX_AWAY_S * (1, 1, 2, 2.5)[start]


def test_what_is_deleted_while_the_clock_is_wrong_is_not_taken_for_the_oldest(tmp_path: Path) -> None:
    full = Bin(tmp_path / "bin.json")
    names = [(f"nav-{n}", f"Drive {n}") for n in range(MAX_KEPT + 1)]
    full.update({"navigation": names[:-1]}, NOW_S, 0.0)
    full.update({"navigation": names}, 0.0, 60.0)
    assert full.list()[0].id == names[-1][0] and due(full) == {full.list()[-1].id}


def test_the_bin_of_an_older_station_is_read_and_counted_from_now_on(tmp_path: Path) -> None:
    old = [{"kind": "map", "id": "flat", "name": "Flat", "deleted_wall_s": NOW_S - 6 * DAY_S}]
    (tmp_path / "bin.json").write_bytes(msgspec.json.encode(old))
    started = opened(tmp_path)
    started.update({"map": [("flat", "Flat")]}, NOW_S, 5.0)
    (entry,) = started.list()
    assert (entry.deleted_wall_s, entry.kept_s, entry.gone_wall_s) == (NOW_S - 6 * DAY_S, 0.0, NOW_S + KEEP_S)
