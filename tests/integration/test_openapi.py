"""Whatever is asked of a documented call, right or wrong, the station answers as documented and never breaks.

`benchmarks/bench_openapi.py` asks far more.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from station.api import page
from tests.support.openapi import ENDLESS, ask_everything, furnish
from tests.support.station import running_station
from tests.support.station_at_work import at_work

EXAMPLES = 4  # of each kind, per call
# Of some 100 calls: those that may only refuse, in the state that the calls before leave. Other tests see them succeed;
# ten are of a guided calibration, with and without the robot's name (test_guided_calibration.py).
MAY_REFUSE = 30


async def test_every_documented_call_answers_as_documented(tmp_path: Path) -> None:
    place_map, known = furnish(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": place_map.id})
        asked = await asyncio.to_thread(ask_everything, desk.address, known, EXAMPLES)
        assert not asked.wrong, "\n".join(asked.wrong)
        assert (await desk.http.get("/healthz")).json()["status"] == "ok"
        documented = (await desk.http.get("/openapi.json")).json()["paths"]
    assert len(asked.statuses) == sum(map(len, documented.values())) - len(ENDLESS)
    assert len(asked.never_answered) <= MAY_REFUSE, "\n".join(sorted(asked.never_answered))


async def test_who_asks_for_the_document_again_and_again_keeps_nobody_waiting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running_station(1, tmp_path) as desk:
        document = (await desk.http.get("/openapi.json")).json()
        monkeypatch.setattr(page, "JSONResponse", None)  # encoding it would fail now
        again = await desk.http.get("/openapi.json")
        assert again.json() == document and again.headers["content-type"] == "application/json"
