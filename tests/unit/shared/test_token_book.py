"""The book of tokens and the private files it is kept in: who may, also after power cuts and on full disks."""

from __future__ import annotations

import contextlib
import os
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import shared.token_book
from shared.access import Role, Token
from shared.errors import ConfigError
from shared.private_files import locked, read_private, write_private
from shared.token_book import CONFIRM_WITHIN_S, MAX_SESSIONS, TokenBook, TokenRecord
from tests.support.disk import fill, small_disk


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


def test_what_pairing_made_and_nobody_used_ends_and_is_forgotten(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    lost, used = (book.add(name, Role.DRIVE, 0.0, is_confirmed=False) for name in ("lost", "used"))
    book.confirm(used.id, 1.0)
    again = TokenBook(tmp_path)
    assert [again.find(token.text, CONFIRM_WITHIN_S - 1.0) is not None for token in (lost, used)] == [True, True]
    assert [again.find(token.text, CONFIRM_WITHIN_S) is not None for token in (lost, used)] == [False, True]
    again.confirm(lost.id, CONFIRM_WITHIN_S)  # too late
    assert again.find(lost.text, CONFIRM_WITHIN_S) is None
    again.add("lost", Role.DRIVE, CONFIRM_WITHIN_S)  # the name is free
    assert [token.name for token in TokenBook(tmp_path).tokens()] == ["used", "lost"]


@contextlib.contextmanager
def book_on_small_disk(tmp_path: Path, *names: str) -> Iterator[tuple[Path, TokenBook, list[Token]]]:
    """The disk, a book on it, and the tokens of these admins."""
    with small_disk(tmp_path / "disk", "1m") as disk:
        book = TokenBook.create(disk / "access")
        yield disk, book, [book.add(name, Role.ADMIN, 0.0) for name in names]


def test_who_is_revoked_on_a_full_disk_stays_out_also_after_a_restart(tmp_path: Path) -> None:
    names = ("anna", "ben")
    with book_on_small_disk(tmp_path, *names) as (disk, book, tokens):
        for name, gone in zip(names, tokens, strict=True):
            fill(disk)
            assert [r.name for r in book.revoke(name, 1.0)] == [name]
            assert book.find(gone.text, 2.0) is None
            assert TokenBook(disk / "access").find(gone.text, 2.0) is None


def test_who_cannot_be_revoked_is_not_said_to_be(tmp_path: Path) -> None:
    with book_on_small_disk(tmp_path, "anna") as (disk, book, (token,)):
        fill(disk)
        (disk / "access" / "tokens.json.spare").unlink()
        fill(disk)
        with pytest.raises(ConfigError, match="No space left"):
            book.revoke("anna", 1.0)
        assert [t.revoked_s for t in book.tokens()] == [None]  # as it will be after a restart
        with pytest.raises(ConfigError, match="No space left"):
            book.add("ben", Role.WATCH, 1.0)
        assert [t.name for t in book.tokens()] == ["anna"]
        still = book.find(token.text, 2.0)
        assert still is not None and (still.name, still.role, still.revoked_s) == ("anna", Role.ADMIN, None)


def test_names_are_unique_among_those_who_may_and_lifetimes_end(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    token = book.add("guest", Role.WATCH, 0.0, lifetime_s=10.0)
    with pytest.raises(ConfigError, match="already"):
        book.add("guest", Role.WATCH, 5.0)
    assert book.find(token.text, 9.0) is not None and book.find(token.text, 10.0) is None
    for name in ("", "x" * 65, "a\nb"):
        with pytest.raises(ConfigError, match="no name"):
            book.add(name, Role.WATCH, 0.0)


def test_who_reads_the_list_can_tell_names_apart_and_type_them(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    for name in ("anna", "José", "می\u200cخواهم", "👩\u200d🚀", "葛\U000e0100"):
        book.add(name, Role.WATCH, 0.0)
    for name in (
        "anna\u200b",
        "\u200b",
        "\u200d",
        "\ufeffanna",
        "an\xadna",
        "\u2800",
        "\u3164",
        "\U000e0041",
        " anna",
        "anna ",
    ):
        with pytest.raises(ConfigError, match="can be seen"):
            book.add(name, Role.WATCH, 0.0)
    for name in ("anna\u200d", "anna\ufe00", "Jose\u0301"):
        with pytest.raises(ConfigError, match="already"):
            book.add(name, Role.WATCH, 0.0)


def test_a_clock_that_was_set_back_makes_no_link_last(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    anna = book.add("anna", Role.DRIVE, 0.0)
    record = book.find(anna.text, 90_000.0)
    assert record is not None and record.name == "anna"
    link = book.add_for(record, "link", 90_000.0, 600.0)
    found = book.find(link.text, 90_001.0)
    assert found is not None and (found.kind, found.name) == ("link", "anna")
    assert book.find(link.text, 90_600.0) is None
    assert book.find(link.text, 80_000.0) is None
    assert book.find(anna.text, 80_000.0) == record  # her token has no end, whatever the clock


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


def test_a_last_use_of_a_clock_that_was_ahead_is_corrected(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    record = book.find(book.add("anna", Role.DRIVE, 0.0).text, 0.0)
    assert record is not None
    for t_s in (9e9, 100.0):
        book.use(record, t_s)
        book.flush(t_s)
    assert TokenBook(tmp_path).tokens()[0].last_used_s == 100.0


@pytest.mark.parametrize("content", ["{", "{}", '{"a": 1}', 50_000 * '{"a":'])
def test_a_damaged_book_lets_nobody_in(tmp_path: Path, content: str) -> None:
    book = TokenBook.create(tmp_path)
    token = book.add("anna", Role.DRIVE, 0.0)
    book.path.write_text(content)
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


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_a_secret_that_is_no_file_is_refused_at_once(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "x")
    with pytest.raises(ConfigError, match=r"x cannot be read: it is a (pipe|device), no file; put a regular file"):
        read_private(tmp_path / "x")


def test_a_book_that_became_a_pipe_lets_nobody_in_and_holds_nobody_up(tmp_path: Path) -> None:
    book = TokenBook.create(tmp_path)
    token = book.add("anna", Role.ADMIN, 0.0)
    book.path.unlink()
    os.mkfifo(book.path, 0o600)
    assert book.refresh() and book.find(token.text, 0.0) is None


def test_a_secret_without_end_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "x").open("wb") as file:
        os.fchmod(file.fileno(), 0o600)
        file.truncate(1 << 40)
    with pytest.raises(ConfigError, match="more than such a file ever has"):
        read_private(tmp_path / "x")


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x"
    write_private(path, b"old")

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ConfigError, match="No space left"):
        write_private(path, b"new")
    assert read_private(path) == b"old" and list(tmp_path.iterdir()) == [path]
