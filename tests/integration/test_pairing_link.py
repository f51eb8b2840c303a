"""Pairing a station with a robot, over real sockets and real TLS: what a code is good for, and for whom."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from robot.access import Gate
from robot.pairing import CODE_LIFE_S, FILE_NAME, TRIES, PairingCode, PairingDesk
from shared.access import Role, Token
from shared.certificates import open_identity
from shared.errors import ConfigError
from shared.framing import MAX_STATION_PAYLOAD, encode_payload
from shared.message_codec import encode_message
from shared.messages import PROTOCOL_VERSION, PairProof, PairReply, PairRequest, Refusal
from shared.pairing import Pake
from shared.private_files import read_private
from shared.token_book import CONFIRM_WITHIN_S, TokenBook
from station.access import paired_robots
from station.access.connecting import connect_by_tls
from station.access.paired_robots import PairedRobots
from station.access.pairing import PairingFailed, confirm, pair
from station.main import app
from tests.support.access import GuardedBench, guarded_robot, linked, set_up, talking
from tests.support.link import until


async def test_pairing_gives_a_token_that_joins_and_pins_the_robot(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        paired = await pair("127.0.0.1", bench.port, code, "desk")
        assert paired.fingerprint == bench.gate.fingerprint.hex()
        robots.store(paired)
        assert robots.path.stat().st_mode & 0o777 == 0o600
        async with linked(bench.port, robots) as (link, notes):
            await until(lambda: link.state.connected)
            bench.imu.inject(500)
            bench.camera.put(t_robot_ns=77, size=60_000)
            await until(lambda: len(notes.sequences) == 500 and notes.frames)
            await until(
                lambda: link.commands.drive(0.2, -0.5, 200) and (0.2, -0.5) in {h[1:] for h in bench.motors.history}
            )
        with pytest.raises(PairingFailed, match="no pairing code is open"):  # it was good for one station
            await pair("127.0.0.1", bench.port, code, "desk")


async def test_a_token_that_reached_nobody_is_good_for_minutes_and_then_the_robot_is_unpaired_again(
    tmp_path: Path,
) -> None:
    async with guarded_robot(tmp_path) as bench:
        lost = await pair("127.0.0.1", bench.port, bench.gate.desk.open_code(Role.DRIVE, time.time()), "lost")
        assert not bench.gate.is_unpaired
        bench.gate.now_s = lambda: time.time() + CONFIRM_WITHIN_S
        assert bench.gate.is_unpaired
        token = Token.parse(lost.token)
        assert token is not None
        async with talking(bench) as talk:
            talk.say(talk.prove(token, await talk.hear_hello()))
            assert isinstance(await talk.hear(), Refusal)


@pytest.mark.parametrize("how", ["command", "first join"])
async def test_a_token_that_reached_its_station_lasts(tmp_path: Path, how: str) -> None:
    data = tmp_path / "data"
    robots = PairedRobots(data / "access")
    async with guarded_robot(tmp_path / "robot") as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        if how == "command":
            command = ["pair", f"127.0.0.1:{bench.port}", "--code", code, "--data", str(data)]
            paired = await asyncio.to_thread(CliRunner().invoke, app, command)
            assert paired.exit_code == 0 and "minutes" not in paired.output
        else:
            robots.store(await pair("127.0.0.1", bench.port, code, "desk"))
            async with linked(bench.port, robots) as (link, _):
                await until(lambda: link.state.connected)
        await until(lambda: [token.confirm_by_s for token in TokenBook(bench.folder).tokens()] == [None])
        bench.gate.now_s = lambda: time.time() + CONFIRM_WITHIN_S
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.state.connected)


async def test_pairing_at_the_address_of_another_robot_says_so_and_leaves_it_paired(tmp_path: Path) -> None:
    """A router gave the old one's address to the new one: the old one is driven at its new address, without a code."""
    data = tmp_path / "data"
    robots = PairedRobots(data / "access")
    async with guarded_robot(tmp_path / "old") as old, guarded_robot(tmp_path / "new") as new:
        old.admit("desk", Role.DRIVE, robots)
        stored = robots.all()[0]
        robots.store(msgspec.structs.replace(stored, robot_id="old", name="Old", port=new.port))
        command = ["pair", f"127.0.0.1:{new.port}", "--data", str(data), "--code"]
        code = new.gate.desk.open_code(Role.DRIVE, time.time())
        paired = await asyncio.to_thread(CliRunner().invoke, app, [*command, code])
        assert paired.exit_code == 0 and paired.output.count("it stays paired") == 1
        assert f"was paired at 127.0.0.1:{new.port} before and is no longer looked for there" in paired.output
        # As a robot beyond loopback would be met.
        connection = await connect_by_tls("127.0.0.1", old.port)
        assert not isinstance(robots.recognise(connection.fingerprint, "127.0.0.1", old.port), str)
        connection.writer.transport.abort()
        for bench in (old, new):
            async with linked(bench.port, robots) as (link, _):
                await until(lambda link=link: link.state.connected)
        code = new.gate.desk.open_code(Role.DRIVE, time.time())
        again = await asyncio.to_thread(CliRunner().invoke, app, [*command, code])
        assert again.exit_code == 0 and "looked for" not in again.output


async def test_who_cannot_use_its_token_at_once_says_what_to_do(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path / "robot") as bench:
        paired = await pair("127.0.0.1", bench.port, bench.gate.desk.open_code(Role.DRIVE, time.time()), "desk")
    assert "start the station within 5 minutes, else pair again" in await confirm(paired)


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


async def test_a_code_is_not_used_up_where_the_robot_cannot_be_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with guarded_robot(tmp_path / "robot") as bench:
        code = bench.gate.desk.open_code(Role.DRIVE, time.time())
        command = ["pair", f"127.0.0.1:{bench.port}", "--code", code, "--data", str(tmp_path / "data")]
        with monkeypatch.context() as full:
            full.setattr(paired_robots, "write_private", refuse)
            refused = await asyncio.to_thread(CliRunner().invoke, app, command)
        assert "No space left" in str(refused.exception) and not TokenBook(bench.folder).tokens()
        paired = await asyncio.to_thread(CliRunner().invoke, app, command)
        assert paired.exit_code == 0 and len(TokenBook(bench.folder).tokens()) == 1


def refuse(path: Path, content: bytes) -> None:
    raise ConfigError(f"{path} cannot be written (No space left on device)")


async def test_a_station_whose_name_cannot_be_seen_gets_one_that_can(tmp_path: Path) -> None:
    async with guarded_robot(tmp_path) as bench:
        for name in ("desk", "desk\u200b", "\u2060"):
            code = bench.gate.desk.open_code(Role.DRIVE, time.time())
            await pair("127.0.0.1", bench.port, code, name)
        assert {token.name for token in TokenBook(bench.folder).tokens()} == {"desk", "desk 2", "station"}


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
                await asyncio.to_thread(pake.receive, reply.message)
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
        pake.receive(reply.message)
        burst = (PairProof(mac=bytes(32)), PairProof(mac=pake.mac("station")))
        talk.say_bytes(b"".join(encode_payload(encode_message(proof), MAX_STATION_PAYLOAD) for proof in burst))
        assert isinstance(await talk.hear(), Refusal)
        await pair("127.0.0.1", bench.port, code, "desk")  # the second proof, a right one, was not looked at
        assert [token.name for token in TokenBook(bench.folder).tokens()] == ["desk"]
