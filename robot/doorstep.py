"""How a connection becomes a station that is known: by its token, or for the first time by a code."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine, Iterable
from typing import Any

from robot.access import Gate
from robot.commands import notice
from robot.pairing import PairingRefused
from robot.station_client import StationClient
from shared.access import Role, new_challenge
from shared.certificates import HANDSHAKE_WITHIN_S
from shared.errors import RemoteProtocolError, RobotSystemError
from shared.messages import Paired, PairProof, PairReply, PairRequest, Prove, Refusal
from shared.pairing import Pake
from shared.session import Event
from shared.token_book import TokenRecord

logger = logging.getLogger(__name__)

NOTHING_TO_PAIR = "this robot has no access control; there is nothing to pair"
TOO_EARLY = "the proof came before the robot's part of the pairing"
REVOKED = "the station's token was revoked; pair station and robot again"
FLUSH_AFTER_LOOKS = 120  # a minute


class Doorstep:
    """Lets stations in by the gate; without a gate everybody who reaches the port is in."""

    def __init__(self, gate: Gate | None) -> None:
        self._gate = gate
        self._tasks: set[asyncio.Task[None]] = set()
        self._looks = 0

    def tls(self) -> dict[str, Any]:
        """For loop.connect_accepted_socket."""
        if self._gate is None:
            return {}
        return {"ssl": self._gate.context, "ssl_handshake_timeout": HANDSHAKE_WITHIN_S}

    def receive(self, client: StationClient) -> None:
        if self._gate is None:
            client.role = Role.ADMIN
        else:
            client.challenge = new_challenge()

    def introduce(self, client: StationClient, message: Prove | PairRequest | PairProof) -> None:
        gate = self._gate
        if gate is None:
            if not isinstance(message, Prove):
                _refuse(client, NOTHING_TO_PAIR)
            return
        match message:
            case Prove():
                admitted = gate.admit(message, client.challenge, client.address)
                if isinstance(admitted, str):
                    _refuse(client, admitted)
                else:
                    client.role, client.token_id = admitted.role, admitted.id
                    if admitted.confirm_by_s is not None:
                        self._start(self._confirm(gate, admitted))
            case PairRequest():
                self._start(self._exchange(gate, client, message))
            case PairProof():
                if client.pairing is None:
                    _refuse(client, TOO_EARLY)
                else:
                    self._start(self._finish(gate, client, *client.pairing, message.mac))
                    client.pairing = None  # one try

    def look(self, clients: Iterable[StationClient]) -> None:
        """Whose token was revoked is out, and its motors stop. Also notes when tokens were last used."""
        gate = self._gate
        if gate is None:
            return
        self._looks += 1
        if self._looks % FLUSH_AFTER_LOOKS == 0:
            self._start(self._flush(gate))
        gate.book.refresh()
        # All are asked every time: whether the book has changed, somebody's proof may have found out before.
        for client in clients:
            if client.token_id and not gate.is_live(client.token_id):
                logger.warning("%s: its token was revoked", client.station_name or client.address)
                client.end(Event.FATAL_ERROR, notice("not_allowed", REVOKED, fatal=True))

    async def _exchange(self, gate: Gate, client: StationClient, request: PairRequest) -> None:
        try:
            pake = await asyncio.to_thread(gate.desk.exchange, request.message, gate.now_s())
        except RobotSystemError as exc:
            _refuse(client, _told(exc))
            return
        client.pairing = pake, request.station_name
        client.put(PairReply(message=pake.message))

    async def _finish(self, gate: Gate, client: StationClient, pake: Pake, name: str, mac: bytes) -> None:
        try:
            token = await asyncio.to_thread(gate.desk.finish, pake, mac, name, gate.now_s())
        except RobotSystemError as exc:
            logger.warning("pairing with %s refused", client.address)
            _refuse(client, _told(exc))
            return
        logger.info("paired with %s at %s", name, client.address)
        client.end(Event.PAIRED, Paired(mac=pake.mac("robot"), token=token.text))

    async def _confirm(self, gate: Gate, record: TokenRecord) -> None:
        """The station has what it was given."""
        try:
            await asyncio.to_thread(gate.book.confirm, record.id, gate.now_s())
        except RobotSystemError as exc:
            logger.error("the pairing with %s ends in a few minutes, it cannot be written: %s", record.name, exc)

    async def _flush(self, gate: Gate) -> None:
        try:
            await asyncio.to_thread(gate.book.flush, gate.now_s())
        except RobotSystemError as exc:
            logger.warning("when tokens were last used is not noted: %s", exc)

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _told(exc: RobotSystemError) -> str:
    """What a stranger may know of it: nothing of this machine's files."""
    if isinstance(exc, PairingRefused | RemoteProtocolError):
        return str(exc)
    logger.error("nobody can pair: %s", exc)
    return "this robot cannot pair just now; its log says why"


def _refuse(client: StationClient, reason: str) -> None:
    client.end(Event.REFUSAL, Refusal(reason=reason[:1000]))
