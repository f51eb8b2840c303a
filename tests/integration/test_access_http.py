"""HTTP and WebSockets with access control, over real sockets and real TLS: every call, for every role and for none."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from pathlib import Path

import httpx
import pytest
import websockets

from shared.access import Role, Token
from shared.token_book import TokenBook, TokenRecord
from station.api.doorkeeper import COOKIE, REVOKED
from station.api.roles import ROLES
from station.api.server import all_calls
from tests.support.access import Guarded, guarded_station
from tests.support.link import running_robot, until
from tests.support.station import Film, running_station

KEPT_S = 5.0  # an idle connection, by uvicorn
SOCKETS = {"/ws/events": "", "/ws/camera": "", "/ws/drive": "", "/ws/replay": "?navigation=none"}
SOCKETS |= {f"/robots/{{robot}}/ws/{kind}": "" for kind in ("events", "camera", "drive")}


def is_problem(answer: httpx.Response, status: int) -> bool:
    document = answer.json()
    return (
        answer.status_code == status == document["status"]
        and answer.headers["content-type"] == "application/problem+json"
        and len(document["detail"]) > 5
    )


async def call(station: Guarded, name: str, role: Role | None) -> httpx.Response:
    """A call with made-up values: whether it is refused is decided before they are looked at."""
    method, _, path = name.partition(" ")
    for part in ("{name}", "{kind}", "{t_robot_ns}", "{keyframe}"):
        path = path.replace(part, "1")
    path = path.replace("{token_id}", "none").replace("{robot}", "robot-1").replace("{", "").replace("}", "")
    return await station.desk.http.request(method, path, headers=station.headers(role))


async def test_every_call_is_refused_to_strangers_and_to_roles_that_may_not(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        http = station.desk.http
        document = (await http.get("/openapi.json", headers=station.headers(Role.WATCH))).json()
        documented = {
            f"{method.upper()} {path}": call
            for path, calls in document["paths"].items()
            for method, call in calls.items()
        }
        served = {name for name in ROLES if not name.startswith("WS ")}
        hidden = served - documented.keys()
        assert documented.keys() <= served
        assert hidden == {"GET /", "GET /assets/{name}", "GET /favicon.ico", "GET /favicon.svg", "GET /openapi.json",
                          "GET /docs", "GET /docs/start.js", "GET /docs/{name}"}  # fmt: skip
        for name in sorted(served):
            needed = ROLES[name]
            if name in documented:
                assert documented[name]["x-role"] == (needed.value if needed else None)
                assert {"401", "403", "429"} <= documented[name]["responses"].keys()
            answer = await call(station, name, None)
            assert is_problem(answer, 401) if needed else answer.status_code not in (401, 403), name
            if needed is not None:
                assert answer.headers["www-authenticate"] == "Bearer"
            for role in Role:
                if needed is None:
                    continue
                answer = await call(station, name, role)
                if role.includes(needed):
                    assert answer.status_code not in (401, 403), f"{name} as {role}"
                else:
                    assert is_problem(answer, 403), f"{name} as {role}"


def test_the_table_of_roles_has_no_row_without_a_call() -> None:
    assert set(ROLES) == set(all_calls())
    assert {name.partition(" ")[2] for name in ROLES if name.startswith("WS ")} == set(SOCKETS)
    assert [name for name, role in ROLES.items() if role is None] == [
        "GET /", "GET /assets/{name}", "GET /favicon.svg", "GET /favicon.ico", "POST /login"
    ]  # fmt: skip


@pytest.mark.parametrize("path", SOCKETS)
async def test_every_socket_is_refused_to_strangers_and_to_roles_that_may_not(tmp_path: Path, path: str) -> None:
    needed = ROLES[f"WS {path}"]
    assert needed is not None
    async with guarded_station(tmp_path) as station:
        for role in (None, *Role):
            opening = station.socket(
                path.replace("{robot}", "robot-1") + SOCKETS[path], additional_headers=station.headers(role)
            )
            if role is not None and role.includes(needed):
                async with opening:
                    continue
            with pytest.raises(websockets.InvalidStatus) as refused:
                await opening
            assert refused.value.response.status_code == (401 if role is None else 403)
            assert json.loads(refused.value.response.body)["type"].startswith("/problems/")


async def test_a_login_gives_a_cookie_that_scripts_and_other_sites_cannot_use(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        http, own = station.desk.http, {"Origin": station.origin}
        answer = await http.post("/login", json={"token": station.tokens[Role.DRIVE]}, headers=own)
        assert answer.json() == {"controlled": True, "name": "driveer", "role": "drive"}
        cookie = answer.headers["set-cookie"].lower()
        assert {"httponly", "secure", "samesite=strict", "path=/"} <= {part.strip() for part in cookie.split(";")}
        assert station.tokens[Role.DRIVE] not in answer.text + cookie
        assert (await http.get("/session")).json()["role"] == "drive"  # by the cookie
        assert (await http.post("/drive/release", headers=own)).status_code == 200
        # The browser's cookie, but no page of ours: no Origin, another one, a page without one
        assert is_problem(await http.post("/drive/release"), 403)
        other_port = station.origin.rpartition(":")[0] + ":1"
        for foreign in ("https://evil.example", "null", "", "[", other_port, station.origin.replace("https", "http")):
            assert is_problem(await http.post("/drive/release", headers={"Origin": foreign}), 403)
            assert is_problem(await http.get("/robot", headers={"Origin": foreign}), 403)
        assert is_problem(await http.get("/robot", headers={"Host": "evil.example"}), 403)
        assert (await http.post("/logout", headers=own)).status_code == 204
        assert is_problem(await http.get("/session"), 401)


def looking_meanwhile(station: Guarded, monkeypatch: pytest.MonkeyPatch, *also: str) -> None:
    """Revoking takes its time, and revoked tokens, these too, are looked for in the middle of it."""
    door, loop = station.desk.station.access.door, asyncio.get_running_loop()
    revoke = door.book.revoke

    def slowly(name_or_id: str, now_s: float) -> list[TokenRecord]:
        ended = revoke(name_or_id, now_s)
        for name in also:
            revoke(name, now_s)
        loop.call_soon_threadsafe(door.look)
        time.sleep(0.1)
        return ended

    monkeypatch.setattr(door.book, "revoke", slowly)


async def test_who_logs_out_is_answered_also_while_revoked_tokens_are_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with guarded_station(tmp_path) as station:
        looking_meanwhile(station, monkeypatch)
        http, own = station.desk.http, {"Origin": station.origin}
        await http.post("/login", json={"token": station.tokens[Role.WATCH]}, headers=own)
        assert (await http.post("/logout", headers=own)).status_code == 204


async def test_who_is_revoked_before_the_answer_begins_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with guarded_station(tmp_path) as station:
        looking_meanwhile(station, monkeypatch, "adminer")
        answer = await station.desk.http.delete("/access/tokens/watcher", headers=station.headers(Role.ADMIN))
        assert is_problem(answer, 401) and "was revoked" in answer.text


async def test_a_socket_by_cookie_needs_our_own_page(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        own = {"Origin": station.origin}
        await station.desk.http.post("/login", json={"token": station.tokens[Role.WATCH]}, headers=own)
        cookie = {"Cookie": f"{COOKIE}={station.desk.http.cookies[COOKIE]}"}
        async with station.socket("/ws/events", additional_headers=cookie, origin=station.origin):
            pass
        for origin in (None, "https://evil.example", "null"):
            with pytest.raises(websockets.InvalidStatus) as refused:
                await station.socket("/ws/events", additional_headers=cookie, origin=origin)
            assert refused.value.response.status_code == 403


async def test_wrong_tokens_are_refused_and_then_the_address_waits(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        http = station.desk.http
        old_page = {"Authorization": "Bearer the-same-wrong-one"}
        for _ in range(30):
            assert is_problem(await http.get("/robot", headers=old_page), 401)
        for n in range(9):
            assert is_problem(await http.post("/login", json={"token": f"guess {n}"}), 401)
        answer = await http.get("/robot", headers={"Authorization": f"Bearer {Token.new().text}"})
        assert is_problem(answer, 429) and 0 < int(answer.headers["retry-after"]) <= 60
        # Whose token is right waits for nobody, least of all to stop the robot (there is none here: 503).
        assert (await http.get("/robot", headers=station.headers(Role.ADMIN))).status_code == 200
        assert is_problem(await http.post("/stop", headers=station.headers(Role.WATCH)), 503)


async def code_at_the_end(socket: websockets.ClientConnection) -> int | None:
    with contextlib.suppress(websockets.ConnectionClosed):
        while True:
            await socket.recv()
    return socket.close_code


async def test_a_revoked_token_loses_its_sockets_and_streams_at_once(tmp_path: Path) -> None:
    async with running_robot() as bench, guarded_station(tmp_path, bench.port) as station:
        filming = asyncio.create_task(Film(bench).run())
        http, stolen = station.desk.http, station.headers(Role.DRIVE)
        await until(lambda: station.desk.station.first.camera.newest)
        async with (
            station.socket("/ws/drive", additional_headers=stolen) as driving,
            station.socket("/ws/events", additional_headers=stolen) as events,
            station.socket("/ws/events", additional_headers=station.headers(Role.WATCH)) as others,
            http.stream("GET", "/camera/stream.mjpg", headers=stolen) as video,
        ):
            pictures = video.aiter_bytes()
            await anext(pictures)
            order = json.dumps({"type": "drive", "seq": 1, "linear": 0.2, "angular": 0.0})
            while not bench.motors.history or bench.motors.are_off:
                await driving.send(order)
                await asyncio.sleep(0.02)
            TokenBook(station.folder).revoke("driveer", 1.0)  # as `station access revoke` does, in another process
            async with asyncio.timeout(60):
                for socket in (driving, events):
                    assert await code_at_the_end(socket) == REVOKED
                async for _ in pictures:
                    pass
                await until(lambda: bench.motors.are_off)
            assert is_problem(await http.get("/robot", headers=stolen), 401)
            await others.recv()
            assert (await http.get("/robot", headers=station.headers(Role.WATCH))).status_code == 200
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)


async def test_the_connection_of_a_revoked_stream_ends_and_is_not_kept_for_more(tmp_path: Path) -> None:
    """Programs that know nothing of chunks (a player, `curl` into a file) see the end of the connection alone."""
    async with running_robot() as bench, guarded_station(tmp_path, bench.port) as station:
        filming = asyncio.create_task(Film(bench).run())
        await until(lambda: station.desk.station.first.camera.newest)
        address = httpx.URL(station.desk.address)
        reader, writer = await asyncio.open_connection(address.host, address.port, ssl=station.context, limit=2**24)
        token = station.headers(Role.WATCH)["Authorization"]
        writer.write(f"GET /camera/stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {token}\r\n\r\n".encode())
        await reader.readuntil(b"sentinel-frame\r\n")
        TokenBook(station.folder).revoke("watcher", 1.0)
        await reader.readuntil(b"\r\n0\r\n\r\n")  # the last chunk
        ended_s = time.monotonic()
        assert await reader.read() == b""
        assert time.monotonic() - ended_s < KEPT_S / 2, "the connection was kept for another request"
        writer.close()
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)


@pytest.mark.parametrize("hosts", [("127.0.0.1", "evil.example"), ("evil.example", "127.0.0.1"), ("127.0.0.1",) * 2])
@pytest.mark.parametrize("path", ["/robot", "/ws/events"])
async def test_a_request_of_two_hosts_is_refused(tmp_path: Path, hosts: tuple[str, str], path: str) -> None:
    upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    async with running_station(1, tmp_path) as desk:
        address = httpx.URL(desk.address)
        reader, writer = await asyncio.open_connection(address.host, address.port)
        head = [f"GET {path} HTTP/1.1", *(f"Host: {host}" for host in hosts)]
        key = f"{upgrade}Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n" if path.startswith("/ws") else ""
        writer.write(("\r\n".join(head) + f"\r\n{key}\r\n").encode())
        answer = await reader.read()
        assert answer.startswith(b"HTTP/1.1 4"), answer[:200]
        writer.close()


async def test_who_only_watches_takes_back_nobodys_stop_under_the_drivers_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running_robot() as bench, guarded_station(tmp_path, bench.port) as station:
        http, robot = station.desk.http, station.desk.station.first
        await until(lambda: robot.state.connected)
        now_ns = time.monotonic_ns()
        monkeypatch.setattr(robot.driving, "_now_ns", lambda: now_ns)  # nobody is silent
        order = {"linear": 0.2, "angular": 0.0, "ttl_ms": 1000}
        anna, ben = ({"X-Driver": name, **station.headers(Role.DRIVE)} for name in ("anna", "ben"))
        await http.post("/drive", json=order, headers=anna)
        await http.post("/stop", headers=ben)
        for name in ("anna", "x" * 10_000):
            watcher = {"X-Driver": name, **station.headers(Role.WATCH)}
            assert (await http.post("/stop", headers=watcher)).status_code == 200
        assert is_problem(await http.post("/drive", json=order, headers=anna), 409)  # she holds on
        await http.post("/stop", headers={"X-Driver": "y" * 10_000, **station.headers(Role.DRIVE)})
        told = [line.text for line in robot.events.log if "stopped" in line.text]
        assert told[1] == "watcher, who watches stopped the robot" and max(map(len, told)) < 100


async def test_tokens_are_made_listed_and_revoked_over_http(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        http, admin = station.desk.http, station.headers(Role.ADMIN)
        made = await http.post("/access/tokens", json={"name": "display", "role": "watch"}, headers=admin)
        assert made.status_code == 201
        token = {"Authorization": f"Bearer {made.json()['token']}"}
        assert (await http.get("/session", headers=token)).json()["name"] == "display"
        twice = await http.post("/access/tokens", json={"name": "display", "role": "watch"}, headers=admin)
        assert is_problem(twice, 409)
        for order in ({"name": "day", "role": "watch", "days": True}, {"name": "ev\u202eil", "role": "watch"}):
            assert is_problem(await http.post("/access/tokens", json=order, headers=admin), 422), order
        listed = (await http.get("/access/tokens", headers=admin)).text
        assert made.json()["token"] not in listed and "digest" not in listed
        token_id = next(t["id"] for t in json.loads(listed) if t["name"] == "display")
        assert (await http.delete(f"/access/tokens/{token_id}", headers=admin)).status_code == 204
        assert is_problem(await http.get("/session", headers=token), 401)
        assert is_problem(await http.delete("/access/tokens/none", headers=admin), 404)


async def test_secrets_are_in_no_log_problem_metric_or_file_but_their_own(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    seen: list[str] = []
    wrong = Token.new().text
    async with running_robot() as bench, guarded_station(tmp_path, bench.port) as station:
        filming = asyncio.create_task(Film(bench).run())
        http, own = station.desk.http, {"Origin": station.origin}
        await until(lambda: station.desk.station.first.camera.newest)
        admin = station.headers(Role.ADMIN)
        login = await http.post("/login", json={"token": station.tokens[Role.ADMIN]}, headers=own)
        session = http.cookies[COOKIE]
        drive = (await http.post("/navigations", json={"name": "x"}, headers=admin)).json()["id"]
        bad = {"Authorization": f"Bearer {wrong}", "Cookie": f"{COOKIE}={wrong}"}
        answers = (
            login,
            await http.get("/robot", headers=bad),
            await http.post("/login", json={"token": wrong}, headers=own),
            await http.post("/login", json={"token": wrong, "more": 1}, headers=own),
            await http.post("/login", json={"token": [wrong]}, headers=own),
            await http.post("/drive", json={"linear": 9}, headers=admin),
            *[await http.get(path, headers=admin) for path in ("/metrics", "/log", "/robot", "/access/tokens")],
        )
        seen.extend(answer.text for answer in answers)
        await until(lambda: station.desk.station.navigations.get(drive).frames > 3)
        await http.post(f"/navigations/{drive}/stop", headers=admin)
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)
        secrets = [*station.tokens.values(), session, wrong]
    files = [p.read_bytes() for p in tmp_path.rglob("*") if p.is_file() and p.name not in ("key.pem",)]
    recordings = list(tmp_path.rglob("recording.mcap"))
    # What our programs log; the test's own clients and libraries log whole requests when asked for DEBUG.
    ours = ("robot", "station", "shared", "uvicorn")
    log = "".join(f"{r.getMessage()} {r.exc_text}" for r in caplog.records if r.name.partition(".")[0] in ours)
    assert recordings and log
    for secret in secrets:
        token = Token.parse(secret)
        assert token is not None
        for form in (secret, secret.split("_", 2)[2], token.secret.hex()):
            assert form not in log
            assert not any(form in text for text in seen)
            assert not any(form.encode() in content for content in files)
        assert not any(token.secret in content for content in files)


async def test_plain_http_gets_no_word_from_a_guarded_station(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station, httpx.AsyncClient() as plain:
        with pytest.raises(httpx.TransportError):
            await plain.get(station.desk.address.replace("https", "http") + "/healthz")


async def test_on_loopback_without_access_control_everybody_is_admin(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        answer = (await desk.http.get("/session")).json()
        assert (answer["controlled"], answer["role"]) == (False, "admin")
        assert is_problem(await desk.http.post("/login", json={"token": "x"}), 409)
        assert is_problem(await desk.http.get("/access/tokens"), 409)


FRAME = "/camera/frame.jpg"
SHOWN_ELSEWHERE = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "image"}
FOLLOWED = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}


async def test_another_sites_page_can_show_no_picture_of_ours(tmp_path: Path) -> None:
    async with running_robot() as bench, running_station(bench.port, tmp_path) as desk:
        filming = asyncio.create_task(Film(bench).run())
        await until(lambda: desk.station.first.camera.newest)
        for foreign in (
            SHOWN_ELSEWHERE,
            SHOWN_ELSEWHERE | {"Sec-Fetch-Site": "same-site"},  # another program on this machine
            FOLLOWED | {"Sec-Fetch-Dest": "iframe"},
        ):
            assert is_problem(await desk.http.get(FRAME, headers=foreign), 403)
        assert is_problem(await desk.http.post("/stop", headers=FOLLOWED), 403)
        for own in ({}, {"Sec-Fetch-Site": "none"}, SHOWN_ELSEWHERE | {"Sec-Fetch-Site": "same-origin"}, FOLLOWED):
            answer = await desk.http.get(FRAME, headers=own)
            assert answer.status_code == 200
            # For browsers that say nothing of where they ask from.
            assert answer.headers["cross-origin-resource-policy"] == "same-origin"
            assert answer.headers["x-content-type-options"] == "nosniff"
        for path in ("/", "/robot", "/nothing", "/openapi.json"):
            headers = (await desk.http.get(path)).headers
            assert headers.get_list("x-content-type-options") == ["nosniff"]
            assert headers["cross-origin-resource-policy"] == "same-origin"
        filming.cancel()
