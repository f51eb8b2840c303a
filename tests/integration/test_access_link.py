"""The robot link with access control, over real sockets and real TLS: who is let in, and what each may say."""

from __future__ import annotations

import asyncio
import socket
import time
from pathlib import Path
from typing import get_args

import msgspec
import psutil
import pytest

from robot.access import MESSAGE_ROLES
from shared.access import Role, Token, prove
from shared.calibration import REFERENCE_ROBOT
from shared.certificates import make_identity
from shared.errors import ConfigError
from shared.framing import MAX_STATION_PAYLOAD, encode_payload
from shared.message_codec import encode_message
from shared.messages import (
    PROTOCOL_VERSION,
    AskDatagrams,
    CalibrationChanged,
    Datagrams,
    Drive,
    ErrorNotice,
    Heartbeat,
    Hijack,
    Join,
    PairProof,
    PairRequest,
    PanTilt,
    Prove,
    Received,
    Refusal,
    StationMessage,
    Stop,
    UndoCalibration,
    UseCalibration,
    Welcome,
)
from shared.token_book import TokenBook
from station.access import connecting, paired_robots
from station.access.connecting import ConnectionRefused, connect, connect_by_tls
from station.access.paired_robots import PairedRobot, PairedRobots
from station.access.visitors import access_folder
from tests.support.access import JOIN, NOW, GuardedBench, guarded_robot, linked, make_token, set_up, talking
from tests.support.link import running_robot, until
from tests.support.station import running_station
from tests.support.station_at_work import is_problem, wait_for

ONE_OF_EACH: list[StationMessage] = [
    JOIN,
    Prove(token_id="a", proof=bytes(32)),
    PairRequest(protocol=PROTOCOL_VERSION, station_name="desk", message=bytes(33)),
    PairProof(mac=bytes(32)),
    Heartbeat(seq=1, t_station_ns=1),
    Received(frame_seq=-1, next_imu_sequence=-1),
    AskDatagrams(port=1),
    Drive(seq=2, t_station_ns=1, linear=0.1, angular=0.0, ttl_ms=200),
    Stop(seq=3),
    PanTilt(pan=0.1, tilt=0.0),
    Hijack(x=0.0, y=0.0, yaw=0.0),
    UseCalibration(calibration=REFERENCE_ROBOT),
    UndoCalibration(),
    ErrorNotice(code="device", message="x"),
]


def test_every_message_a_station_can_say_has_a_role_and_is_tried_here() -> None:
    assert set(MESSAGE_ROLES) == set(get_args(StationMessage)) == {type(message) for message in ONE_OF_EACH}


@pytest.mark.parametrize("message", ONE_OF_EACH, ids=lambda m: type(m).__name__)
async def test_nothing_an_unknown_station_says_is_obeyed(tmp_path: Path, message: StationMessage) -> None:
    async with guarded_robot(tmp_path) as bench, talking(bench) as talk:
        await talk.hear_hello()
        talk.say(message)
        answer = await talk.hear()
        assert isinstance(answer, Refusal | ErrorNotice)  # and no welcome
        assert await talk.hear() is None
        assert not bench.heard and not bench.motors.history[1:] and not bench.head.pointed and not bench.head.moved


@pytest.mark.parametrize("role", [Role.WATCH, Role.DRIVE, Role.ADMIN])
@pytest.mark.parametrize("message", ONE_OF_EACH, ids=lambda m: type(m).__name__)
async def test_a_known_station_may_say_what_its_role_may(tmp_path: Path, message: StationMessage, role: Role) -> None:
    async with guarded_robot(tmp_path) as bench, talking(bench) as talk:
        hello = await talk.hear_hello()
        talk.say(talk.prove(make_token(bench, role), hello))
        talk.say(JOIN)
        assert isinstance(await talk.hear(), Welcome)
        needed = MESSAGE_ROLES[type(message)]
        if needed is None or isinstance(message, Join):  # only before joining: the session's own rules
            talk.say(message)
            answer = await talk.hear()
            assert isinstance(answer, ErrorNotice) and answer.fatal
            return
        talk.say(message)
        if role.includes(needed) and needed is Role.ADMIN:
            answer = await talk.hear()
            assert isinstance(answer, CalibrationChanged | ErrorNotice)
            assert isinstance(answer, CalibrationChanged) or answer.code == "out_of_range"  # there is nothing to undo
        elif isinstance(message, AskDatagrams):
            assert isinstance(await talk.hear(), Datagrams)
        elif role.includes(needed):
            await until(lambda: message in bench.heard or isinstance(message, Received))
        else:
            answer = await talk.hear()
            assert isinstance(answer, ErrorNotice) and (answer.code, answer.fatal) == ("not_allowed", False)
            assert message not in bench.heard
        assert not bench.head.moved or role.includes(Role.DRIVE)


async def test_a_replayed_proof_is_refused(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        token = make_token(bench, Role.DRIVE)
        async with talking(bench) as talk:
            recorded = talk.prove(token, await talk.hear_hello())
            talk.say(recorded)
            talk.say(JOIN)
            assert isinstance(await talk.hear(), Welcome)
        async with talking(bench) as thief:  # the same words again, inside TLS
            await thief.hear_hello()
            thief.say(recorded)
            thief.say(JOIN)
            answer = await thief.hear()
            assert isinstance(answer, Refusal) and "not valid" in answer.reason


async def test_a_stolen_book_is_no_token(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench, talking(bench) as talk:
        token = make_token(bench, Role.DRIVE)
        hello = await talk.hear_hello()
        talk.say(talk.prove(Token(token.id, token.digest), hello))
        assert isinstance(await talk.hear(), Refusal)


async def test_a_proof_for_another_robots_certificate_is_refused(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench, talking(bench) as talk:
        token = make_token(bench, Role.DRIVE)
        hello = await talk.hear_hello()
        talk.say(Prove(token_id=token.id, proof=prove(token, hello.challenge, bytes(32))))
        assert isinstance(await talk.hear(), Refusal)


async def test_many_wrong_tokens_close_the_gate_for_that_address_but_not_for_the_right_one(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        good = make_token(bench, Role.DRIVE)
        reasons = []
        for token in (Token.new() for _ in range(11)):
            async with talking(bench) as talk:
                talk.say(talk.prove(token, await talk.hear_hello()))
                answer = await talk.hear()
                assert isinstance(answer, Refusal)
                reasons.append(answer.reason)
        assert "wait" in reasons[-1] and "wait" not in reasons[-2]
        async with talking(bench) as talk:  # nobody's guesses keep out whose token is right
            talk.say(talk.prove(good, await talk.hear_hello()))
            talk.say(JOIN)
            assert isinstance(await talk.hear(), Welcome)


async def test_another_certificate_at_a_known_address_is_refused_before_a_word_is_said(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)
        connection = await connect("127.0.0.1", bench.port, robots)  # as it was, it is taken
        connection.writer.transport.abort()
        await bench.stop()
        make_identity(bench.folder, "another", ["localhost"], 10, NOW)
        await bench.start()
        with pytest.raises(ConnectionRefused, match="another machine answers in its place"):
            await connect("127.0.0.1", bench.port, robots)
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: "pair again" in link.state.reason)
            assert not link.state.connected and not bench.heard


async def test_another_paired_robot_at_a_known_address_is_refused_and_hears_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Two robots that swap their addresses must not swap drivers."""
    robots = PairedRobots(tmp_path / "station", data_dir=tmp_path)
    async with guarded_robot(tmp_path / "anna") as anna, guarded_robot(tmp_path / "berta") as berta:
        for bench, name in ((anna, "Anna"), (berta, "Berta")):
            bench.admit("desk", Role.DRIVE, robots)
            robots.store(msgspec.structs.replace(robots.all()[-1], name=name))
        ports = anna.port, berta.port
        for port in ports:
            async with linked(port, robots) as (link, _):
                await until(lambda: link.state.connected)
        berta.heard.clear()
        await anna.stop()
        await berta.stop()
        berta.port, anna.port = ports
        await anna.start()
        await berta.start()
        async with linked(ports[0], robots) as (link, _):
            await until(lambda: "is Anna's, and Berta" in link.state.reason)
            assert f"--code CODE --data {tmp_path}`" in link.state.reason
            assert not link.commands.drive(0.2, 0.0, 200)
            assert not link.state.connected and not berta.heard
            assert [line for line in caplog.messages if "is Anna's" in line] == [
                f"no robot is connected: {link.state.reason}"
            ]
            assert all((linear, angular) == (0.0, 0.0) for _, linear, angular in berta.motors.history)


def test_an_address_belongs_to_the_first_paired_robot_that_is_met_there(tmp_path: Path) -> None:
    """Also where it is not the one that the robot was paired at, and after the station was started anew."""
    robots = PairedRobots(tmp_path)
    first, second = bytes([1] * 32), bytes([2] * 32)
    anna, berta = (
        PairedRobot(
            robot_id=name,
            name=name,
            host=host,
            port=7400,
            fingerprint=fingerprint.hex(),
            token=Token.new().text,
        )
        for name, host, fingerprint in (("Anna", "192.168.1.20", first), ("Berta", "192.168.1.21", second))
    )
    robots.store(anna)
    robots.store(berta)
    assert not isinstance(robots.recognise(first, "Anna.local", 7400), str)
    again = PairedRobots(tmp_path)
    assert again.needs_tls("anna.local", 7400, "127.0.0.1")
    said = again.recognise(second, "anna.local", 7400)
    assert isinstance(said, str) and "is Anna's, and Berta" in said
    assert not isinstance(again.recognise(first, "anna.local", 7400), str)
    assert not isinstance(again.recognise(second, "anna.local", 7401), str)  # another one's port
    assert isinstance(again.recognise(bytes(32), "elsewhere.local", 7400), str)  # a stranger owns nothing
    # Who pairs there says whose it is from now on; nobody is forgotten.
    again.store(msgspec.structs.replace(berta, host="anna.local"))
    assert {robot.name for robot in again.all()} == {"Anna", "Berta"}
    assert not isinstance(again.recognise(second, "anna.local", 7400), str)
    assert isinstance(again.recognise(first, "anna.local", 7400), str)


async def test_a_robot_is_used_under_a_new_address_where_that_cannot_be_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)

        def refuse(*_: object) -> None:
            raise ConfigError("the disk is read-only")

        monkeypatch.setattr(paired_robots, "write_private", refuse)
        connection = await connect("localhost", bench.port, PairedRobots(tmp_path / "station", allow_open=True))
        connection.writer.transport.abort()
        assert not isinstance(robots.recognise(bench.gate.fingerprint, "elsewhere.local", 7400), str)


async def test_a_robot_that_was_never_paired_is_refused_with_the_remedy(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station", data_dir=tmp_path)
    async with guarded_robot(tmp_path / "a") as known, guarded_robot(tmp_path / "b") as stranger:
        known.admit("desk", Role.DRIVE, robots)
        # As a robot beyond loopback would be met.
        connection = await connect_by_tls("127.0.0.1", stranger.port)
        said = robots.recognise(connection.fingerprint, "192.168.1.20", stranger.port)
        connection.writer.transport.abort()
        assert isinstance(said, str) and "`station pair 192.168.1.20" in said
        assert f" --code CODE --data {tmp_path}`" in said


async def test_why_a_robot_is_refused_is_told_in_the_log_and_to_who_would_drive(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path / "robot") as bench:
        robots = PairedRobots(access_folder(tmp_path / "station"))
        bench.admit("desk", Role.DRIVE, robots)
        robots.store(msgspec.structs.replace(robots.all()[0], fingerprint="5e" * 32))  # another machine's
        async with running_station(bench.port, tmp_path / "station") as desk:
            robot = await wait_for(desk, "/robot", lambda robot: "pair again" in (robot["reason"] or ""))
            why = f"no robot is connected: {robot['reason']}"
            answer = await desk.http.post("/drive", json={"linear": 0.1, "angular": 0.0, "ttl_ms": 200})
            assert is_problem(answer, 503) and answer.json()["detail"] == why
            await wait_for(desk, "/log", lambda log: why in [line["text"] for line in log])


async def test_a_file_of_robots_that_becomes_damaged_while_one_is_connected_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "LOOK_EVERY_S", 0.02)
    async with guarded_robot(tmp_path / "robot") as bench:
        robots = PairedRobots(access_folder(tmp_path / "station"))
        bench.admit("desk", Role.DRIVE, robots)
        async with running_station(bench.port, tmp_path / "station") as desk:
            await wait_for(desk, "/robot", lambda robot: robot["connected"])
            whole = robots.path.read_bytes()
            robots.path.write_bytes(b"damaged")
            told = await wait_for(desk, "/robot", lambda robot: any("is damaged" in said for said in robot["faults"]))
            assert told["connected"] and str(robots.path) in told["faults"][0]
            robots.path.write_bytes(whole)
            await wait_for(desk, "/robot", lambda robot: not robot["faults"])


def test_beyond_loopback_robots_are_met_by_tls_only(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path)
    assert robots.needs_tls("sentinel.local", 7400, "192.168.1.20")
    assert not robots.needs_tls("localhost", 7400, "127.0.0.1")
    assert not PairedRobots(tmp_path, allow_open=True).needs_tls("192.168.1.20", 7400, "192.168.1.20")


async def test_a_robot_without_tls_where_tls_is_needed_is_refused(tmp_path: Path) -> None:
    async with running_robot() as bench:
        with pytest.raises(ConnectionRefused, match="does not speak TLS") as refused:
            await connect_by_tls("127.0.0.1", bench.port)
        assert "on loopback it needs no pairing" in str(refused.value)
        assert "access init" not in str(refused.value)  # it changes nothing there


async def test_a_robot_that_is_silent_did_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy one may speak TLS as well as any: nothing is said of its access control."""
    monkeypatch.setattr(connecting, "HANDSHAKE_WITHIN_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(TimeoutError) as late:
            await connect_by_tls("127.0.0.1", port)
    assert connecting.in_words(late.value, f"127.0.0.1:{port}") == f"no answer from 127.0.0.1:{port}"


async def test_a_robot_that_ends_the_handshake_may_have_access_control() -> None:
    async def leave(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.transport.abort()

    async with await asyncio.start_server(leave, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(ConnectionRefused, match=f"127.0.0.1:{port} ended the connection before") as ended:
            await connect_by_tls("127.0.0.1", port)
    assert "access control" not in str(ended.value)


async def test_where_the_file_of_robots_is_damaged_no_socket_is_left_open(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path)
    robots.path.write_text("no robots")
    robots.path.chmod(0o600)
    process = psutil.Process()
    with socket.create_server(("127.0.0.1", 0)) as server:
        before = process.num_fds()
        with pytest.raises(ConfigError, match="is damaged") as kept:
            await connecting.connect("127.0.0.1", server.getsockname()[1], robots)
        assert process.num_fds() == before and kept


async def test_a_station_without_tls_gets_no_word_from_a_guarded_robot(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        reader, writer = await asyncio.open_connection("127.0.0.1", bench.port)
        writer.write(encode_payload(encode_message(JOIN), MAX_STATION_PAYLOAD))
        heard = await reader.read(1000)
        writer.transport.abort()
        assert b"robot_id" not in heard and not bench.heard


async def test_a_station_that_was_never_paired_hears_of_access_control_on_loopback(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path / "robot") as bench, linked(bench.port, PairedRobots(tmp_path)) as (link, _):
        await until(lambda: "if it has access control, pair with it" in link.state.reason)


async def test_a_revoked_station_is_thrown_out_its_motors_stop_and_it_stays_out(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
            TokenBook(bench.folder).revoke("desk", time.time())  # as `robot-server access revoke` does
            await until(lambda: link.commands.drive(0.2, 0.0, 250) is False)
            assert "revoked" in link.state.reason
            await until(lambda: bench.motors.are_off)
            await until(lambda: "not valid" in link.state.reason)
            assert link.state.connections == 1


async def test_a_revocation_that_somebodys_proof_finds_out_first_counts_too(tmp_path: Path) -> None:
    """A thief who proves again and again must not keep the look at the book from seeing that it has changed."""
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.state.connected)
            TokenBook(bench.folder).revoke("desk", time.time())
            bench.gate.admit(Prove(token_id="x", proof=bytes(32)), b"", "thief")
            await until(lambda: not link.state.connected)


async def test_a_book_that_is_gone_lets_nobody_in_and_throws_out_who_is(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.state.connected)
            (bench.folder / "tokens.json").unlink()
            await until(lambda: not link.state.connected)


async def test_silent_handshakes_are_bounded_in_number_and_time_and_keep_nobody_out(tmp_path: Path) -> None:
    bench = GuardedBench(set_up(tmp_path / "robot"), max_waiting=4)
    await bench.start()
    robots = PairedRobots(tmp_path / "station")
    bench.admit("desk", Role.WATCH, robots)
    silent = [await asyncio.open_connection("127.0.0.1", bench.port) for _ in range(40)]
    try:
        ended = [asyncio.create_task(reader.read()) for reader, _ in silent]
        await until(lambda: sum(task.done() for task in ended) >= 36)  # at once, for want of room
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.state.connected)
        await asyncio.gather(*ended, return_exceptions=True)  # the last ones after HANDSHAKE_WITHIN_S
        await until(lambda: not bench.server._clients)
    finally:
        for _, writer in silent:
            writer.transport.abort()
        await bench.stop()
