"""Large answers about the map in use are made once for each state of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

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
