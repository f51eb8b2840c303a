"""One token takes no more seats than its share, and whoever may drive never waits behind who only watches."""

from __future__ import annotations

import asyncio
import contextlib
from contextlib import AsyncExitStack
from pathlib import Path

import pytest
import websockets

import shared.session
from shared.access import Role, Token
from shared.messages import ErrorNotice, Refusal, Welcome
from shared.token_book import TokenBook
from station.api import connections
from station.api.limits import MAX_SOCKETS, REPLACED, SOCKETS_PER_TOKEN
from tests.support.access import JOIN, GuardedBench, Talk, guarded_robot, guarded_station, make_token, talking
from tests.support.link import running_robot, until
from tests.support.station import Film


async def join(bench: GuardedBench, stack: AsyncExitStack, token: Token) -> Talk:
    """A station that has said who it is and what it wants."""
    talk = await stack.enter_async_context(talking(bench))
    talk.say(talk.prove(token, await talk.hear_hello()))
    talk.say(JOIN)
    return talk


async def test_one_watch_token_keeps_the_owner_of_a_robot_not_out(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench, AsyncExitStack() as stack:
        watch, owner = make_token(bench, Role.WATCH, "guest"), make_token(bench, Role.DRIVE, "owner")
        guests = [await join(bench, stack, watch) for _ in range(2 * bench.config.server.max_stations)]
        for guest in guests:
            assert isinstance(await guest.hear(), Welcome)  # the newest, too
        assert isinstance(await (await join(bench, stack, owner)).hear(), Welcome)
        last = await guests[0].hear()
        assert isinstance(last, ErrorNotice) and last.fatal and "place" in last.message


async def test_at_a_robot_full_of_watching_stations_one_yields_to_who_drives_and_none_to_who_watches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared.session, "QUIET_AFTER_NS", 60_000_000_000)  # a silent one would yield to anybody
    monkeypatch.setattr(shared.session, "CLOSE_AFTER_NS", 120_000_000_000)
    async with guarded_robot(tmp_path) as bench, AsyncExitStack() as stack:
        for n in range(bench.config.server.max_stations):
            guest = await join(bench, stack, make_token(bench, Role.WATCH, f"guest {n}"))
            assert isinstance(await guest.hear(), Welcome)
        late = await join(bench, stack, make_token(bench, Role.WATCH, "late"))
        assert isinstance(await late.hear(), Refusal)
        for role in (Role.DRIVE, Role.ADMIN):
            assert isinstance(await (await join(bench, stack, make_token(bench, role, role.value))).hear(), Welcome)


async def hear_reports(talk: Talk, count: int) -> None:
    """Each is sent after robot-server has looked who is silent."""
    for _ in range(count):
        await talk.hear_report()


async def test_a_silent_station_that_may_drive_yields_to_one_that_may_too_and_not_to_one_that_watches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared.session, "QUIET_AFTER_NS", 0)
    monkeypatch.setattr(shared.session, "CLOSE_AFTER_NS", 120_000_000_000)
    async with guarded_robot(tmp_path, max_stations=1) as bench, AsyncExitStack() as stack:
        driver = await join(bench, stack, make_token(bench, Role.DRIVE, "driver"))
        assert isinstance(await driver.hear(), Welcome)
        await hear_reports(driver, 3)
        watcher = await join(bench, stack, make_token(bench, Role.WATCH, "watcher"))
        assert isinstance(await watcher.hear(), Refusal)
        await hear_reports(driver, 3)
        owner = await join(bench, stack, make_token(bench, Role.ADMIN, "owner"))
        assert isinstance(await owner.hear(), Welcome)
        last = await driver.hear()
        assert isinstance(last, ErrorNotice) and last.fatal and "silent" in last.message


async def code_at_the_end(socket: websockets.ClientConnection) -> int | None:
    with contextlib.suppress(websockets.ConnectionClosed):
        while True:
            await socket.recv()
    return socket.close_code


@pytest.mark.parametrize("path", ["/ws/events", "/ws/camera", "/robots/robot-1/ws/events"])
async def test_one_watch_token_keeps_nobody_from_the_pages_sockets(tmp_path: Path, path: str) -> None:
    async with (
        running_robot() as bench,
        guarded_station(tmp_path, bench.port) as station,
        AsyncExitStack() as stack,
    ):
        filming = asyncio.create_task(Film(bench).run())
        await until(lambda: station.desk.station.first.camera.newest)
        guest, owner = station.headers(Role.WATCH), station.headers(Role.DRIVE)
        guests = [
            await stack.enter_async_context(station.socket(path, additional_headers=guest))
            for _ in range(MAX_SOCKETS + 4)
        ]
        async with station.socket(path, additional_headers=owner) as mine, asyncio.timeout(60):
            assert await mine.recv()
            assert await guests[-1].recv()
            replaced = await asyncio.gather(*(code_at_the_end(socket) for socket in guests[:-SOCKETS_PER_TOKEN]))
            assert set(replaced) == {REPLACED}
            assert await mine.recv() if "events" in path else True
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)


async def test_sessions_of_one_token_share_its_places(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station, AsyncExitStack() as stack:
        book = TokenBook(station.folder)
        record = book.find(station.tokens[Role.WATCH], 1.0)
        assert record is not None
        sockets = []
        for _ in range(SOCKETS_PER_TOKEN + 1):
            session = book.add_for(record, "session", 1.0, 1e12).text
            shown = {"Authorization": f"Bearer {session}"}
            sockets.append(await stack.enter_async_context(station.socket("/ws/events", additional_headers=shown)))
        async with asyncio.timeout(60):
            assert await code_at_the_end(sockets[0]) == REPLACED
            assert await sockets[1].recv()


async def test_a_streams_newest_viewer_replaces_the_oldest_of_its_token(tmp_path: Path) -> None:
    async with (
        running_robot() as bench,
        guarded_station(tmp_path, bench.port) as station,
        AsyncExitStack() as stack,
    ):
        filming = asyncio.create_task(Film(bench).run())
        await until(lambda: station.desk.station.first.camera.newest)
        http, guest, owner = station.desk.http, station.headers(Role.WATCH), station.headers(Role.ADMIN)
        url = "/camera/stream.mjpg"
        videos = [await stack.enter_async_context(http.stream("GET", url, headers=guest)) for _ in range(20)]
        mine = await stack.enter_async_context(http.stream("GET", url, headers=owner))
        assert {video.status_code for video in (*videos, mine)} == {200}
        assert await anext(mine.aiter_bytes())
        async with asyncio.timeout(60):
            async for _ in videos[0].aiter_bytes():
                pass
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)


async def test_of_one_tokens_connections_the_oldest_ends_for_the_newest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "CONNECTIONS_PER_TOKEN", 3)
    async with guarded_station(tmp_path) as station, AsyncExitStack() as stack:
        guest = station.headers(Role.WATCH)
        drive = await stack.enter_async_context(
            station.socket("/ws/drive", additional_headers=station.headers(Role.DRIVE))
        )
        sockets = [
            await stack.enter_async_context(station.socket("/ws/events", additional_headers=guest)) for _ in range(4)
        ]
        async with asyncio.timeout(60):
            assert await code_at_the_end(sockets[0]) == 1006  # ended without a word
            assert await sockets[1].recv()
            assert await drive.recv()
