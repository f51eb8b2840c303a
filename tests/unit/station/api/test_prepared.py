"""Large answers about the map in use are made once for each state of it."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest

from shared.errors import DataError
from station.api.prepared import Prepared
from station.library.active_maps import ActiveMap, numbered
from tests.support.places import make_map


@pytest.mark.asyncio
async def test_an_answer_is_made_once_for_each_state_of_a_map() -> None:
    asked: list[str] = []

    def make(active: ActiveMap) -> bytes:
        asked.append(active.place_map.name)
        return active.place_map.name.encode()

    prepared = Prepared(make)
    before = numbered(make_map(places=1), {})
    after = numbered(replace(before.place_map, name="renamed"), before.numbers)
    assert [(await prepared.response(active)).body for active in (before, before, after)] == [
        before.place_map.name.encode(),
        before.place_map.name.encode(),
        b"renamed",
    ]
    assert asked == [before.place_map.name, "renamed"]


@pytest.mark.asyncio
async def test_who_asks_at_once_waits_for_the_same_answer_and_a_failed_one_is_made_again() -> None:
    asked: list[int] = []

    def make(active: ActiveMap) -> bytes:
        time.sleep(0.05)
        asked.append(len(asked))
        if len(asked) == 1:
            raise DataError("a picture cannot be read")
        return b"{}"

    prepared, active = Prepared(make), numbered(make_map(places=1), {})
    failed = await asyncio.gather(*(prepared.response(active) for _ in range(6)), return_exceptions=True)
    assert all(isinstance(one, DataError) for one in failed) and len(asked) == 1
    answers = await asyncio.gather(*(prepared.response(active) for _ in range(6)))
    assert [answer.body for answer in answers] == [b"{}"] * 6 and len(asked) == 2
