"""Who may do what with this robot: the table of messages and roles, and the gate that stations come in by."""

from __future__ import annotations

import logging
import os
import socket
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from robot.config import AccessConfig, RobotConfig
from robot.pairing import CODE_LIFE_S, PairingDesk
from shared.access import GuessLimit, Role
from shared.advice import complete, option
from shared.certificates import open_identity
from shared.discovery import DEFAULT_PORT
from shared.disk import remove_scratch
from shared.errors import ConfigError, LocalProtocolError
from shared.listening import is_loopback, show_address
from shared.messages import (
    AskDatagrams,
    Drive,
    ErrorNotice,
    Heartbeat,
    Hijack,
    Join,
    PairProof,
    PairRequest,
    PanTilt,
    Prove,
    Received,
    StationMessage,
    Stop,
    UndoCalibration,
    UseCalibration,
)
from shared.pairing import show_code
from shared.token_book import TokenBook, TokenRecord

logger = logging.getLogger(__name__)

# Every message a station can say, and who may. None: who is not known yet; these are how one becomes known.
MESSAGE_ROLES: dict[type, Role | None] = {
    Prove: None,
    PairRequest: None,
    PairProof: None,
    Join: Role.WATCH,
    Heartbeat: Role.WATCH,
    Received: Role.WATCH,
    AskDatagrams: Role.WATCH,
    ErrorNotice: Role.WATCH,
    Stop: Role.WATCH,  # whoever sees the robot may stop it
    Drive: Role.DRIVE,
    PanTilt: Role.DRIVE,
    Hijack: Role.DRIVE,
    UseCalibration: Role.ADMIN,  # every later drive is measured with it
    UndoCalibration: Role.ADMIN,
}
UNKNOWN_STATION = (
    "this robot admits only paired stations;"
    " run `robot-server pair` on it, then `station pair HOST --code CODE` on the PC"
)
TOKEN_REFUSED = "the station's token is not valid here any more; pair station and robot again"


def check_roles() -> None:
    """Raises LocalProtocolError when a message has no role: nothing is open because somebody forgot."""
    missing = [kind.__name__ for kind in get_args(StationMessage) if kind not in MESSAGE_ROLES]
    if missing:
        raise LocalProtocolError(f"no role is set for {', '.join(missing)}; add it to MESSAGE_ROLES in robot/access.py")


def may(role: Role | None, message: StationMessage) -> bool:
    """Whether a station in this role (None: not known yet) may say this."""
    needed = MESSAGE_ROLES[type(message)]
    return needed is None or (role is not None and role.includes(needed))


def default_folder() -> Path:
    """Where the robot's key and book are when the settings name no other place."""
    return Path.home() / ".local" / "state" / "sentinel" / "robot-access"


def settings_folder(access: AccessConfig) -> Path:
    """Where the settings have key and book. Raises ConfigError as check_folder does."""
    return check_folder(Path(access.folder).expanduser() if access.folder else default_folder(), "access.folder")


def check_folder(folder: Path, setting: str) -> Path:
    """The folder, which need not be there yet. Raises ConfigError, naming the setting: something else has its name."""
    if os.path.exists(folder) and not os.path.isdir(folder):  # Path.exists raises where a folder above is closed to us
        raise ConfigError(f"{setting} {folder} is no folder; name one, `robot-server access init` makes it")
    return folder


class Gate:
    """Key, certificate, book and pairing desk of a robot with access control."""

    def __init__(self, folder: Path, now_s: Callable[[], float] = time.time) -> None:
        """Raises ConfigError: not set up."""
        identity = open_identity(folder)
        remove_scratch(folder)
        self.book = TokenBook(folder)
        self.fingerprint = identity.fingerprint
        self.context: ssl.SSLContext = identity.server_context()
        self.desk = PairingDesk(folder, self.book, identity.fingerprint)
        self._guesses = GuessLimit()
        self.now_s = now_s

    def admit(self, prove: Prove, challenge: bytes, address: str) -> TokenRecord | str:
        """Who answered the challenge, or the sentence why nobody did."""
        now_s = self.now_s()
        self.book.refresh()
        record = self.book.find_proof(prove.token_id, prove.proof, challenge, self.fingerprint, now_s)
        if record is None:
            if wait_s := self._guesses.wait_s(address, now_s):
                return f"{TOKEN_REFUSED} (too many wrong tokens came from {address}; wait {wait_s:.0f} s)"
            self._guesses.wrong(address, prove.proof, now_s)
            return TOKEN_REFUSED
        self.book.use(record, now_s)
        return record

    def is_live(self, token_id: str) -> bool:
        """Whether a token that was admitted still may; after `refresh`."""
        return self.book.live(token_id, self.now_s()) is not None

    @property
    def is_unpaired(self) -> bool:
        """First use: nobody may yet."""
        return not self.book.has_live_token(self.now_s())


def open_gate(config: RobotConfig, bound: str = "") -> Gate | None:
    """The gate that the settings ask for; None: only this machine reaches the robot, or a person said `--insecure`.

    `bound` is the address that is really listened on: a name may mean another one a moment later.
    Raises ConfigError: others would reach the robot, and nothing says who may.
    """
    host, access = config.server.host, config.access
    is_private = is_loopback(host) and is_loopback(bound or host)
    if access.insecure:
        if not is_private:
            logger.warning("--insecure: whoever reaches %s can watch and drive this robot", host)
        return None
    if not access.folder and is_private:
        return None
    folder = settings_folder(access)
    try:
        return Gate(folder)
    except ConfigError as exc:
        folder_option = option("--folder", folder if access.folder else None)
        why = f"access.folder is {folder}" if is_loopback(host) else f"--host {host} lets others in"
        wrong = f" ({complete(str(exc), 'robot-server', {'--folder': folder})})" if folder.exists() else ""
        raise ConfigError(
            f"{why}, and it is not set up who may{wrong};"
            f" run `robot-server access init{folder_option}`, then `robot-server pair{folder_option}` (docs/access.md)"
        ) from exc


def pairing_sentence(code: str, bound_to: str = "", port: int = DEFAULT_PORT) -> str:
    """What a person at the robot is told, where the address is known that the robot listens at."""
    host, shown = f"{socket.gethostname() or 'ROBOT'}.local", show_code(code)
    if bound_to and is_loopback(bound_to):
        host = bound_to  # nobody reaches it by its name
    if port != DEFAULT_PORT:
        host = show_address(host, port)
    minutes = CODE_LIFE_S / 60
    return f"pairing code {shown}, good for {minutes:.0f} minutes; on the PC: station pair {host} --code {shown}"
