"""Tokens, guesses, codes, and who may not start; no socket. Their book: test_token_book.py."""

from __future__ import annotations

import asyncio
import re
import socket
import stat
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import robot.access
import station.api.roles
from robot.access import Gate, open_gate
from robot.config import AccessConfig, RobotConfig, ServerConfig
from robot.pairing import CODE_LIFE_S, MAX_EXCHANGES, TRIES, PairingDesk, PairingRefused
from shared.access import GuessLimit, Role, Token, is_proof, is_secret_of, prove
from shared.certificates import make_identity, open_identity
from shared.disk import SCRATCH
from shared.errors import ConfigError, LocalProtocolError, RemoteProtocolError
from shared.listening import is_loopback
from shared.pairing import Pake, parse_code, show_code
from shared.token_book import TokenBook, TokenRecord
from station.access.expiry import expiry_sentence, watch_expiry
from station.access.visitors import Door, open_access
from station.config import AccessConfig as StationAccessConfig
from station.config import ApiConfig, StationConfig
from station.errors import Conflict, TooManyGuesses, WrongToken
from tests.support.access import NOW, set_up


def test_roles_include_the_ones_before_them() -> None:
    for n, role in enumerate(Role):
        assert [role.includes(other) for other in Role] == [m <= n for m in range(len(Role))]


def test_a_token_is_read_as_it_was_written_and_nothing_else_is_one() -> None:
    token = Token.new()
    assert Token.parse(token.text) == token and Token.parse(f" {token.text}\n") == token
    assert is_secret_of(token.secret, token.digest) and not is_secret_of(Token.new().secret, token.digest)
    for text in (
        "",
        "sentinel",
        "sentinel_a_b",
        token.text[:-1],
        token.text + "A",
        "x" + token.text,
        "sentinel_é_",
    ):
        assert Token.parse(text) is None
    assert token.text not in f"{token} {token!r}" and token.secret.hex() not in repr(token)


@given(st.text(max_size=200))
def test_any_text_is_read_without_an_error(text: str) -> None:
    Token.parse(text)
    GuessLimit().wrong("a", text.encode("utf-8", "surrogatepass"), 0.0)


@given(st.binary(max_size=64), st.binary(min_size=32, max_size=32), st.binary(max_size=40))
def test_a_proof_fits_one_challenge_one_certificate_and_one_token(a: bytes, print_: bytes, other: bytes) -> None:
    token = Token.new()
    proof = prove(token, a, print_)
    assert is_proof(proof, token.digest, token.id, a, print_)
    assert is_proof(proof, token.digest, token.id, other, print_) == (other == a)
    assert not is_proof(proof, token.digest, token.id, a, print_[::-1] + b"x")
    assert not is_proof(proof, token.digest, token.id + "x", a, print_)
    assert not is_proof(proof, Token.new().digest, token.id, a, print_)
    assert not is_proof(other, token.digest, token.id, a, print_)


def test_wrong_guesses_are_counted_once_each_and_forgotten() -> None:
    limit = GuessLimit(limit=3, window_s=60.0)
    for t in range(20):
        limit.wrong("page", b"the same old cookie", float(t))
    assert limit.wait_s("page", 20.0) == 0
    for t in range(3):
        limit.wrong("thief", bytes([t]), float(t))
    assert limit.wait_s("thief", 3.0) == pytest.approx(57.0) and limit.wait_s("page", 3.0) == 0
    assert limit.wait_s("thief", 60.0) == 0


def test_a_clock_that_was_set_back_makes_nobody_wait_for_years() -> None:
    limit = GuessLimit(limit=1, window_s=60.0)
    limit.wrong("a", b"x", 1e9)
    assert limit.wait_s("a", 1e9) > 0 and limit.wait_s("a", 0.0) == 0


@pytest.mark.parametrize(
    ("guesser", "same", "other"),
    [
        ("192.168.1.4", "::ffff:192.168.1.4", "192.168.1.5"),
        ("::ffff:192.168.1.4", "192.168.1.4", "::ffff:192.168.1.5"),  # all of IPv4, to a socket for both kinds
        ("fe80::1%eth0", "fe80::2", "fe81::1"),
        ("2001:db8::1", "2001:db8::ffff:1", "2001:db8:0:1::1"),
    ],
)
def test_guesses_count_for_a_machine_or_an_ipv6_network(guesser: str, same: str, other: str) -> None:
    limit = GuessLimit(limit=1)
    limit.wrong(guesser, b"x", 0.0)
    assert limit.wait_s(same, 1.0) > 0 and limit.wait_s(other, 1.0) == 0


def test_the_list_of_addresses_is_bounded() -> None:
    limit = GuessLimit(limit=1, max_addresses=10)
    for n in range(1000):
        limit.wrong(str(n), b"x", 0.0)
    assert limit.wait_s("999", 1.0) > 0 and limit.wait_s("0", 1.0) == 0


def test_codes_are_read_as_people_type_them() -> None:
    assert parse_code(" 123-456 ") == parse_code("123 456") == "123456" and show_code("123456") == "123-456"
    for text in ("12345", "1234567", "abcdef", "", "١٢٣٤٥٦"):
        with pytest.raises(ConfigError, match="six digits"):
            parse_code(text)


def test_both_sides_of_a_pairing_agree_only_on_the_same_code_and_certificate() -> None:
    for code, fingerprint, agree in (("111111", b"a", True), ("111112", b"a", False), ("111111", b"b", False)):
        robot_, station_ = Pake("robot", "111111", b"a"), Pake("station", code, fingerprint)
        robot_.receive(station_.message)
        station_.receive(robot_.message)
        assert robot_.is_mac("station", station_.mac("station")) == agree
        assert station_.is_mac("robot", robot_.mac("robot")) == agree
        assert not robot_.is_mac("station", robot_.mac("robot"))  # its own proof, sent back to it


def test_a_side_that_heard_nothing_accepts_no_proof() -> None:
    pake = Pake("robot", "111111", b"")
    assert not pake.is_mac("station", pake.mac("station"))


@given(st.binary(min_size=32, max_size=32))
def test_noise_in_a_pairing_is_refused(message: bytes) -> None:
    pake = Pake("robot", "111111", b"")
    try:
        pake.receive(b"C" + message)
    except RemoteProtocolError:
        return
    assert not pake.is_mac("station", bytes(32))


def test_a_code_allows_so_many_exchanges(tmp_path: Path) -> None:
    desk = PairingDesk(tmp_path, TokenBook.create(tmp_path), b"f")
    code = desk.open_code(Role.WATCH, 0.0)
    for _ in range(MAX_EXCHANGES):
        desk.exchange(Pake("station", code, b"f").message, 1.0)
    with pytest.raises(PairingRefused):
        desk.exchange(Pake("station", code, b"f").message, 1.0)


def test_proofs_at_once_are_judged_as_often_as_one_after_the_other(tmp_path: Path) -> None:
    desk = PairingDesk(tmp_path, TokenBook.create(tmp_path), b"f")
    code = desk.open_code(Role.WATCH, 0.0)
    wrong = f"{(int(code) + 1) % 1_000_000:06d}"
    begun = [desk.exchange(Pake("station", wrong, b"f").message, 1.0) for _ in range(MAX_EXCHANGES - 1)]

    def guess(pake: Pake) -> str:
        with pytest.raises(PairingRefused) as refused:
            desk.finish(pake, bytes(32), "thief", 2.0)
        return str(refused.value)

    with ThreadPoolExecutor(8) as threads:
        answers = list(threads.map(guess, begun))
    assert sum("the code is wrong" in answer for answer in answers) == TRIES
    assert sum("no pairing code is open" in answer for answer in answers) == len(begun) - TRIES


def test_a_clock_that_was_set_back_does_not_lengthen_a_code(tmp_path: Path) -> None:
    desk = PairingDesk(tmp_path, TokenBook.create(tmp_path), b"f")
    code = desk.open_code(Role.WATCH, 1_000_000.0)
    for now_s in (0.0, 1_000_000.0 + CODE_LIFE_S):
        with pytest.raises(PairingRefused):
            desk.exchange(Pake("station", code, b"f").message, now_s)


def test_an_exchange_for_an_earlier_code_gets_nothing_of_the_next_one(tmp_path: Path) -> None:
    """Who was shown a code to watch with gets no token to drive with, should that be the role of the next code."""
    book = TokenBook.create(tmp_path)
    desk = PairingDesk(tmp_path, book, b"f")
    early = Pake("station", desk.open_code(Role.WATCH, 0.0), b"f")
    robot_ = desk.exchange(early.message, 1.0)
    early.receive(robot_.message)
    code = desk.open_code(Role.DRIVE, 2.0)
    for _ in range(TRIES):
        with pytest.raises(PairingRefused, match="another code"):
            desk.finish(robot_, early.mac("station"), "desk", 3.0)
    assert not book.tokens()
    late = Pake("station", code, b"f")
    robot_ = desk.exchange(late.message, 4.0)
    late.receive(robot_.message)
    assert book.find(desk.finish(robot_, late.mac("station"), "desk", 5.0).text, 6.0) is not None


def test_a_robot_that_starts_leaves_the_code_that_the_installer_showed(tmp_path: Path) -> None:
    desk = PairingDesk(tmp_path, TokenBook.create(tmp_path), b"f")
    first = desk.first_code(0.0)
    assert desk.first_code(1.0) == first
    with pytest.raises(PairingRefused):
        desk.exchange(Pake("station", first, b"f").message, CODE_LIFE_S)
    later = desk.first_code(CODE_LIFE_S)  # the first one is over
    assert desk.exchange(Pake("station", later, b"f").message, CODE_LIFE_S + 1.0).is_for(later)


def test_a_robot_that_starts_removes_what_a_kill_left_half_written(tmp_path: Path) -> None:
    set_up(tmp_path)
    before = set(tmp_path.iterdir())
    (tmp_path / f"{SCRATCH}0123456789abcdef").write_bytes(b"half a book")
    Gate(tmp_path)
    assert set(tmp_path.iterdir()) == before


def test_an_identity_is_known_again_and_a_new_one_is_another(tmp_path: Path) -> None:
    first = make_identity(tmp_path, "x", ["localhost", "127.0.0.1", "::1", "häuschen.local"], 10, NOW)
    assert open_identity(tmp_path) == first and stat.S_IMODE(first.key.stat().st_mode) == 0o600
    assert make_identity(tmp_path, "x", ["localhost"], 10, NOW).fingerprint != first.fingerprint
    first.key.write_text("no key")
    with pytest.raises(ConfigError, match="cannot be used"):
        open_identity(tmp_path)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.1", "::1", "localhost"])
def test_loopback_is_loopback(host: str) -> None:
    assert is_loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.20", "", "no.such.invalid", "127.0.0.1.evil.invalid"])
def test_everything_else_is_not(host: str) -> None:
    assert not is_loopback(host)


def test_a_robot_beyond_loopback_does_not_start_unless_it_is_set_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))  # whoever runs this may have set up a robot of their own
    beyond, folder = ServerConfig(host="0.0.0.0"), tmp_path / "r"
    guarded = RobotConfig(server=beyond, access=AccessConfig(folder=str(folder)))
    with pytest.raises(ConfigError, match="robot-server access init"):
        open_gate(guarded)
    set_up(folder)
    assert open_gate(guarded) is not None
    assert open_gate(RobotConfig(access=AccessConfig(folder=str(folder)))) is not None  # asked for on loopback
    assert open_gate(RobotConfig()) is None and open_gate(RobotConfig(), "127.0.0.1") is None
    with pytest.raises(ConfigError, match="not set up"):  # its name meant another address when the port was taken
        open_gate(RobotConfig(server=ServerConfig(host="localhost")), "192.168.1.20")
    assert open_gate(RobotConfig(server=beyond, access=AccessConfig(insecure=True))) is None


def test_a_station_that_asks_nobody_says_how_that_is_changed(tmp_path: Path) -> None:
    access = open_access(StationConfig(data_dir=tmp_path))
    with pytest.raises(Conflict, match=re.escape(f"`station access init --data {tmp_path}` sets it up")):
        _ = access.door.book


def test_a_station_beyond_loopback_does_not_start_unless_it_is_set_up(tmp_path: Path) -> None:
    beyond = StationConfig(data_dir=tmp_path, api=ApiConfig(host="0.0.0.0"))
    with pytest.raises(ConfigError, match="station access init"):
        open_access(beyond)
    set_up(tmp_path / "access")
    access = open_access(beyond)
    assert not access.door.is_open and access.identity is not None
    assert open_access(StationConfig(data_dir=tmp_path)).door.is_open
    on_loopback = StationConfig(data_dir=tmp_path, access=StationAccessConfig(on_loopback=True))
    assert not open_access(on_loopback).door.is_open


async def test_a_station_does_not_serve_a_socket_that_others_reach_without_a_book(tmp_path: Path) -> None:
    from station.api.server import make_api
    from station.api.serving import serve
    from station.app import Station

    station = Station(StationConfig(data_dir=tmp_path))
    with socket.socket() as taken:
        taken.bind(("0.0.0.0", 0))  # taken, but not listened on: nobody reaches it
        with pytest.raises(ConfigError, match="which others reach"):
            await serve(station, make_api(station), taken)


def test_a_message_or_call_without_a_role_keeps_the_program_from_starting(monkeypatch: pytest.MonkeyPatch) -> None:
    from station.api.server import all_calls

    monkeypatch.delitem(robot.access.MESSAGE_ROLES, robot.access.Stop)
    with pytest.raises(LocalProtocolError, match="Stop"):
        robot.access.check_roles()
    monkeypatch.delitem(station.api.roles.ROLES, "POST /stop")
    with pytest.raises(LocalProtocolError, match="POST /stop"):
        station.api.roles.check_roles(all_calls())


def test_the_door_counts_guesses_and_a_link_is_good_for_one_login(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    door = Door(book, lambda: 100.0)
    record = book.find(book.add("anna", Role.DRIVE, 0.0).text, 1.0)
    assert record is not None
    link = book.add_for(record, "link", 1.0, 600.0).text
    with pytest.raises(WrongToken, match="one login"):
        door.admit(link, "bearer", "a")
    visitor, session = door.login(link, "a")
    assert (visitor.name, visitor.role) == ("anna", Role.DRIVE) and door.admit(session, "cookie", "a").name == "anna"
    with pytest.raises(WrongToken):
        door.login(link, "a")
    for _ in range(9):
        with pytest.raises(WrongToken):
            door.admit(Token.new().text, "bearer", "a")
    with pytest.raises(TooManyGuesses):
        door.admit(Token.new().text, "bearer", "a")
    assert door.admit(session, "cookie", "a").name == "anna"  # others' guesses keep nobody from STOP
    with pytest.raises(WrongToken, match="no other session"):
        door.login(session, "a")


def test_of_two_logins_at_once_with_one_link_one_gets_in(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    record = book.find(book.add("anna", Role.DRIVE, 0.0).text, 1.0)
    assert record is not None
    link = book.add_for(record, "link", 1.0, 600.0).text
    inside: list[str] = []

    class Twice(Door):
        def _find(self, shown: str, address: str) -> TokenRecord:
            found = super()._find(shown, address)
            if not inside:
                inside.append("")
                inside.append(self.login(link, "b")[1])
            return found

    door = Twice(book, lambda: 100.0)
    with pytest.raises(WrongToken, match="used already"):
        door.login(link, "a")
    assert door.admit(inside[1], "cookie", "b").name == "anna"


def test_a_certificate_is_complained_about_in_its_last_month(tmp_path: Path) -> None:
    identity = make_identity(tmp_path, "test", ["localhost"], 100, NOW)
    said = [expiry_sentence(identity, NOW + timedelta(days=days)) for days in (0, 69, 71, 99.5, 101)]
    assert said[:2] == ["", ""] and expiry_sentence(None, NOW) == ""
    assert "good for 29 more days" in said[2] and "good for 0 more days" in said[3] and "has expired" in said[4]
    assert all("station access init --renew" in sentence for sentence in said[2:])


async def test_the_warning_comes_at_the_start_and_none_without_a_certificate(tmp_path: Path) -> None:
    identity = make_identity(tmp_path, "test", ["localhost"], 3, datetime.now(UTC))
    said: list[str] = []
    watching = asyncio.create_task(watch_expiry(identity, said.append))
    await asyncio.sleep(0)
    watching.cancel()
    await watch_expiry(None, said.append)
    assert len(said) == 1 and "more days" in said[0]
