"""The robot's side of pairing. The open code is a file: `robot-server pair` opens one while robot-server runs."""

from __future__ import annotations

from pathlib import Path

import msgspec

from shared.access import Role, Token
from shared.errors import ConfigError
from shared.messages import MAX_NAME_LENGTH
from shared.pairing import Pake, new_code
from shared.private_files import locked, read_private, write_private
from shared.text import look_of, without_invisible
from shared.token_book import TokenBook

FILE_NAME = "pairing.json"
CODE_LIFE_S = 600.0
TRIES = 5  # of 1 000 000 codes
MAX_EXCHANGES = 20  # each costs a Pi a tenth of a second, also when nobody proves anything in the end


class PairingCode(msgspec.Struct, frozen=True, kw_only=True):
    """A code that a station may pair with now."""

    code: str
    role: Role
    expires_s: float  # wall time
    tries_left: int = TRIES
    exchanges_left: int = MAX_EXCHANGES

    def is_open(self, now_s: float) -> bool:
        # A clock that was set back (a Pi has none of its own) must not make a code last.
        return self.tries_left > 0 and self.exchanges_left > 0 and 0 < self.expires_s - now_s <= CODE_LIFE_S

    def __repr__(self) -> str:
        return f"PairingCode({self.tries_left} tries left)"


class PairingRefused(ConfigError):
    """No pairing, and why, in a sentence for the station."""


class PairingDesk:
    """Opens codes and turns the right one into a token."""

    def __init__(self, folder: Path, book: TokenBook, fingerprint: bytes) -> None:
        self._path = folder / FILE_NAME
        self._book = book
        self._fingerprint = fingerprint

    def open_code(self, role: Role, now_s: float) -> str:
        """A new code; the one before is void."""
        made = PairingCode(code=new_code(), role=role, expires_s=now_s + CODE_LIFE_S)
        with locked(self._path):
            self._write(made)
        return made.code

    def first_code(self, now_s: float) -> str:
        """The code that is open, which the installer may just have shown; else a new one."""
        try:
            return self._open(now_s).code
        except PairingRefused:
            return self.open_code(Role.DRIVE, now_s)

    def exchange(self, message: bytes, now_s: float) -> Pake:
        """Take the station's part in. Computes for a while. Raises PairingRefused, RemoteProtocolError."""
        with locked(self._path):
            opened = self._open(now_s)
            self._write(msgspec.structs.replace(opened, exchanges_left=opened.exchanges_left - 1))
        pake = Pake("robot", opened.code, self._fingerprint)
        pake.receive(message)
        return pake

    def finish(self, pake: Pake, mac: bytes, station_name: str, now_s: float) -> Token:
        """The token for a station that knew the code, which is void then. It counts for good when it is first used.

        Raises PairingRefused; the try is counted before.
        """
        with locked(self._path):
            opened = self._open(now_s)
            if not pake.is_for(opened.code):  # its role is another one's, and so are its tries
                raise PairingRefused("another code was opened meanwhile; use that one")
            if not pake.is_mac("station", mac):
                left = opened.tries_left - 1
                self._write(msgspec.structs.replace(opened, tries_left=left))
                raise PairingRefused(
                    "the code is wrong, or somebody stands between station and robot; "
                    + (f"{left} tries are left" if left else "there are no tries left: ask the robot for another code")
                )
            self._path.unlink(missing_ok=True)
        return self._book.add(self._free_name(station_name, now_s), opened.role, now_s, is_confirmed=False)

    def _free_name(self, name: str, now_s: float) -> str:
        name = without_invisible(name).strip()
        name = name if look_of(name).strip() else "station"
        taken = {look_of(record.name) for record in self._book.tokens() if record.is_live(now_s)}
        names = (f"{name[: MAX_NAME_LENGTH - 4]} {n}" for n in range(2, 1000))
        return name if look_of(name) not in taken else next(free for free in names if look_of(free) not in taken)

    def _open(self, now_s: float) -> PairingCode:
        content = read_private(self._path)
        try:
            opened = None if content is None else msgspec.json.decode(content, type=PairingCode)
        except msgspec.DecodeError:
            opened = None
        if opened is None or not opened.is_open(now_s):
            raise PairingRefused("no pairing code is open; run `robot-server pair` on the robot and use its code")
        return opened

    def _write(self, opened: PairingCode) -> None:
        write_private(self._path, msgspec.json.encode(opened))
