"""A client that is slow or stuck slows nobody else, and what waits for it is bounded."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from urllib.parse import urlsplit

import websockets
from hypothesis import given
from hypothesis import strategies as st

from station.events import MAX_WAITING_MESSAGES, MessageHub
from tests.support.link import until
from tests.support.station import Desk, store_map
from tests.support.station_at_work import at_work, wait_for

UPGRADE = (
    "GET {path} HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
STUCK = {
    "reads no events": UPGRADE.replace("{path}", "/ws/events"),
    "acknowledges no picture": UPGRADE.replace("{path}", "/ws/camera"),
    "reads no drive answers": UPGRADE.replace("{path}", "/ws/drive?driver=stuck"),
    "acknowledges no picture of a replay": UPGRADE.replace("{path}", "/ws/replay?navigation={drive}"),
    "reads no replay": "GET /navigations/{drive}/replay.mjpg HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "reads no stream": "GET /camera/stream.mjpg HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "reads no cloud": "GET /maps/{map}/landmarks HTTP/1.1\r\nHost: {host}\r\n\r\n" * 20,
    "sends half a request": "POST /drive HTTP/1.1\r\nHost: {host}\r\nContent-Length: 1000\r\n\r\n{",
    "sends half a header": "GET /rob",
}


def stuck_client(desk: Desk, text: str, **names: str) -> socket.socket:
    """Says this, and never reads: its receive window is as small as can be."""
    address = urlsplit(desk.address)
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # before connecting; the kernel makes it its least
    client.connect((address.hostname, address.port))
    for name, value in {"host": address.netloc, **names}.items():
        text = text.replace(f"{{{name}}}", value)
    client.sendall(text.encode())
    return client


async def recorded(desk: Desk) -> str:
    """The id of a drive with a recording."""
    drive: str = (await desk.http.post("/navigations")).json()["id"]
    await wait_for(desk, f"/navigations/{drive}", lambda d: d["frames"] > 10)
    await desk.http.post(f"/navigations/{drive}/stop")
    await wait_for(desk, f"/navigations/{drive}", lambda d: d["state"] == "ready")
    return drive


async def test_stuck_clients_of_every_kind_slow_nobody(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path) as (desk, bench, film):
        await desk.http.put("/maps/active", json={"id": place_map.id})
        drive = await recorded(desk)
        stuck = [stuck_client(desk, text, map=place_map.id, drive=drive) for text in STUCK.values() for _ in range(3)]
        try:
            async with (
                websockets.connect(desk.socket("/ws/events")) as events,
                websockets.connect(desk.socket("/ws/camera")) as camera,
                websockets.connect(desk.socket(f"/ws/replay?navigation={drive}")) as replay,
                websockets.connect(desk.socket("/ws/drive?driver=quick")) as wheel,
            ):
                for number in range(600):  # more than any queue holds
                    desk.station.events.notify("robot", f"line {number}")
                lines = set()
                while "line 599" not in lines:
                    message = json.loads(await events.recv())
                    if message["type"] == "log":
                        lines.add(message["line"]["text"])
                # Now, before those that answer no ping are sent away.
                waiting = [len(reader._line) for reader in desk.station.first.events.hub._readers]
                assert waiting and max(waiting) <= MAX_WAITING_MESSAGES
                seen = film.count
                while film.count < seen + 20:
                    await camera.recv()
                    await camera.send("next")
                    assert (await desk.http.get("/robot")).status_code == 200
                async for _ in replay:  # to its end
                    await replay.send("next")
                await wheel.send(json.dumps({"type": "drive", "seq": 1, "linear": 0.1, "angular": 0.0, "ttl_ms": 500}))
                await until(lambda: bench.motors.history and bench.motors.history[-1][1] > 0)
        finally:
            for client in stuck:
                client.close()
        await until(
            lambda: desk.station.first.events.hub.num_readers == 0 and desk.station.first.camera.num_readers == 0
        )


@given(puts=st.lists(st.tuples(st.sampled_from(["", "a", "b"]), st.integers()), max_size=400))
async def test_what_waits_is_bounded_and_the_newest_is_never_lost(puts: list[tuple[str, int]]) -> None:
    hub: MessageHub[tuple[str, int]] = MessageHub()
    with hub.subscribe() as slow, hub.subscribe() as quick:
        got = []
        for topic, value in puts:
            hub.put((topic, value), topic)
            got.append(await quick.get())
        assert got == puts  # whatever the slow one does
        assert len(slow._line) + len(slow._topics) <= MAX_WAITING_MESSAGES + 2
        newest = {topic: (topic, value) for topic, value in puts if topic}
        late = [await slow.get() for _ in range(len(slow._line) + len(slow._topics))]
        assert [m for m in late if not m[0]] == [m for m in puts if not m[0]][-MAX_WAITING_MESSAGES:]
        assert {m[0]: m for m in late if m[0]} == newest
