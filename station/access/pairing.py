"""Pairs this station with a robot: the code it shows becomes a token, and its certificate is remembered."""

from __future__ import annotations

import asyncio
import contextlib
import time

from shared.access import Token, prove
from shared.errors import ConfigError, RemoteProtocolError, RobotSystemError
from shared.listening import show_address
from shared.messages import (
    PROTOCOL_VERSION,
    ErrorNotice,
    Hello,
    Message,
    Paired,
    PairProof,
    PairReply,
    PairRequest,
    Prove,
    Refusal,
)
from shared.pairing import Pake
from shared.session import Session
from shared.token_book import CONFIRM_WITHIN_S
from station.access.connecting import READ_BYTES, Connection, ConnectionRefused, connect_by_tls
from station.access.paired_robots import PairedRobot

PAIR_WITHIN_S = 15.0  # a Pi computes for some tenths of a second


class PairingFailed(ConfigError):
    """Not paired, and why."""


async def pair(host: str, port: int, code: str, station_name: str) -> PairedRobot:
    """Exchange a code for this robot's token; nothing is written yet. Raises PairingFailed.

    Args:
        code: its digits, see shared.pairing.parse_code.
    """
    address = show_address(host, port)
    try:
        async with asyncio.timeout(PAIR_WITHIN_S):
            connection = await connect_by_tls(host, port)
            try:
                return await _talk(connection, host, port, code, station_name)
            finally:
                connection.writer.transport.abort()
    except TimeoutError as exc:
        raise PairingFailed(f"no answer from {address}; check that the robot is on and in this network") from exc
    except (OSError, UnicodeError) as exc:
        raise PairingFailed(f"cannot connect to {address} ({exc}); start robot-server there") from exc
    except (RemoteProtocolError, ConnectionRefused) as exc:
        raise PairingFailed(str(exc)) from exc


async def confirm(robot: PairedRobot) -> str:
    """Use the token once, now that it is stored: the robot drops one that nobody uses. A sentence where that fails."""
    address, token = show_address(robot.host, robot.port), Token.parse(robot.token)
    try:
        async with asyncio.timeout(PAIR_WITHIN_S):
            connection = await connect_by_tls(robot.host, robot.port)
            try:
                if token is None or connection.fingerprint.hex() != robot.fingerprint:
                    raise ConnectionRefused(f"another machine answers at {address}")
                session = Session("station", time.monotonic_ns())
                hello = await _hear(connection, session, address)
                if not isinstance(hello, Hello):
                    raise RemoteProtocolError(f"the robot answered with {hello}")
                proof = prove(token, hello.challenge, connection.fingerprint)
                connection.writer.write(session.send(Prove(token_id=token.id, proof=proof)))
                connection.writer.close()  # after what was written has left
                with contextlib.suppress(OSError):
                    await connection.writer.wait_closed()
            finally:
                connection.writer.transport.abort()
    except (RobotSystemError, OSError, UnicodeError, TimeoutError) as exc:
        minutes = round(CONFIRM_WITHIN_S / 60)
        return (
            f"{robot.name} does not know yet that it is paired ({str(exc) or 'no answer'}): start the station"
            f" within {minutes} minutes, else pair again"
        )
    return ""


async def _hear(connection: Connection, session: Session, address: str) -> Message:
    """The next message. Raises PairingFailed, RemoteProtocolError, OSError."""
    while (message := session.next_message(time.monotonic_ns())) is None:
        data = await connection.reader.read(READ_BYTES)
        if not data:
            raise PairingFailed(f"{address} closed the connection; try again")
        session.receive(data)
    return message


async def _talk(connection: Connection, host: str, port: int, code: str, station_name: str) -> PairedRobot:
    session = Session("station", time.monotonic_ns())
    address = show_address(host, port)

    async def hear() -> Message:
        match message := await _hear(connection, session, address):
            case Refusal():
                raise PairingFailed(f"the robot refused to pair: {message.reason}")
            case ErrorNotice():
                raise PairingFailed(f"the robot refused to pair: {message.message}")
            case _:
                return message

    hello = await hear()
    if not isinstance(hello, Hello) or not hello.challenge:
        raise PairingFailed(f"the robot at {address} has no access control; there is nothing to pair")
    pake = await asyncio.to_thread(Pake, "station", code, connection.fingerprint)
    request = PairRequest(protocol=PROTOCOL_VERSION, station_name=station_name[:64], message=pake.message)
    connection.writer.write(session.send(request))
    reply = await hear()
    if not isinstance(reply, PairReply):
        raise PairingFailed(f"the robot at {address} answered with {reply}; install the same release on both")
    await asyncio.to_thread(pake.receive, reply.message)
    connection.writer.write(session.send(PairProof(mac=pake.mac("station"))))
    paired = await hear()
    # The robot's proof comes last: who does not know the code must not be remembered as the robot.
    if not isinstance(paired, Paired) or not pake.is_mac("robot", paired.mac):
        raise PairingFailed(f"what answers at {address} does not know the code; it is not the robot that showed it")
    return PairedRobot(
        robot_id=hello.robot_id,
        name=hello.name,
        host=host,
        port=port,
        fingerprint=connection.fingerprint.hex(),
        token=paired.token,
    )
