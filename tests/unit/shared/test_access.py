"""Tokens, their book, guesses, codes, and who may not start; no socket."""

from __future__ import annotations

import asyncio
import os
import re
import socket
import stat
import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import robot.access
import shared.token_book
import station.api.roles
from robot.access import open_gate
from robot.config import AccessConfig, RobotConfig, ServerConfig
from robot.pairing import CODE_LIFE_S, MAX_EXCHANGES, TRIES, PairingDesk, PairingRefused
from shared.access import GuessLimit, Role, Token, is_proof, is_secret_of, prove
from shared.certificates import make_identity, open_identity
from shared.errors import ConfigError, LocalProtocolError, RemoteProtocolError
from shared.listening import is_loopback
from shared.pairing import Pake, parse_code, show_code
from shared.private_files import locked, read_private, write_private
from shared.token_book import MAX_SESSIONS, TokenBook, TokenRecord
from station.access.expiry import expiry_sentence, watch_expiry
from station.access.visitors import Door, open_access
from station.config import AccessConfig as StationAccessConfig
from station.config import ApiConfig, StationConfig
from station.errors import Conflict, TooManyGuesses, WrongToken
from tests.support.access import NOW, set_up
from tests.support.disk import fill, small_disk


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


def test_a_book_keeps_no_secret_and_only_its_owner_reads_it(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path / "new")
    token = book.add("anna", Role.DRIVE, 10.0)
    content = book.path.read_text()
    assert stat.S_IMODE(book.path.stat().st_mode) == 0o600 and stat.S_IMODE(book.path.parent.stat().st_mode) == 0o700
    for form in (token.text, token.secret.hex(), token.text.split("_", 2)[2]):
        assert form not in content
    found = TokenBook(tmp_path / "new").find(token.text, 11.0)
    assert found is not None and (found.name, found.role) == ("anna", Role.DRIVE)
    book.path.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        TokenBook(tmp_path / "new")


def test_revoking_ends_a_token_and_its_sessions_and_others_see_it(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    token, other = book.add("anna", Role.DRIVE, 0.0), book.add("ben", Role.WATCH, 0.0)
    anna = book.find(token.text, 1.0)
    assert anna is not None
    session = book.add_for(anna, "session", 1.0, 100.0)
    running = TokenBook(tmp_path)
    assert running.find(session.text, 2.0) is not None and not running.refresh()
    book.revoke("anna", 2.0)
    assert running.refresh()
    assert running.find(token.text, 3.0) is None and running.find(session.text, 3.0) is None
    assert running.find(other.text, 3.0) is not None
    assert [(t.name, t.revoked_s) for t in running.tokens()] == [("anna", 2.0), ("ben", None)]
    assert book.add("anna", Role.WATCH, 4.0).text != token.text  # the name is free again


def test_who_is_revoked_on_a_full_disk_stays_out_also_after_a_restart(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "1m") as disk:
        book = TokenBook.create(disk / "access")
        token = book.add("anna", Role.ADMIN, 0.0)
        other = book.add("ben", Role.ADMIN, 0.0)
        for name, gone in {"anna": token, "ben": other}.items():
            fill(disk)
            assert [r.name for r in book.revoke(name, 1.0)] == [name]
            assert book.find(gone.text, 2.0) is None
            assert TokenBook(disk / "access").find(gone.text, 2.0) is None


def test_who_cannot_be_revoked_is_not_said_to_be(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "1m") as disk:
        book = TokenBook.create(disk / "access")
        token = book.add("anna", Role.ADMIN, 0.0)
        fill(disk)
        (disk / "access" / "tokens.json.spare").unlink()
        fill(disk)
        with pytest.raises(ConfigError, match="No space left"):
            book.revoke("anna", 1.0)
        assert [t.revoked_s for t in book.tokens()] == [None]  # as it will be after a restart
        with pytest.raises(ConfigError, match="No space left"):
            book.add("ben", Role.WATCH, 1.0)
        assert [t.name for t in book.tokens()] == ["anna"]
        assert book.find(token.text, 2.0) is not None


def test_names_are_unique_among_those_who_may_and_lifetimes_end(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    token = book.add("guest", Role.WATCH, 0.0, lifetime_s=10.0)
    with pytest.raises(ConfigError, match="already"):
        book.add("guest", Role.WATCH, 5.0)
    assert book.find(token.text, 9.0) is not None and book.find(token.text, 10.0) is None
    for name in ("", "x" * 65, "a\nb"):
        with pytest.raises(ConfigError, match="no name"):
            book.add(name, Role.WATCH, 0.0)


def test_a_token_has_so_many_sessions_then_the_oldest_ends(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    record = book.find(book.add("anna", Role.DRIVE, 0.0).text, 0.0)
    assert record is not None
    sessions = [book.add_for(record, "session", float(n), 1e6) for n in range(MAX_SESSIONS + 1)]
    assert book.find(sessions[0].text, 50.0) is None and book.find(sessions[1].text, 50.0) is not None


def test_the_last_use_is_kept_to_the_minute(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    record = book.find(book.add("anna", Role.DRIVE, 0.0).text, 0.0)
    assert record is not None
    book.use(record, 100.0)
    book.flush(100.0)
    book.use(record, 110.0)
    before = book.path.stat().st_mtime_ns
    book.flush(110.0)
    assert book.path.stat().st_mtime_ns == before
    assert TokenBook(tmp_path).tokens()[0].last_used_s == 100.0


def test_a_damaged_book_lets_nobody_in(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    token = book.add("anna", Role.DRIVE, 0.0)
    book.path.write_text("{")
    assert book.refresh() and book.find(token.text, 1.0) is None
    with pytest.raises(ConfigError, match="damaged"):
        TokenBook(tmp_path)


def test_what_is_written_while_a_book_is_read_is_found_at_the_next_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    book = TokenBook.create(tmp_path)
    running, token = TokenBook(tmp_path), book.add("anna", Role.DRIVE, 0.0)
    revoked: list[TokenRecord] = []

    def read_late(path: Path) -> bytes | None:
        content = read_private(path)
        monkeypatch.undo()
        revoked.extend(book.revoke("anna", 1.0))  # another program, between reading and looking at the file's time
        return content

    monkeypatch.setattr(shared.token_book, "read_private", read_late)
    assert running.refresh() and revoked
    assert running.refresh() and running.find(token.text, 2.0) is None


def test_a_look_at_the_book_does_not_undo_what_another_thread_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    book = TokenBook.create(tmp_path)
    token = book.add("anna", Role.DRIVE, 0.0)

    def write_late(path: Path, content: bytes) -> None:
        os.utime(path, ns=(1, 1))  # it looks changed
        looking = threading.Thread(target=book.refresh)
        looking.start()
        looking.join()
        write_private(path, content)

    monkeypatch.setattr(shared.token_book, "write_private", write_late)
    book.revoke("anna", 1.0)
    assert book.find(token.text, 2.0) is None
    made = book.add("ben", Role.WATCH, 1.0)
    assert book.find(made.text, 2.0) is not None


def test_what_is_written_outlives_a_power_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[bool] = []
    monkeypatch.setattr(os, "fsync", lambda fd: kept.append(stat.S_ISDIR(os.fstat(fd).st_mode)))
    write_private(tmp_path / "x", b"new")
    assert kept == [False, True]  # the file before its name


def test_what_root_writes_belongs_to_the_owner_of_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`sudo robot-server access revoke` must not take the book from the service."""
    given: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(os, "fchown", lambda _, uid, gid: given.append((uid, gid)))
    owner = (tmp_path.stat().st_uid, tmp_path.stat().st_gid)
    for times in (1, 2):  # the lock's file is made once
        with locked(tmp_path / "x"):
            write_private(tmp_path / "x", b"new")
        assert given == [owner] * (times + 1)


def test_a_lock_follows_no_link(tmp_path: Path) -> None:
    (tmp_path / "x.lock").symlink_to(tmp_path / "another's")
    with pytest.raises(ConfigError), locked(tmp_path / "x"):
        pass
    assert not (tmp_path / "another's").exists()


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x"
    write_private(path, b"old")

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ConfigError, match="No space left"):
        write_private(path, b"new")
    assert read_private(path) == b"old" and list(tmp_path.iterdir()) == [path]


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
