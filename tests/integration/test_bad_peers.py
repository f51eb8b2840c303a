"""Whoever breaks the rules is told and closed; the server and the real stations go on."""

from __future__ import annotations

import asyncio
import itertools
import random
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import msgspec
import pytest

import robot.commands
import shared.session
from shared.calibration import REFERENCE_ROBOT
from shared.framing import MAX_ROBOT_PAYLOAD, FrameDecoder, encode_payload
from shared.message_codec import decode_robot_message, encode_message
from shared.messages import (
    PROTOCOL_VERSION,
    Capabilities,
    Drive,
    ErrorNotice,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Join,
    Message,
    Refusal,
    StationMessage,
    Stop,
    Welcome,
)
from shared.session import MESSAGES_AT_A_TIME, State
from station.robots.link import RobotLink
from station.robots.link_log import MAX_WARNINGS
from tests.support.link import Bench, Notes, linked, running_robot, until

Wire = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@asynccontextmanager
async def wire(port: int) -> AsyncIterator[Wire]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        yield reader, writer
    finally:
        writer.transport.abort()


def packed(message: Message) -> bytes:
    return encode_payload(encode_message(message), MAX_ROBOT_PAYLOAD)


def packed_map(**content: object) -> bytes:
    return encode_payload(msgspec.msgpack.encode(content), MAX_ROBOT_PAYLOAD)


JOIN = packed(Join(protocol=PROTOCOL_VERSION, station_name="stranger"))


async def all_until_closed(reader: asyncio.StreamReader) -> list[Message]:
    """Everything the server says until it closes."""
    decoder, messages = FrameDecoder(MAX_ROBOT_PAYLOAD), []
    try:
        while data := await reader.read(65536):
            decoder.receive(data)
            while (payload := decoder.next_payload()) is not None:
                messages.append(decode_robot_message(payload))
    except ConnectionResetError:
        pass
    return messages


async def assert_goes_on(bench: Bench, link: RobotLink, notes: Notes) -> None:
    """The real station still gets data and still drives."""
    frames, samples = len(notes.frames), len(notes.sequences)
    bench.camera.put(1)
    bench.imu.inject(10)
    await until(lambda: len(notes.frames) == frames + 1 and len(notes.sequences) == samples + 10)
    await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
    assert notes.reasons == [] and notes.gaps == []


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (random.Random(1).randbytes(3000), "was announced, allowed are 1..4096"),
        ((2**32 - 1).to_bytes(4, "big"), "4294967295 bytes was announced"),
        ((0).to_bytes(4, "big"), "0 bytes was announced"),
        (b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n", "was announced"),
        (packed_map(type="join", protocol=99, station_name="new"), "speaks protocol version 99"),
        (packed_map(type="join", protocol=2), "missing required field `station_name`"),
        (packed_map(type="nonsense"), "Invalid value 'nonsense'"),
        (packed(Stop(seq=1)), "while the connection was opening"),
        (JOIN + JOIN, "while the connection was joining"),
        (encode_payload(b"\xc1\xc1\xc1", 10), "not a valid message"),
    ],
)
async def test_a_peer_that_breaks_the_rules_is_told_why_and_closed(sent: bytes, said: str) -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes), wire(bench.port) as (reader, writer):
        writer.write(sent)
        messages = await all_until_closed(reader)
        assert isinstance(messages[0], Hello)
        last = messages[-1]
        assert isinstance(last, ErrorNotice) and last.fatal and last.code == "protocol"
        assert said in last.message and "\n" not in last.message
        await assert_goes_on(bench, link, notes)


async def drive_off(
    bench: Bench, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, decoder: FrameDecoder | None = None
) -> int:
    """Join and drive until the motors turn; the number of the next command."""
    writer.write(JOIN)
    decoder = decoder or FrameDecoder(MAX_ROBOT_PAYLOAD)
    welcome = None
    while not isinstance(welcome, Welcome):
        decoder.receive(await reader.read(65536))
        while (payload := decoder.next_payload()) is not None and not isinstance(welcome, Welcome):
            welcome = decode_robot_message(payload)
    seq = itertools.count(1)

    def drives() -> bool:
        now_ns = time.monotonic_ns()
        writer.write(packed(Drive(seq=next(seq), t_station_ns=now_ns, linear=0.2, angular=0.0, ttl_ms=250)))
        return not bench.motors.are_off

    await until(drives)
    return next(seq)


async def test_a_station_that_turns_bad_while_driving_leaves_the_motors_off() -> None:
    async with running_robot() as bench, wire(bench.port) as (reader, writer):
        seq = await drive_off(bench, reader, writer)
        writer.write(packed_map(type="drive", seq=seq, t_station_ns=0, linear=float("nan"), angular=0.0, ttl_ms=250))
        last = (await all_until_closed(reader))[-1]
        assert isinstance(last, ErrorNotice) and "linear nan is outside" in last.message
        assert bench.motors.are_off
        assert bench.server.desk.lease.driver(time.monotonic_ns()) is None


@pytest.mark.parametrize("sent", [b"", JOIN[: len(JOIN) // 2]])
async def test_silence_or_half_a_message_ends_in_a_sentence(sent: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared.session, "JOIN_WITHIN_NS", 100_000_000)
    async with running_robot() as bench, wire(bench.port) as (reader, writer):
        writer.write(sent)
        last = (await all_until_closed(reader))[-1]
        assert isinstance(last, ErrorNotice) and last.code == "silent"
        assert "the rest of the greeting" in last.message


async def test_a_station_that_falls_silent_loses_the_wheel_and_then_the_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shared.session, "QUIET_AFTER_NS", 100_000_000)
    monkeypatch.setattr(shared.session, "CLOSE_AFTER_NS", 3_600_000_000_000)
    monkeypatch.setattr(robot.commands, "LEASE_NS", 3_600_000_000_000)  # it is not the lease that ends
    async with running_robot() as bench, wire(bench.port) as (reader, writer):
        await drive_off(bench, reader, writer)
        lease = bench.server.desk.lease
        assert lease.driver(time.monotonic_ns()) is not None
        await until(lambda: lease.driver(time.monotonic_ns()) is None)
        assert bench.motors.are_off
        monkeypatch.setattr(shared.session, "CLOSE_AFTER_NS", 200_000_000)
        messages = await all_until_closed(reader)
        last = messages[-1]
        assert isinstance(last, ErrorNotice) and last.code == "silent" and "anything from the station" in last.message


async def test_two_hundred_connections_keep_no_real_station_out() -> None:
    async with running_robot() as bench, linked(bench.port, "first") as (link, notes):
        wires = [await asyncio.open_connection("127.0.0.1", bench.port) for _ in range(200)]
        try:
            async with linked(bench.port, "late") as (_, late_notes):
                bench.imu.inject(10)
                await until(lambda: len(late_notes.sequences) == 10)
            await until(lambda: len(notes.sequences) == 10)
            await asyncio.gather(*(all_until_closed(reader) for reader, _ in wires[:150]))
            await assert_goes_on(bench, link, notes)
        finally:
            for _, writer in wires:
                writer.transport.abort()


async def test_the_answer_to_a_heartbeat_is_stamped_when_it_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count(1)
    monkeypatch.setattr(Bench, "clock", lambda _: next(ticks))  # each look at the clock gives a later time
    async with running_robot() as bench, wire(bench.port) as (reader, writer):
        decoder = FrameDecoder(MAX_ROBOT_PAYLOAD)
        seq = await drive_off(bench, reader, writer, decoder)
        writer.write(packed(Heartbeat(seq=seq, t_station_ns=time.monotonic_ns())))
        reply: Message | None = None
        while not isinstance(reply, HeartbeatReply):
            decoder.receive(await reader.read(65536))
            while (payload := decoder.next_payload()) is not None and not isinstance(reply, HeartbeatReply):
                reply = decode_robot_message(payload)
        assert reply.seq == seq and reply.t_robot_sent_ns > reply.t_robot_received_ns


async def test_of_many_that_join_at_once_only_so_many_are_taken_in() -> None:
    async with running_robot(max_stations=2, max_waiting=64) as bench:
        wires = [await asyncio.open_connection("127.0.0.1", bench.port) for _ in range(20)]
        try:
            await until(lambda: len(bench.server._clients) == 20)
            for _, writer in wires:
                writer.write(JOIN)
            await until(lambda: len(bench.server._clients) == 2)
            assert all(client.is_joined for client in bench.server._clients.values())
        finally:
            for _, writer in wires:
                writer.transport.abort()


async def test_more_stations_than_allowed_are_refused_with_the_number() -> None:
    async with running_robot(max_stations=2) as bench, linked(bench.port, "a"), linked(bench.port, "b"):
        notes = Notes()
        third = RobotLink("127.0.0.1", bench.port, notes, station_name="c")
        task = asyncio.create_task(third.run())
        await until(lambda: "2 stations are connected" in third.state.reason)
        assert notes.hellos == [] and not third.state.connected
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_station_that_fell_silent_yields_its_place() -> None:
    async with running_robot(max_stations=2) as bench, wire(bench.port) as one, wire(bench.port) as two:
        for _, writer in (one, two):
            writer.write(JOIN)
        clients = bench.server._clients
        await until(lambda: sum(c.session.state is State.QUIET for c in clients.values()) == 2)
        async with linked(bench.port):
            await until(lambda: len(clients) == 2)
            assert sorted(c.session.state.value for c in clients.values()) == ["active", "quiet"]
        hearing = [asyncio.create_task(all_until_closed(reader)) for reader, _ in (one, two)]
        done, others = await asyncio.wait(hearing, return_when=asyncio.FIRST_COMPLETED)
        for task in others:
            task.cancel()
        last = done.pop().result()[-1]  # decoded as a station does: it knows what it is told
        assert isinstance(last, ErrorNotice) and last.fatal and "another needs its place" in last.message


async def test_a_peer_that_never_reads_does_not_fill_the_robots_memory() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes), wire(bench.port) as (_, writer):
        writer.write(JOIN)
        await until(lambda: sum(c.is_joined for c in bench.server._clients.values()) == 2)
        for n in range(100):
            bench.camera.put(n, size=300_000)
            await until(lambda n=n: notes.frames and notes.frames[-1][0].seq == n)
        stuck = max(bench.server._clients.values(), key=lambda c: c.id)
        assert stuck._writer.transport.get_write_buffer_size() < 1_000_000
        await assert_goes_on(bench, link, notes)


@asynccontextmanager
async def most_in_a_turn() -> AsyncIterator[tuple[Callable[[object], None], Callable[[], int]]]:
    """Whom to tell of each thing that happens, and how many there were in one turn of the event loop at most."""
    happened = most = 0
    over = False

    def note(_: object) -> None:
        nonlocal happened
        happened += 1

    def turn() -> None:
        nonlocal happened, most
        most, happened = max(most, happened), 0
        if not over:
            asyncio.get_running_loop().call_soon(turn)

    turn()
    yield note, lambda: most
    over = True


async def test_a_station_that_talks_without_end_leaves_others_their_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running_robot() as bench, wire(bench.port) as (_, writer), most_in_a_turn() as (note, most):
        handle = bench.server.desk.handle

        def handle_and_note(client: int, message: StationMessage, now_ns: int) -> ErrorNotice | None:
            note(message)
            return handle(client, message, now_ns)

        monkeypatch.setattr(bench.server.desk, "handle", handle_and_note)
        writer.write(JOIN)
        await until(lambda: any(client.is_joined for client in bench.server._clients.values()))
        writer.write(b"".join(packed(Stop(seq=seq)) for seq in range(500)))
        await until(lambda: bench.stops_heard == 500)
        assert most() <= 2 * MESSAGES_AT_A_TIME


# The other way round: a robot that is none


async def false_robot(answer: Callable[[Wire], None]) -> asyncio.Server:
    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        answer((reader, writer))
        try:
            while await reader.read(65536):
                pass
        except OSError:
            pass
        writer.transport.abort()

    return await asyncio.start_server(take, "127.0.0.1", 0)


def says(data: bytes) -> Callable[[Wire], None]:
    return lambda wire: wire[1].write(data)


HELLO = Hello(
    protocol=7,
    robot_id="r",
    name="R",
    session_id="s",
    capabilities=Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False),
    calibration=REFERENCE_ROBOT,
)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (random.Random(2).randbytes(100), "was announced"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "was announced"),
        (packed(HELLO), "speaks protocol version 7"),
        (packed(Welcome(client_id=1)), "while the connection was opening"),
        (packed(Refusal(reason="go away")), "go away"),
    ],
)
async def test_the_link_says_what_is_wrong_with_a_robot_and_keeps_trying(answer: bytes, reason: str) -> None:
    server = await false_robot(says(answer))
    notes = Notes()
    link = RobotLink("127.0.0.1", server.sockets[0].getsockname()[1], notes)
    task = asyncio.create_task(link.run())
    try:
        await until(lambda: reason in link.state.reason)
        assert not link.state.connected and not task.done()
        assert notes.hellos == notes.reasons == []
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        server.close()


async def test_a_robot_that_talks_without_end_leaves_others_their_turn_and_the_log_room(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[Message] = [msgspec.structs.replace(HELLO, protocol=PROTOCOL_VERSION), Welcome(client_id=1)]
    said += [ErrorNotice(code="device", message=f"it is {number} degrees too warm") for number in range(500)]
    server = await false_robot(says(b"".join(map(packed, said))))
    async with most_in_a_turn() as (note, most), linked(server.sockets[0].getsockname()[1]) as (_, notes):
        on_notice = notes.on_notice

        def counted(notice: ErrorNotice) -> None:
            on_notice(notice)
            note(notice)

        monkeypatch.setattr(notes, "on_notice", counted)
        await until(lambda: len(notes.notices) >= 500)
    server.close()
    assert most() <= 2 * MESSAGES_AT_A_TIME
    assert len([line for line in caplog.messages if "too warm" in line]) == MAX_WARNINGS


async def test_a_robot_that_warned_without_end_is_told_as_lost(caplog: pytest.LogCaptureFixture) -> None:
    said: list[Message] = [msgspec.structs.replace(HELLO, protocol=PROTOCOL_VERSION), Welcome(client_id=1)]
    said += [ErrorNotice(code="device", message=f"it is {number} degrees too warm") for number in range(100)]
    said.append(ErrorNotice(code="silent", message="that is all", fatal=True))
    server = await false_robot(says(b"".join(map(packed, said))))
    async with linked(server.sockets[0].getsockname()[1]) as (_, notes):
        await until(lambda: bool(notes.reasons))
    server.close()
    assert "robot lost: the robot closed the connection: that is all" in caplog.messages
