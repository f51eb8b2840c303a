"""Who is let in to the API, and how much of it one may take; no socket, no running station."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

import station.api.limits
import station.api.replay
import station.api.robot
import station.api.streams
import station.errors
from shared.mcap_recording import RecordedPicture
from shared.messages import CameraFrame
from station.access.visitors import EVERYBODY
from station.api.limits import MAX_BODY_BYTES, TRY_AGAIN_LATER, UNSUPPORTED
from station.api.server import make_api
from station.app import Station
from station.config import AccessConfig, ApiConfig, StationConfig, load_config
from station.robots.session import SeenFrame
from tests.support.link import until


def asking(tmp_path: Path, api: ApiConfig | None = None) -> httpx.AsyncClient:
    # Who may is not asked here (test_access_http.py does), only under which name and from which page.
    config = StationConfig(data_dir=tmp_path, api=api or ApiConfig(), access=AccessConfig(insecure=True))
    app = make_api(Station(config))
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://127.0.0.1:8080")


OURS = ["127.0.0.1:8080", "localhost:8080", "LocalHost", "localhost.:8080", "[::1]:8080"]


@pytest.mark.parametrize("host", OURS)
async def test_loopback_names_are_ours_with_and_without_an_origin(tmp_path: Path, host: str) -> None:
    async with asking(tmp_path) as http:
        assert (await http.get("/healthz", headers={"Host": host})).status_code == 200
        own = await http.get("/healthz", headers={"Host": host, "Origin": f"http://{host}"})
        assert own.status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "null"},  # a sandboxed frame, a file
        {"Origin": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:8081"},  # another program on this machine
        {"Host": "evil.example:8080", "Origin": "http://evil.example:8080"},  # DNS rebinding
        {"Host": "evil.example"},  # the same with a call that carries no Origin
        {"Host": ""},
        {"Host": "[::1"},
        {"Host": "127.0.0.1.evil.example"},
        {"Host": "192.168.1.20:8080"},  # we do not listen there
    ],
)
@pytest.mark.parametrize(("method", "path"), [("POST", "/stop"), ("GET", "/robot")])
async def test_pages_of_others_are_refused(tmp_path: Path, headers: dict[str, str], method: str, path: str) -> None:
    async with asking(tmp_path) as http:
        answer = await http.request(method, path, headers=headers)
        assert answer.status_code == 403 and answer.json()["type"] == "/problems/not-allowed"


async def test_names_from_the_settings_and_the_bind_address_are_ours(tmp_path: Path) -> None:
    settings = tmp_path / "station.toml"
    settings.write_text('[api]\nhost = "192.168.1.20"\nallowed_hosts = ["Robots.local"]\n')
    api = load_config(settings).api
    async with asking(tmp_path, api) as http:
        for host, status in {"robots.local:8080": 200, "192.168.1.20:8080": 200, "192.168.1.21": 403}.items():
            assert (await http.get("/healthz", headers={"Host": host})).status_code == status


async def test_who_listens_everywhere_is_reached_by_any_address_but_not_by_any_name(tmp_path: Path) -> None:
    async with asking(tmp_path, ApiConfig(host="0.0.0.0")) as http:
        for host, status in {"192.168.1.20:8080": 200, "[fe80::1]:8080": 200, "evil.example": 403}.items():
            assert (await http.get("/healthz", headers={"Host": host})).status_code == status


async def test_a_body_beyond_the_limit_is_refused_said_or_unsaid(tmp_path: Path) -> None:
    async def unsaid() -> AsyncIterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65536 + 1):
            yield bytes(65536)

    async with asking(tmp_path) as http:
        for content in (b"x" * (MAX_BODY_BYTES + 1), unsaid()):
            answer = await http.post("/maps", content=content, headers={"Content-Type": "application/json"})
            assert answer.status_code == 413 and answer.json()["type"] == "/problems/too-large"
        small = await http.post("/maps", content=b"x" * 1000, headers={"Content-Type": "application/json"})
        assert small.status_code == 422


async def test_a_body_has_no_room_for_so_many_mistakes_that_others_wait(tmp_path: Path) -> None:
    async with asking(tmp_path) as http:
        mistakes = {f"k{number}": 1 for number in range(10_000)}  # a third of a second on a small machine
        assert (await http.post("/drive", json=mistakes)).status_code == 413
        fewer = await http.post("/drive", json={f"k{number}": 1 for number in range(1000)})
        assert fewer.status_code == 422 and len(fewer.json()["errors"]) == 1


class Peer:
    """The other end of one of the app's WebSockets."""

    def __init__(self, app: FastAPI, path: str, query: bytes = b"") -> None:
        self.said: list[Any] = []  # by the app
        self._heard: asyncio.Queue[Any] = asyncio.Queue()
        scope = {
            "type": "websocket",
            "path": path,
            "raw_path": path.encode(),
            "query_string": query,
            "headers": [(b"host", b"127.0.0.1:8080")],
            "subprotocols": [],
            "scheme": "ws",
            "server": ("127.0.0.1", 8080),
            "client": ("127.0.0.1", 50_000),
        }
        self._heard.put_nowait({"type": "websocket.connect"})
        self._task = asyncio.create_task(app(scope, self._heard.get, self._take))

    async def _take(self, message: Any) -> None:
        self.said.append(message)

    @property
    def closed(self) -> tuple[int, str] | None:
        """Code and sentence, once the app has closed the socket."""
        return next(((m["code"], m["reason"]) for m in self.said if m["type"] == "websocket.close"), None)

    def say(self, **message: Any) -> None:
        self._heard.put_nowait({"type": "websocket.receive", **message})

    async def leave(self) -> None:
        self._heard.put_nowait({"type": "websocket.disconnect", "code": 1000})
        await self._task  # no error came out of it


@pytest.mark.parametrize("path", ["/ws/drive", "/ws/camera"])
async def test_a_binary_message_closes_a_text_socket_with_a_sentence(tmp_path: Path, path: str) -> None:
    peer = Peer(make_api(Station(StationConfig(data_dir=tmp_path))), path)
    peer.say(bytes=b"\x00")
    await until(lambda: peer.closed)
    assert peer.closed == (UNSUPPORTED, "this socket takes text, not binary messages")
    await peer.leave()


async def test_a_drive_socket_that_ends_lets_go_although_what_is_said_on_it_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, released = Station(StationConfig(data_dir=tmp_path)), list[str]()
    driving = here.first.driving
    monkeypatch.setattr(station.api.robot, "_now_ms", lambda: 1 // 0)
    monkeypatch.setattr(type(driving), "driver", property(lambda _: "anna"))
    monkeypatch.setattr(driving, "release", released.append)
    peer = Peer(make_api(here), "/ws/drive", b"driver=anna")
    await until(lambda: peer.said)
    with pytest.raises(ZeroDivisionError):
        await peer.leave()
    assert released == ["anna"]


@pytest.mark.parametrize("path", ["/ws/drive", "/ws/camera", "/ws/events"])
async def test_one_socket_too_many_is_told_and_closed(
    tmp_path: Path, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station.api.limits, "MAX_SOCKETS", 1)
    app = make_api(Station(StationConfig(data_dir=tmp_path)))
    first = Peer(app, path)
    await until(lambda: first.said)
    second = Peer(app, path)
    await until(lambda: second.closed)
    assert second.closed is not None and second.closed[0] == TRY_AGAIN_LATER and "close one" in second.closed[1]
    assert first.closed is None
    await first.leave()
    await second.leave()
    third = Peer(app, path)  # the first one's seat
    await until(lambda: third.said)
    await third.leave()
    assert third.closed is None


async def test_one_video_stream_too_many_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station.api.streams, "MAX_STREAMS", 0)
    here = Station(StationConfig(data_dir=tmp_path))
    frame = CameraFrame(seq=1, t_robot_ns=1, exposure_ns=0, width=1, height=1, skipped=0, jpeg=b"jpeg")
    here.first.camera.put(SeenFrame(frame, 1, None))
    transport = httpx.ASGITransport(make_api(here))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8080") as http:
        answer = await http.get("/camera/stream.mjpg")
        assert answer.status_code == 503 and answer.json()["type"] == "/problems/busy"
        by_name = await http.get(f"/robots/{here.first.name}/camera/stream.mjpg")  # the same robot: the same seats
        assert by_name.json()["detail"] == answer.json()["detail"]


async def test_streams_of_all_recordings_share_their_seats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each reads a file and runs threads for it; there may be hundreds of navigations."""

    async def pictures(*_: object) -> AsyncGenerator[RecordedPicture, None]:
        while True:
            yield RecordedPicture(number=1, t_robot_ns=1, since_first_s=0.0, jpeg=b"jpeg")

    monkeypatch.setattr(station.api.streams, "MAX_STREAMS", 0)
    monkeypatch.setattr(station.api.replay, "replay", pictures)
    monkeypatch.setattr(station.api.replay, "_recording", lambda *_: tmp_path)
    transport = httpx.ASGITransport(make_api(Station(StationConfig(data_dir=tmp_path))))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8080") as http:
        answers = [(await http.get(f"/navigations/{name}/replay.mjpg")).json() for name in ("nav-1", "nav-2")]
    assert [answer["type"] for answer in answers] == ["/problems/busy"] * 2
    assert answers[0]["detail"] == answers[1]["detail"]


async def test_seats_of_one_kind_are_counted_and_given_back() -> None:
    seats = station.api.limits.SeatsByKind()
    async with seats.take("a", 1, 1, EVERYBODY), seats.take("b", 1, 1, EVERYBODY):
        with pytest.raises(station.errors.Busy, match="1 viewers of a"):
            await seats.take("a", 1, 1, EVERYBODY).__aenter__()
    async with seats.take("a", 1, 1, EVERYBODY):
        pass
