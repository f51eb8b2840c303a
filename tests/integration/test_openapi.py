"""Whatever is asked of a documented call, right or wrong, the station answers as documented and never breaks.

`benchmarks/bench_openapi.py` asks far more.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.integration.test_station import at_work
from tests.openapi_support import ask_everything, furnish

pytestmark = pytest.mark.timeout(900)
EXAMPLES = 4  # of each kind, per call
# May only refuse here, in the state that the calls before leave: test_station*.py see each of them succeed.
MAY_REFUSE = {
    "GET /place/current/images/{t_robot_ns}.jpg",  # named by the time of an answer
    "GET /navigations/{navigation_id}/replay.mjpg",  # the drives here have no recording
    "POST /navigations/{navigation_id}/reprocess",
    "POST /navigations/{navigation_id}/stop",  # nothing is recorded
    "POST /navigations/{navigation_id}/restore",
    "POST /maps",  # one at a time
    "POST /comparisons",
    "GET /jobs/{job_id}",
    "DELETE /jobs/{job_id}",
    "DELETE /maps/{map_id}",  # it is in use
    "POST /maps/{map_id}/restore",
    "POST /pan-tilt",  # the head must rest
}


async def test_every_documented_call_answers_as_documented(tmp_path: Path) -> None:
    place_map, known = furnish(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": place_map.id})
        asked = await asyncio.to_thread(ask_everything, desk.address, known, EXAMPLES)
        assert not asked.wrong, "\n".join(asked.wrong)
        assert (await desk.http.get("/healthz")).json()["status"] == "ok"
        documented = (await desk.http.get("/openapi.json")).json()["paths"]
    assert len(asked.statuses) == sum(map(len, documented.values())) - 1  # all but the endless stream
    assert asked.never_answered <= MAY_REFUSE
