"""The robots this station was paired with: by which certificate it knows each, and with which token it joins."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec.structs import force_setattr

from shared.access import Token
from shared.advice import option
from shared.certificates import show_fingerprint
from shared.errors import ConfigError
from shared.listening import is_loopback, show_address
from shared.private_files import locked, make_private_folder, read_private, write_private
from shared.text import explain, printable
from station.config import parse_address

logger = logging.getLogger(__name__)
FILE_NAME = "robots.json"
FINGERPRINT = r"^[0-9a-f]{64}\Z"
SHORT_CERTIFICATE = 11  # signs: four bytes
MIN_DIGITS = 4  # of a certificate, to mean a robot by it
MAX_ADDRESSES = 16  # of one robot; beyond, the oldest is free again


class PairedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot that this station was paired with."""

    robot_id: str
    name: str
    host: str  # where it was when it was paired; empty: another robot was paired there since
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)]
    fingerprint: Annotated[str, msgspec.Meta(pattern=FINGERPRINT)]  # hex SHA-256 of its certificate
    token: str
    also_at: tuple[str, ...] = ()  # further HOST:PORT that were given for it; no other robot is met there

    def __post_init__(self) -> None:
        for field in ("robot_id", "name", "host"):  # a file may hold what a terminal would obey
            force_setattr(self, field, printable(getattr(self, field)))

    def is_at(self, host: str, port: int) -> bool:
        """Whether this address, as a person gives it, means this robot."""
        return show_address(host, port).lower() in (self.address.lower(), *self.also_at)

    @property
    def address(self) -> str:
        """HOST:PORT where it is known to be; empty: nowhere."""
        return show_address(self.host, self.port) if self.host else ""

    @property
    def short_certificate(self) -> str:
        """The beginning of its fingerprint, as `station robots` shows it: enough to tell a person's robots apart."""
        return show_fingerprint(bytes.fromhex(self.fingerprint))[:SHORT_CERTIFICATE]

    def is_called(self, name: str) -> bool:
        """By its name, id, host, or the beginning of its certificate."""
        digits = name.replace(":", "").lower()
        is_certificate = len(digits) >= MIN_DIGITS and self.fingerprint.startswith(digits)
        return is_certificate or (name != "" and name in (self.name, self.robot_id, self.host))

    def moved_from(self, address: str) -> PairedRobot:
        """The same robot, no longer met at this address of its: the last other one that was given for it counts now."""
        also_at = _without(self.also_at, address)
        if self.address.lower() != address:
            return msgspec.structs.replace(self, also_at=also_at)
        host, port = parse_address(also_at[-1], FILE_NAME) if also_at else ("", self.port)
        return msgspec.structs.replace(self, host=host, port=port, also_at=also_at[:-1])

    def __repr__(self) -> str:
        return f"PairedRobot({self.name!r}, {show_fingerprint(bytes.fromhex(self.fingerprint))})"


class _File(msgspec.Struct, frozen=True, kw_only=True):
    version: Literal[1] = 1
    robots: tuple[PairedRobot, ...]  # a file without them is no file of robots, and is not to be replaced by one


class PairedRobots:
    """The station's file of robots; read anew whenever it is asked, so that a pairing counts at once."""

    def __init__(self, folder: Path, allow_open: bool = False, data_dir: Path | None = None) -> None:
        """`allow_open`: robots beyond loopback may be met without TLS (`--insecure`). `data_dir` is named in advice."""
        self.path = folder / FILE_NAME
        self._allow_open = allow_open
        self._data = option("--data", data_dir)
        self.damage = ""  # why the file could not be used when it was read last, in a sentence

    def all(self) -> tuple[PairedRobot, ...]:
        """Raises ConfigError: the file cannot be used, and then it is never written either."""
        try:
            robots = self._read()
        except ConfigError as exc:
            self.damage = str(exc)
            raise
        self.damage = ""
        return robots

    def _read(self) -> tuple[PairedRobot, ...]:
        content = read_private(self.path)
        if content is None:
            return ()
        try:
            return msgspec.json.decode(content, type=_File).robots
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as exc:
            said = explain(exc).replace(f"matching regex {FINGERPRINT!r}", "of 64 hexadecimal digits")
            said = said.replace("`", "'")  # between these we have commands, and one is called `robots`
            raise ConfigError(f"{self.path} is damaged ({said}); correct it, or delete it and pair again") from exc

    def knows(self, fingerprint: bytes) -> bool:
        """Whether the robot with this certificate is paired. Raises ConfigError as `all` does."""
        return any(robot.fingerprint == fingerprint.hex() for robot in self.all())

    def needs_tls(self, host: str, port: int, address: str) -> bool:
        """Whether a robot is met by TLS only: it was paired under this name, or others reach this address too."""
        if any(robot.is_at(host, port) for robot in self.all()):
            return True
        return not self._allow_open and not is_loopback(address)

    def recognise(self, fingerprint: bytes, host: str, port: int) -> tuple[PairedRobot, Token] | str:
        """Who shows this certificate at an address that a person gave, or the sentence why nothing is said to it.

        An address belongs to the first paired robot that is met there: two that swap theirs must not swap drivers.
        """
        robots = self.all()
        robot = next((robot for robot in robots if robot.fingerprint == fingerprint.hex()), None)
        owner = next((robot for robot in robots if robot.is_at(host, port)), None)
        if owner is not None and owner != robot:
            return self._in_its_place(show_address(host, port), owner, robot, fingerprint)
        known = self.recognise_anywhere(fingerprint, host, port)
        if owner is None and not isinstance(known, str):
            self._note_address(known[0], host, port)
        return known

    def recognise_anywhere(self, fingerprint: bytes, host: str, port: int) -> tuple[PairedRobot, Token] | str:
        """The same where nobody gave an address: any paired robot may be there."""
        for robot in self.all():
            if robot.fingerprint == fingerprint.hex():
                token = Token.parse(robot.token)
                return (robot, token) if token else f"the token for {robot.name} in {self.path} is damaged; pair again"
        address = show_address(host, port)
        return (
            f"the robot at {address} (certificate {show_fingerprint(fingerprint)}) is not paired with this station;"
            f" run `robot-server pair` on it, then `station pair {address} --code CODE{self._data}`"
        )

    def check_writable(self) -> None:
        """Before a code is used up. Raises ConfigError: a robot could not be stored."""
        make_private_folder(self.path.parent)
        with locked(self.path):
            robots = self.all()
            for robot in robots:
                for address in robot.also_at:  # where it is met from then on, if another robot gets its address
                    parse_address(address, f"{self.path} is damaged: in also_at of {robot.name}")
            self._write(robots)

    def store(self, robot: PairedRobot) -> tuple[PairedRobot, ...]:
        """Add a robot; returns the others that had its address. These lose it, and stay paired: routers give addresses
        anew. One with the same id is this robot before it was set up anew, and is replaced.
        """
        make_private_folder(self.path.parent)
        address = robot.address.lower()
        with locked(self.path):
            known = self.all()
            before = tuple(k for k in known if k.is_at(robot.host, robot.port) and k.fingerprint != robot.fingerprint)
            kept = []
            for other in known:
                if other.fingerprint == robot.fingerprint:
                    robot = msgspec.structs.replace(robot, also_at=_without(other.also_at, address))
                elif other not in before:
                    kept.append(other)
                elif other.robot_id != robot.robot_id:
                    kept.append(other.moved_from(address))
            self._write((*kept, robot))
        return before

    def _note_address(self, robot: PairedRobot, host: str, port: int) -> None:
        """From now on nobody else is met at this address."""
        address = show_address(host, port).lower()
        if robot.host:
            noted = msgspec.structs.replace(robot, also_at=(*robot.also_at, address)[-MAX_ADDRESSES:])
        else:
            noted = msgspec.structs.replace(robot, host=host, port=port)
        try:
            with locked(self.path):
                self._write(tuple(noted if known == robot else known for known in self.all()))
        except ConfigError as exc:  # a disk that takes no writes must not keep the robot from being used
            logger.warning("that %s means %s cannot be noted: %s", address, robot.name, exc)

    def _in_its_place(self, address: str, owner: PairedRobot, robot: PairedRobot | None, fingerprint: bytes) -> str:
        """Why nothing is said to who answers at another robot's address."""
        if robot is None:
            return (
                f"{address} shows the certificate {show_fingerprint(fingerprint)} and not that of {owner.name}"
                f" ({show_fingerprint(bytes.fromhex(owner.fingerprint))}): it was set up anew, then pair again,"
                " or another machine answers in its place"
            )
        return (
            f"{address} is {owner.name}'s, and {robot.name} (certificate {show_fingerprint(fingerprint)}) is there;"
            " they may have changed addresses: give a name that follows the robot, such as HOST.local, or pair"
            f" {robot.name} under this address: `robot-server pair` on it, then"
            f" `station pair {address} --code CODE{self._data}`"
        )

    def forget(self, name: str) -> PairedRobot:
        """Forget the robot of this name, id, host or certificate (its beginning). Raises ConfigError: none, several."""
        with locked(self.path):
            known = self.all()
            meant = [robot for robot in known if robot.is_called(name)]
            if not meant:
                raise ConfigError(f"no paired robot is called {name!r}; `station robots` lists them")
            if len(meant) > 1:
                which = ", ".join(
                    f"{robot.name} {robot.address or 'address unknown'} {robot.short_certificate}" for robot in meant
                )
                raise ConfigError(
                    f"{len(meant)} paired robots are called {name!r}: {which}; none was forgotten, say which by the"
                    f" beginning of its certificate, as in `station robots --forget {meant[0].short_certificate}`"
                )
            self._write(tuple(robot for robot in known if robot != meant[0]))
        return meant[0]

    def _write(self, robots: tuple[PairedRobot, ...]) -> None:
        write_private(self.path, msgspec.json.format(msgspec.json.encode(_File(robots=robots))))


def _without(addresses: tuple[str, ...], address: str) -> tuple[str, ...]:
    return tuple(known for known in addresses if known != address)
