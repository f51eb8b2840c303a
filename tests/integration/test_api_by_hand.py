"""The lines of docs/api.md that a person types, run by a shell as they stand."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.support.station import Desk, store_split_map
from tests.support.station_at_work import at_work, keep_navigation, wait_for

pytestmark = [
    pytest.mark.skipif(shutil.which("curl") is None, reason="the documented lines need curl: apt-get install curl"),
]
DOCS = ROOT / "docs" / "api.md"
NAMES = re.compile(r"\b(ID|OTHER|MAP|PLACE|ROOM|NEXT|DOOR|SECOND|JOB|CMP)\b")


def documented_lines() -> list[str]:
    block = re.search(r"## By hand\n.*?```sh\n(.*?)```", DOCS.read_text(), re.DOTALL)
    assert block is not None
    return [line for line in block[1].splitlines() if line.startswith("curl")]


async def test_every_line_of_the_documentation_does_what_it_says(tmp_path: Path) -> None:
    place_map = store_split_map(tmp_path / "data")
    for name in ("nav-a", "nav-b"):
        keep_navigation(tmp_path / "data", name)
    async with at_work(tmp_path / "data") as (desk, _, _):
        names = {"OTHER": "nav-b", "MAP": place_map.id}
        names |= {"PLACE": place_map.places[0].id, "SECOND": place_map.places[1].id}
        for line in documented_lines():
            if "/stop" in line and "ID" in line:
                await wait_for(desk, f"/navigations/{names['ID']}", lambda drive: drive["frames"] > 10)
            answer = await typed(desk, NAMES.sub(lambda found: names[found[0]], line), tmp_path)
            await take_note(desk, line, answer, names)
    assert (tmp_path / "map.ply").read_bytes().startswith(b"ply")
    assert (tmp_path / "navigation.ply").stat().st_size > 500
    assert (tmp_path / "now.jpg").read_bytes().startswith(b"\xff\xd8")
    assert (tmp_path / "again.mjpg").read_bytes().count(b"image/jpeg") > 0  # a slow station leaves pictures out
    assert (tmp_path / "report.html").read_text().lower().startswith("<!doctype html>")


async def typed(desk: Desk, line: str, folder: Path) -> str:
    """What a line prints. An answer that is an error, but for the end of an endless stream, fails."""
    script = f"S={desk.address}\n" + line.replace(
        "curl ", "curl --silent --show-error --fail-with-body --noproxy '*' ", 1
    )
    shell = await asyncio.create_subprocess_exec(
        "sh", "-c", script, cwd=folder, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    out, err = await shell.communicate()
    is_endless = "stream.mjpg" in line
    assert shell.returncode == (28 if is_endless else 0), f"{line}\n{out.decode()}\n{err.decode()}"
    return out.decode(errors="replace")


async def take_note(desk: Desk, line: str, answer: str, names: dict[str, str]) -> None:
    """The ids that later lines speak of; and what runs in the background is waited for."""
    if "POST $S/navigations " in line:
        names["ID"] = json.loads(answer)["id"]
    elif "/stop" in line and "ID" in line:
        await wait_for(desk, f"/navigations/{names['ID']}", lambda drive: drive["state"] == "ready")
    elif "POST $S/maps " in line or "POST $S/comparisons" in line or "/reprocess" in line:
        names["JOB"] = json.loads(answer)["id"]
        job = await wait_for(desk, f"/jobs/{names['JOB']}", lambda job: job["state"] != "running")
        assert job["state"] == "done", job
        names["CMP"] = str(job["result"].get("comparison", ""))
    elif line.startswith("curl $S/rooms") or "rooms/split" in line:
        names["ROOM"], names["NEXT"] = (room["id"] for room in json.loads(answer))
        (names["DOOR"],) = json.loads(answer)[1]["doors"]
    elif "place/current" in line:
        assert json.loads(answer)["map"] == names["MAP"]
    elif '"id": null' in line:
        assert json.loads(answer) is None
