"""The robot link with access control, over real sockets and real TLS: who is let in, and what each may say."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import get_args

import msgspec
import pytest

from robot.access import MESSAGE_ROLES, Gate
from robot.pairing import CODE_LIFE_S, FILE_NAME, TRIES, PairingCode, PairingDesk
from shared.access import Role, Token, prove
from shared.certificates import make_identity, open_identity
from shared.framing import MAX_STATION_PAYLOAD, encode_payload
from shared.messages import (
    PROTOCOL_VERSION,
    Drive,
    ErrorNotice,
    Heartbeat,
    Hello,
    Hijack,
    Join,
    Message,
    Paired,
    PairProof,
    PairReply,
    PairRequest,
    PanTilt,
    Prove,
    Received,
    Refusal,
    StationMessage,
    Stop,
    Welcome,
    encode_message,
)
from shared.pairing import Pake
from shared.private_files import read_private
from shared.session import Session
from shared.token_book import TokenBook
from station.connecting import Connection, ConnectionRefused, connect, connect_by_tls
from station.link import RobotLink
from station.paired_robots import PairedRobots
from station.pairing import PairingFailed, pair
from tests.access_support import NOW, GuardedBench, guarded_robot, set_up
from tests.link_support import Notes, running_robot, until

JOIN = Join(protocol=PROTOCOL_VERSION, station_name="desk")
ONE_OF_EACH: list[StationMessage] = [
    JOIN,
    Prove(token_id="a", proof=bytes(32)),
    PairRequest(protocol=PROTOCOL_VERSION, station_name="desk", message=bytes(33)),
    PairProof(mac=bytes(32)),
    Heartbeat(seq=1, t_station_ns=1),
    Received(frame_seq=-1, next_imu_sequence=-1),
    Drive(seq=2, t_station_ns=1, linear=0.1, angular=0.0, ttl_ms=200),
    Stop(seq=3),
    PanTilt(pan=0.1, tilt=0.0),
    Hijack(x=0.0, y=0.0, yaw=0.0),
    ErrorNotice(code="device", message="x"),
]


class Talk:
    """A station that says whatever a test wants, in whatever order."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._session = Session("station", 0)

    def say(self, message: Message) -> None:
        self.say_bytes(encode_payload(encode_message(message), MAX_STATION_PAYLOAD))

    def say_bytes(self, data: bytes) -> None:
        self.connection.writer.write(data)

    async def hear(self) -> Message | None:
        """The next message that is not a report; None: the robot closed."""
        while True:
            message = self._session.next_message(0)
            if isinstance(message, Hello | Welcome | Refusal | ErrorNotice | PairReply | Paired):
                return message
            if message is None:
                try:
                    data = await asyncio.wait_for(self.connection.reader.read(65536), 10)
                except ConnectionError:
                    return None
                if not data:
                    return None
                self._session.receive(data)

    async def hear_hello(self) -> Hello:
        hello = await self.hear()
        assert isinstance(hello, Hello)
        return hello

    def prove(self, token: Token, hello: Hello) -> Prove:
        return Prove(token_id=token.id, proof=prove(token, hello.challenge, self.connection.fingerprint))


@asynccontextmanager
async def talking(bench: GuardedBench) -> AsyncIterator[Talk]:
    talk = Talk(await connect_by_tls("127.0.0.1", bench.port))
    try:
        yield talk
    finally:
        talk.connection.writer.transport.abort()


@asynccontextmanager
async def linked(port: int, robots: PairedRobots | None) -> AsyncIterator[tuple[RobotLink, Notes]]:
    """A link that may or may not get connected."""
    notes = Notes()
    link = RobotLink("127.0.0.1", port, notes, robots=robots)
    task = asyncio.create_task(link.run())
    try:
        yield link, notes
    finally:
        assert not task.done(), "the link ended by itself"
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def make_token(bench: GuardedBench, role: Role, name: str = "desk") -> Token:
    return TokenBook(bench.folder).add(name, role, time.time())


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
        if role.includes(needed):
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


async def test_pairing_gives_a_token_that_joins_and_pins_the_robot(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        paired = await pair("127.0.0.1", bench.port, code, "desk")
        assert paired.fingerprint == bench.gate.fingerprint.hex()
        robots.keep(paired)
        assert robots.path.stat().st_mode & 0o777 == 0o600
        async with linked(bench.port, robots) as (link, notes):
            await until(lambda: link.state.connected)
            bench.imu.inject(500)
            bench.camera.put(t_robot_ns=77, size=60_000)
            await until(lambda: len(notes.sequences) == 500 and notes.frames)
            await until(lambda: link.drive(0.2, -0.5, 200) and any(h[1:] == (0.2, -0.5) for h in bench.motors.history))
        with pytest.raises(PairingFailed, match="no pairing code is open"):  # it was good for one station
            await pair("127.0.0.1", bench.port, code, "desk")


async def test_a_code_is_void_after_a_few_wrong_guesses(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        for number in range(TRIES):
            guess = other_than(code, number)
            with pytest.raises(PairingFailed, match="no tries left" if number == TRIES - 1 else "wrong"):
                await pair("127.0.0.1", bench.port, guess, "desk")
        with pytest.raises(PairingFailed, match="no pairing code is open"):
            await pair("127.0.0.1", bench.port, code, "desk")
        assert not TokenBook(bench.folder).tokens()


async def test_guesses_at_once_do_not_get_more_tries(tmp_path: Path) -> None:
    """Many exchanges begun side by side, then all proofs. Those that a busy machine cut short proved nothing."""
    async with guarded_robot(tmp_path) as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        judged = 0
        while tries_left(bench):
            async with asyncio.TaskGroup() as tasks:
                guesses = [tasks.create_task(guess_once(bench, other_than(code, n))) for n in range(12)]
            judged += sum("the code is wrong" in guess.result() for guess in guesses)
        assert judged <= TRIES
        assert "no pairing code is open" in await guess_once(bench, code)


async def test_guesses_whose_answer_nobody_waits_for_are_counted(tmp_path: Path) -> None:
    """Connections that end before the proof cost exchanges, those that end behind it cost tries too."""
    async with guarded_robot(tmp_path) as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        for number in range(2 * TRIES):
            left = tries_left(bench)
            if not left:
                break
            async with talking(bench) as talk:
                fingerprint = talk.connection.fingerprint
                pake = await asyncio.to_thread(Pake, "station", other_than(code, number), fingerprint)
                await talk.hear_hello()
                talk.say(PairRequest(protocol=PROTOCOL_VERSION, station_name="thief", message=pake.message))
                reply = await talk.hear()
                assert isinstance(reply, PairReply)
                if number % 2:
                    continue
                await asyncio.to_thread(pake.hear, reply.message)
                talk.say(PairProof(mac=pake.mac("station")))
                await talk.connection.writer.drain()
            await until(lambda before=left: tries_left(bench) < before)
        assert number == 2 * TRIES - 1
        assert "no pairing code is open" in await guess_once(bench, code)


def tries_left(bench: GuardedBench) -> int:
    """Of the code that is open; none when there is none."""
    content = read_private(bench.folder / FILE_NAME)
    opened = None if content is None else msgspec.json.decode(content, type=PairingCode)
    return opened.tries_left if opened is not None and opened.is_open(time.time()) else 0


def other_than(code: str, number: int) -> str:
    return f"{(int(code) + number + 1) % 1_000_000:06d}"


async def guess_once(bench: GuardedBench, code: str) -> str:
    """Why there is no pairing; asked again where the machine was too busy to say."""
    for _ in range(5):
        try:
            await pair("127.0.0.1", bench.port, code, "thief")
        except PairingFailed as exc:
            if "no answer" not in str(exc):
                return str(exc)
        else:
            raise AssertionError("a wrong code was taken")
    return "no answer"


async def test_an_old_code_is_void(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time() - CODE_LIFE_S)
        with pytest.raises(PairingFailed, match="no pairing code is open"):
            await pair("127.0.0.1", bench.port, code, "desk")


class InBetween:
    """Ends TLS with a certificate of its own and passes every word on to the robot by another TLS connection."""

    def __init__(self, folder: Path, target_port: int) -> None:
        self._context = open_identity(set_up(folder)).server_context()
        self._target_port = target_port
        self._tasks: set[asyncio.Task[None]] = set()
        self.seen = bytearray()
        self.port = 0

    async def __aenter__(self) -> InBetween:
        self._server = await asyncio.start_server(self._take, "127.0.0.1", 0, ssl=self._context)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        robot = await connect_by_tls("127.0.0.1", self._target_port)
        for source, sink in ((reader, robot.writer), (robot.reader, writer)):
            task = asyncio.create_task(self._pass_on(source, sink))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pass_on(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        try:
            while data := await source.read(65536):
                self.seen += data
                sink.write(data)
                await sink.drain()
        except OSError:
            pass
        finally:
            sink.transport.abort()


async def test_who_stands_in_between_gets_no_pairing_even_with_the_right_code(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path / "robot") as bench, InBetween(tmp_path / "mallory", bench.port) as mallory:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        with pytest.raises(PairingFailed, match="stands between"):
            await pair("127.0.0.1", mallory.port, code, "desk")
        assert not TokenBook(bench.folder).tokens()
        assert mallory.seen and code.encode() not in mallory.seen
        await pair("127.0.0.1", bench.port, code, "desk")  # one try is gone, the code still counts


async def test_a_false_robot_that_does_not_know_the_code_is_not_remembered(tmp_path: Path) -> None:
    """It answers the exchange, takes any proof, and hands out a token of its own."""

    class Gullible(PairingDesk):
        def finish(self, pake: Pake, mac: bytes, station_name: str, now_s: float) -> Token:
            return Token.new()

    bench = GuardedBench(set_up(tmp_path))
    gate = Gate(tmp_path)
    gate.desk = Gullible(tmp_path, gate.book, gate.fingerprint)
    await bench.start_with(gate)
    try:
        shown = gate.desk.open_code(Role.DRIVE, time.time())
        with pytest.raises(PairingFailed, match="does not know the code"):
            await pair("127.0.0.1", bench.port, f"{(int(shown) + 1) % 1_000_000:06d}", "desk")
    finally:
        await bench.stop()


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


async def test_a_robot_that_was_never_paired_is_refused_with_the_remedy(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "a") as known, guarded_robot(tmp_path / "b") as stranger:
        known.admit("desk", Role.DRIVE, robots)
        # As a robot beyond loopback would be met.
        connection = await connect_by_tls("127.0.0.1", stranger.port)
        said = robots.recognise(connection.fingerprint, "192.168.1.20", stranger.port)
        connection.writer.transport.abort()
        assert isinstance(said, str) and "station pair 192.168.1.20" in said


def test_beyond_loopback_robots_are_met_by_tls_only(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path)
    assert robots.needs_tls("sentinel.local", 7400, "192.168.1.20")
    assert not robots.needs_tls("localhost", 7400, "127.0.0.1")
    assert not PairedRobots(tmp_path, allow_open=True).needs_tls("192.168.1.20", 7400, "192.168.1.20")


async def test_a_robot_without_tls_where_tls_is_needed_is_refused(tmp_path: Path) -> None:
    async with running_robot() as bench:
        with pytest.raises(ConnectionRefused, match="does not speak TLS"):
            await connect_by_tls("127.0.0.1", bench.port)


async def test_a_station_without_tls_gets_no_word_from_a_guarded_robot(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        reader, writer = await asyncio.open_connection("127.0.0.1", bench.port)
        writer.write(encode_payload(encode_message(JOIN), MAX_STATION_PAYLOAD))
        heard = await reader.read(1000)
        writer.transport.abort()
        assert b"robot_id" not in heard and not bench.heard


async def test_a_revoked_station_is_thrown_out_its_motors_stop_and_it_stays_out(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.drive(0.2, 0.0, 250) and not bench.motors.are_off)
            TokenBook(bench.folder).revoke("desk", time.time())  # as `robot-server access revoke` does
            await until(lambda: link.drive(0.2, 0.0, 250) is False)
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


async def test_strangers_learn_nothing_of_the_robots_files(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        (tmp_path / "pairing.json").chmod(0o644)
        with pytest.raises(PairingFailed, match="cannot pair just now") as failed:
            await pair("127.0.0.1", bench.port, code, "desk")
        assert str(tmp_path) not in str(failed.value)


async def test_proofs_in_one_breath_are_one_try(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench, talking(bench) as talk:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        await talk.hear_hello()
        pake = Pake("station", code, bench.gate.fingerprint)
        talk.say(PairRequest(protocol=PROTOCOL_VERSION, station_name="thief", message=pake.message))
        reply = await talk.hear()
        assert isinstance(reply, PairReply)
        pake.hear(reply.message)
        burst = (PairProof(mac=bytes(32)), PairProof(mac=pake.mac("station")))
        talk.say_bytes(b"".join(encode_payload(encode_message(proof), MAX_STATION_PAYLOAD) for proof in burst))
        assert isinstance(await talk.hear(), Refusal)
        await pair("127.0.0.1", bench.port, code, "desk")  # the second proof, a right one, was not looked at
        assert [token.name for token in TokenBook(bench.folder).tokens()] == ["desk"]


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
        assert bench.server is not None and not bench.server._clients
    finally:
        for _, writer in silent:
            writer.transport.abort()
        await bench.stop()
