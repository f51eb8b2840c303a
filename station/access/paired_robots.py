"""The robots this station was paired with: by which certificate it knows each, and with which token it joins."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from shared.access import Token
from shared.advice import option
from shared.certificates import show_fingerprint
from shared.errors import ConfigError
from shared.listening import is_loopback
from shared.private_files import locked, make_private_folder, read_private, write_private

FILE_NAME = "robots.json"


class PairedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot that this station was paired with."""

    robot_id: str
    name: str
    host: str  # where it was when it was paired; it is known again wherever it shows its certificate
    port: int
    fingerprint: str  # hex SHA-256 of its certificate
    token: str

    def __repr__(self) -> str:
        return f"PairedRobot({self.name!r}, {show_fingerprint(bytes.fromhex(self.fingerprint))})"


class _File(msgspec.Struct, frozen=True, kw_only=True):
    version: Literal[1] = 1
    robots: tuple[PairedRobot, ...] = ()


class PairedRobots:
    """The station's file of robots; read anew whenever it is asked, so that a pairing counts at once."""

    def __init__(self, folder: Path, allow_open: bool = False, data_dir: Path | None = None) -> None:
        """`allow_open`: robots beyond loopback may be met without TLS (`--insecure`). `data_dir` is named in advice."""
        self.path = folder / FILE_NAME
        self._allow_open = allow_open
        self._data = option("--data", data_dir)

    def all(self) -> tuple[PairedRobot, ...]:
        """Raises ConfigError: the file cannot be used."""
        content = read_private(self.path)
        if content is None:
            return ()
        try:
            return msgspec.json.decode(content, type=_File).robots
        except msgspec.DecodeError as exc:
            raise ConfigError(f"{self.path} is damaged ({exc}); delete it and pair again") from exc

    def needs_tls(self, host: str, port: int, address: str) -> bool:
        """Whether a robot is met by TLS only: it was paired under this name, or others reach this address too."""
        if any((robot.host, robot.port) == (host, port) for robot in self.all()):
            return True
        return not self._allow_open and not is_loopback(address)

    def recognise(self, fingerprint: bytes, host: str, port: int) -> tuple[PairedRobot, Token] | str:
        """Who shows this certificate, or the sentence why nothing is said to it."""
        robots = self.all()
        shown = show_fingerprint(fingerprint)
        for robot in robots:
            if robot.fingerprint == fingerprint.hex():
                token = Token.parse(robot.token)
                return (robot, token) if token else f"the token for {robot.name} in {self.path} is damaged; pair again"
        for robot in robots:
            if (robot.host, robot.port) == (host, port):
                return (
                    f"{host}:{port} shows the certificate {shown} and not that of {robot.name}"
                    f" ({show_fingerprint(bytes.fromhex(robot.fingerprint))}): it was set up anew, then pair again,"
                    " or another machine answers in its place"
                )
        return (
            f"the robot at {host}:{port} (certificate {shown}) is not paired with this station;"
            f" run `robot-server pair` on it, then `station pair {host}:{port} --code CODE{self._data}`"
        )

    def store(self, robot: PairedRobot) -> None:
        """Add a robot; it replaces one with the same certificate or address."""
        make_private_folder(self.path.parent)
        with locked(self.path):
            others = [
                known
                for known in self.all()
                if known.fingerprint != robot.fingerprint and (known.host, known.port) != (robot.host, robot.port)
            ]
            self._write((*others, robot))

    def forget(self, name: str) -> list[PairedRobot]:
        """Forget a robot by its name, id or host. Raises ConfigError: none has this name."""
        with locked(self.path):
            gone = [robot for robot in self.all() if name in (robot.name, robot.robot_id, robot.host)]
            if not gone:
                raise ConfigError(f"no paired robot is called {name!r}; `station robots` lists them")
            self._write(tuple(robot for robot in self.all() if robot not in gone))
        return gone

    def _write(self, robots: tuple[PairedRobot, ...]) -> None:
        write_private(self.path, msgspec.json.format(msgspec.json.encode(_File(robots=robots))))
