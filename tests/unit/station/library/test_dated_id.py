"""Ids from the clock on the wall are free."""

from __future__ import annotations

import re
import time

import pytest

from station.library.dated_id import free_dated_id


def test_an_id_says_its_kind_and_time_and_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.localtime(1_800_000_000)
    monkeypatch.setattr(time, "localtime", lambda: now)
    taken: set[str] = set()
    for _ in range(3):
        taken.add(free_dated_id("nav", taken.__contains__))
    first, *others = sorted(taken)
    assert re.fullmatch(r"nav-\d{8}-\d{6}", first) and others == [f"{first}-2", f"{first}-3"]
