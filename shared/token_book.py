"""The book of tokens of one program: a file, shared by the running program and the commands that change it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from shared.access import Role, Token, is_proof, is_secret_of
from shared.bounded import shown
from shared.errors import ConfigError
from shared.private_files import keep_spare, locked, make_private_folder, read_private, write_private
from shared.text import explain, is_seen_whole, look_of

FILE_NAME = "tokens.json"
MAX_SESSIONS = 32  # of one token; beyond, the oldest ends
KEPT_REVOKED_S = 90 * 86_400.0
CONFIRM_WITHIN_S = 300.0  # `station pair` does within a second; a station of an older release when it first joins
USE_RESOLUTION_S = 60.0  # `last_used_s` is no finer: not every call writes a file

Kind = Literal["token", "session", "link"]


class TokenRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One that may. A session (a browser's cookie) or link (good for one login) belongs to a token and ends with it."""

    id: str
    name: str
    role: Role
    digest: str  # hex SHA-256 of the secret
    created_s: float  # wall time
    kind: Kind = "token"
    parent: str | None = None
    expires_s: float | None = None
    confirm_by_s: float | None = None  # made by pairing, and whoever it was made for may never have received it
    last_used_s: float | None = None
    revoked_s: float | None = None

    def is_live(self, now_s: float) -> bool:
        """Neither revoked nor over."""
        if self.kind == "link" and now_s < self.created_s:
            return False  # a clock that was set back must not make ten minutes last for hours
        return self.revoked_s is None and not self.is_over(now_s)

    def is_over(self, now_s: float) -> bool:
        """It has expired, or nobody has used what was made by pairing."""
        return any(end_s is not None and now_s >= end_s for end_s in (self.expires_s, self.confirm_by_s))

    def __repr__(self) -> str:
        return f"TokenRecord({self.id}, {self.name!r}, {self.role.value})"


class _File(msgspec.Struct, frozen=True, kw_only=True):
    version: Literal[1] = 1
    tokens: tuple[TokenRecord, ...]  # a file without them is none of ours, and is not to be replaced by one


class TokenBook:
    """Who may. Every change is written at once, also on a full disk: space is kept for that.

    What other programs wrote is seen after `refresh`.

    The records are replaced, never changed: one thread may write while another asks. Threads write one after another,
    and nothing is read anew meanwhile, which would undo what is about to be written.
    """

    def __init__(self, folder: Path) -> None:
        """Raises ConfigError: there is no book, or it cannot be used."""
        self.path = folder / FILE_NAME
        self._records: dict[str, TokenRecord] = {}
        self._used: dict[str, float] = {}
        self._stamp: tuple[int, int, int] | None = None
        self._writer = threading.Lock()
        if not self.path.is_file():
            raise ConfigError(f"{self.path} does not exist; make it with `access init`")
        self._read()

    @classmethod
    def create(cls, folder: Path) -> TokenBook:
        """The book of this folder, an empty one if there was none."""
        make_private_folder(folder)
        path = folder / FILE_NAME
        with locked(path):
            if not path.exists():
                write_private(path, msgspec.json.encode(_File(tokens=())))
        return cls(folder)

    # Asking

    def refresh(self) -> bool:
        """Look whether another program has changed the book. A book that cannot be read lets nobody in."""
        if not self._writer.acquire(blocking=False):
            return False  # a thread of ours writes, and has read before; who asks is not to wait for the disk
        try:
            if self._stamp == self._stamp_now():
                return False
            self._read()
        except (OSError, ConfigError):
            self._records, self._stamp = {}, None
        finally:
            self._writer.release()
        return True

    def find(self, text: str, now_s: float) -> TokenRecord | None:
        """Who shows this token; None: nobody who may."""
        token = Token.parse(text)
        record = None if token is None else self.live(token.id, now_s)
        if token is None or record is None or not is_secret_of(token.secret, bytes.fromhex(record.digest)):
            return None
        return record

    def find_proof(
        self, token_id: str, proof: bytes, challenge: bytes, fingerprint: bytes, now_s: float
    ) -> TokenRecord | None:
        """Who answered the challenge; None: nobody who may."""
        record = self.live(token_id, now_s)
        if record is None or record.kind != "token":
            return None
        return record if is_proof(proof, bytes.fromhex(record.digest), token_id, challenge, fingerprint) else None

    def live(self, token_id: str, now_s: float) -> TokenRecord | None:
        """The record with this id while it, and the token it belongs to, may."""
        record = self._records.get(token_id)
        if record is None or not record.is_live(now_s):
            return None
        if record.parent is not None and self.live(record.parent, now_s) is None:
            return None
        return record

    def tokens(self) -> list[TokenRecord]:
        """All tokens, revoked ones too, oldest first; `last_used_s` includes their sessions' use."""
        used: dict[str, float] = {}
        for record in self._records.values():
            owner, last = record.parent or record.id, max(record.last_used_s or 0, self._used.get(record.id, 0))
            used[owner] = max(used.get(owner, 0), last)
        return [
            msgspec.structs.replace(record, last_used_s=used.get(record.id) or None)
            for record in self._records.values()
            if record.kind == "token"
        ]

    def has_live_token(self, now_s: float, role: Role = Role.WATCH) -> bool:
        """Whether there is a token that may at least as much as this role."""
        tokens = (record for record in self._records.values() if record.kind == "token")
        return any(token.is_live(now_s) and token.role.includes(role) for token in tokens)

    # Changing

    def add(
        self, name: str, role: Role, now_s: float, lifetime_s: float | None = None, *, is_confirmed: bool = True
    ) -> Token:
        """A new token; where it is not confirmed it ends in CONFIRM_WITHIN_S, unless `confirm` is called.

        Raises ConfigError: a live one has this name already.
        """
        if not 0 < len(name) <= 64 or not is_seen_whole(name) or name != name.strip():
            raise ConfigError(
                f"{shown(name)} is no name for a token; give 1 to 64 characters that can be seen, no space at its ends"
            )
        token = Token.new()
        with self._changing():
            alike = (r for r in self._records.values() if look_of(r.name) == look_of(name))
            if any(r.kind == "token" and r.is_live(now_s) for r in alike):
                raise ConfigError(f"there is a token named {name!r} already; revoke it first or choose another name")
            self._put(token, name, role, now_s, lifetime_s, is_confirmed=is_confirmed)
            self._write(now_s)
        return token

    def confirm(self, token_id: str, now_s: float) -> None:
        """Whoever a token was made for has it. Raises ConfigError: it cannot be written, and ends as before."""
        with self._changing():
            record = self.live(token_id, now_s)
            if record is not None and record.confirm_by_s is not None:
                self._records = {**self._records, token_id: msgspec.structs.replace(record, confirm_by_s=None)}
                self._write(now_s)

    def add_for(self, parent: TokenRecord, kind: Literal["session", "link"], now_s: float, lifetime_s: float) -> Token:
        owner = parent.parent or parent.id
        token = Token.new()
        with self._changing():
            if self.live(owner, now_s) is None:
                raise ConfigError("this token was revoked meanwhile")
            same = [r.id for r in self._records.values() if r.parent == owner and r.kind == kind]
            oldest = set(same[: max(0, len(same) - MAX_SESSIONS + 1)])
            self._records = {token_id: r for token_id, r in self._records.items() if token_id not in oldest}
            self._put(token, parent.name, parent.role, now_s, lifetime_s, kind, owner)
            self._write(now_s)
        return token

    def revoke(self, name_or_id: str, now_s: float) -> list[TokenRecord]:
        """End a token (all live ones of this name, or the one with this id) and all that belongs to it.

        Raises ConfigError: it cannot be written, and nobody is revoked.
        """
        with self._changing():
            ended = [r for r in self._records.values() if r.is_live(now_s) and name_or_id in (r.id, r.name)]
            ended = [r for r in ended if r.kind == "token" or r.id == name_or_id]
            marked = {record.id: msgspec.structs.replace(record, revoked_s=now_s) for record in ended}
            self._records = {**self._records, **marked}  # `_write` drops sessions that are over
            if ended:
                self._write(now_s)
        return ended

    def use(self, record: TokenRecord, now_s: float) -> None:
        """Note that it was used just now; written by `flush`."""
        self._used[record.id] = now_s

    def flush(self, now_s: float) -> None:
        """Write when tokens were last used, if that is older than USE_RESOLUTION_S in the file, or lies ahead.

        The clock may have been ahead and been put right.
        """
        used_now = list(self._used.items())  # in one step: another thread may note a use meanwhile
        for token_id, _ in used_now:
            if token_id not in self._records:
                self._used.pop(token_id, None)  # a session that is over
        due = {
            token_id: t
            for token_id, t in used_now
            if (record := self._records.get(token_id)) is not None
            and abs(t - (record.last_used_s or 0)) >= USE_RESOLUTION_S
        }
        if not due:
            return
        with self._changing():
            used = {
                token_id: msgspec.structs.replace(self._records[token_id], last_used_s=t)
                for token_id, t in due.items()
                if token_id in self._records
            }
            self._records = {**self._records, **used}
            self._write(now_s)

    def _put(
        self,
        token: Token,
        name: str,
        role: Role,
        now_s: float,
        lifetime_s: float | None,
        kind: Kind = "token",
        parent: str | None = None,
        *,
        is_confirmed: bool = True,
    ) -> None:
        made = TokenRecord(
            id=token.id,
            name=name,
            role=role,
            digest=token.digest.hex(),
            created_s=now_s,
            kind=kind,
            parent=parent,
            expires_s=None if lifetime_s is None else now_s + lifetime_s,
            confirm_by_s=None if is_confirmed else now_s + CONFIRM_WITHIN_S,
        )
        self._records = {**self._records, token.id: made}

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """Alone among threads and programs, and with what they wrote last; what cannot be written is not so."""
        with self._writer, locked(self.path):
            self._read()
            written = self._records
            try:
                yield
            except BaseException:
                self._records = written
                raise

    def _read(self) -> None:
        stamp = self._stamp_now()  # before the content: what is written in between is found at the next look
        content = read_private(self.path)
        if content is None:
            raise ConfigError(f"{self.path} is gone; make it again with `access init`")
        try:
            tokens = msgspec.json.decode(content, type=_File).tokens
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as exc:
            raise ConfigError(
                f"{self.path} is damaged ({explain(exc)}); delete it and run `access init` again"
            ) from exc
        self._records = {record.id: record for record in tokens}
        self._stamp = stamp

    def _write(self, now_s: float) -> None:
        """Without sessions that are over, or whose token is, what nobody confirmed, and what was revoked long ago."""
        kept = [
            record
            for record in self._records.values()
            if (now_s - (record.revoked_s or now_s) < KEPT_REVOKED_S)
            and ((record.kind == "token" and record.confirm_by_s is None) or self.live(record.id, now_s) is not None)
        ]
        self._records = {record.id: record for record in kept}
        content = msgspec.json.format(msgspec.json.encode(_File(tokens=tuple(kept))))
        write_private(self.path, content)
        self._stamp = self._stamp_now()
        keep_spare(self.path)

    def _stamp_now(self) -> tuple[int, int, int]:
        try:
            status = self.path.stat()
        except FileNotFoundError as exc:
            raise ConfigError(f"{self.path} is gone; make it again with `access init`") from exc
        return status.st_mtime_ns, status.st_ino, status.st_size
