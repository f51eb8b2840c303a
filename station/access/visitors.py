"""Who may ask this station, and which robots it trusts. Knows no HTTP: `api/doorkeeper.py` is its doorkeeper."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from shared.access import GuessLimit, Role
from shared.advice import complete, option
from shared.certificates import Identity, open_identity
from shared.errors import ConfigError
from shared.listening import is_loopback
from shared.token_book import TokenBook, TokenRecord
from station.access.paired_robots import PairedRobots
from station.config import StationConfig
from station.errors import Conflict, TooManyGuesses, WrongToken

logger = logging.getLogger(__name__)
FOLDER = "access"
LOOK_S = 0.5  # who was revoked is out by then
FLUSH_S = 60.0
SESSION_S = 30 * 86_400.0
LINK_S = 600.0
MAX_TOKEN_DAYS = 36_500  # of one that ends by itself


@dataclass(frozen=True, slots=True)
class Visitor:
    """Who asks."""

    name: str
    role: Role
    token_id: str  # empty: the door stands open
    holder: str  # id of the token that it goes by: a browser's session belongs to one
    by: Literal["open", "bearer", "cookie"]


EVERYBODY = Visitor("everybody on this machine", Role.ADMIN, "", "", "open")


class Door:
    """Lets in who shows a token. Without a book the door stands open."""

    def __init__(
        self, book: TokenBook | None, now_s: Callable[[], float] = time.time, data_dir: Path | None = None
    ) -> None:
        """`data_dir` is the station's, to be named in advice."""
        self._book = book
        self._data_dir = data_dir
        self.now_s = now_s  # wall time, as the book counts it
        self._guesses = GuessLimit()
        self._visits: dict[str, set[Callable[[], None]]] = {}  # token id → how to end what it has open

    @property
    def is_open(self) -> bool:
        """Whether everybody who reaches it may everything."""
        return self._book is None

    @property
    def book(self) -> TokenBook:
        """Raises Conflict: this station has none."""
        if self._book is None:
            sentence = "this station has no access control; `access init` sets it up (docs/access.md)"
            raise Conflict(complete(sentence, "station", {"--data": self._data_dir}))
        return self._book

    def admit(self, shown: str, by: Literal["bearer", "cookie"], address: str) -> Visitor:
        """Who shows this token or session. Raises WrongToken, TooManyGuesses."""
        record = self._find(shown, address)
        if record.kind == "link":
            raise WrongToken("this code is for one login: open its link in a browser, or POST it to /login")
        self.book.use(record, self.now_s())
        return Visitor(record.name, record.role, record.id, record.parent or record.id, by)

    def login(self, shown: str, address: str) -> tuple[Visitor, str]:
        """Who shows this token or link, and the session for its browser. Raises WrongToken, TooManyGuesses."""
        record = self._find(shown, address)
        if record.kind == "session":
            raise WrongToken("a session makes no other session; log in with the token")
        # Of two that come at once with one link, one ends it.
        if record.kind == "link" and not self.book.revoke(record.id, self.now_s()):
            raise WrongToken("this link was used already; ask for another")
        session = self.book.add_for(record, "session", self.now_s(), SESSION_S)
        return Visitor(record.name, record.role, session.id, record.parent or record.id, "cookie"), session.text

    def _find(self, shown: str, address: str) -> TokenRecord:
        now_s = self.now_s()
        self.book.refresh()
        record = self.book.find(shown, now_s)
        if record is None:
            if wait_s := self._guesses.wait_s(address, now_s):
                raise TooManyGuesses(f"too many wrong tokens came from your address; wait {wait_s:.0f} s", wait_s)
            self._guesses.wrong(address, shown.encode(), now_s)
            if self._guesses.wait_s(address, now_s):
                logger.warning("too many wrong tokens from %s", address)
            raise WrongToken("this token is not valid here, or not any more; ask who runs this station for another")
        return record

    def revoke(self, name_or_id: str) -> list[TokenRecord]:
        """End a token, and at once what it has open."""
        ended = self.book.revoke(name_or_id, self.now_s())
        self.look()
        return ended

    # What stays open

    @contextlib.contextmanager
    def visit(self, visitor: Visitor, end: Callable[[], None]) -> Iterator[None]:
        """Keep `end` at hand for when the token is revoked."""
        ends = self._visits.setdefault(visitor.token_id, set())
        ends.add(end)
        try:
            yield
        finally:
            ends.discard(end)
            if not ends:
                self._visits.pop(visitor.token_id, None)

    def look(self) -> None:
        """End what belongs to nobody who may."""
        if self._book is None:
            return
        self._book.refresh()
        now_s = self.now_s()
        for token_id, ends in list(self._visits.items()):
            if self._book.live(token_id, now_s) is None:
                for end in list(ends):
                    end()

    async def watch(self) -> None:
        """Look every half second whether somebody was revoked, also by `station access revoke`, until cancelled."""
        flushed_s = time.monotonic()
        while True:
            await asyncio.sleep(LOOK_S)
            self.look()
            if self._book is not None and time.monotonic() - flushed_s > FLUSH_S:
                flushed_s = time.monotonic()
                try:
                    await asyncio.to_thread(self._book.flush, self.now_s())
                except ConfigError as exc:
                    logger.warning("when tokens were last used is not noted: %s", exc)


@dataclass(frozen=True, slots=True)
class Access:
    """All of it, for one station."""

    door: Door
    robots: PairedRobots
    identity: Identity | None  # for HTTPS; None: plain HTTP


def access_folder(data_dir: Path) -> Path:
    """Where key, certificate, tokens and paired robots of a station are."""
    return data_dir / FOLDER


def open_access(config: StationConfig) -> Access:
    """What the settings ask for.

    Raises ConfigError: others would reach the station, and nothing says who may.
    """
    folder = access_folder(config.data_dir)
    robots = PairedRobots(folder, config.access.insecure, config.data_dir)
    host = config.api.host
    if config.access.insecure and not is_loopback(host):
        logger.warning("--insecure: whoever reaches %s can watch your home and drive", host)
    if config.access.insecure or (not config.access.on_loopback and is_loopback(host)):
        return Access(Door(None, data_dir=config.data_dir), robots, None)
    try:
        return Access(Door(TokenBook(folder)), robots, open_identity(folder))
    except ConfigError as exc:
        why = "access.on_loopback is set" if is_loopback(host) else f"--host {host} lets others in"
        wrong = f" ({complete(str(exc), 'station', {'--data': config.data_dir})})" if folder.exists() else ""
        raise ConfigError(
            f"{why}, and it is not set up who may{wrong};"
            f" run `station access init{option('--data', config.data_dir)}` (docs/access.md)"
        ) from exc
