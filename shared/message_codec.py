"""Messages to and from their msgpack payloads; what is no valid message is refused with a sentence."""

from __future__ import annotations

import msgspec

from shared.errors import RemoteProtocolError, RobotSystemError
from shared.messages import PROTOCOL_VERSION, Message, RobotMessage, StationDatagram, StationMessage
from shared.text import explain

# msgspec leaves broken UTF-8 a UnicodeDecodeError, which is a ValueError.
UNDECODABLE = (msgspec.DecodeError, ValueError, OverflowError, RecursionError, RobotSystemError)

_encoder = msgspec.msgpack.Encoder()
_datagram_decoder: msgspec.msgpack.Decoder[StationDatagram] = msgspec.msgpack.Decoder(StationDatagram)
_robot_decoder: msgspec.msgpack.Decoder[RobotMessage] = msgspec.msgpack.Decoder(RobotMessage)
_station_decoder: msgspec.msgpack.Decoder[StationMessage] = msgspec.msgpack.Decoder(StationMessage)


class _VersionOnly(msgspec.Struct):
    """The one field of a first message that every protocol version shares."""

    protocol: int


_version_decoder = msgspec.msgpack.Decoder(_VersionOnly)


def encode_message(message: Message | StationDatagram) -> bytes:
    """The msgpack payload of a message, without its length prefix."""
    return _encoder.encode(message)


def decode_robot_message(payload: bytes) -> RobotMessage:
    """A payload sent by a robot. Raises RemoteProtocolError when it is not a valid message."""
    try:
        return _robot_decoder.decode(payload)
    except UNDECODABLE as exc:
        raise RemoteProtocolError(_explain("robot", payload, exc)) from exc


def decode_station_message(payload: bytes) -> StationMessage:
    """A payload sent by a station. Raises RemoteProtocolError when it is not a valid message."""
    try:
        return _station_decoder.decode(payload)
    except UNDECODABLE as exc:
        raise RemoteProtocolError(_explain("station", payload, exc)) from exc


def decode_station_datagram(payload: bytes) -> StationDatagram:
    """What a station's datagram says. Raises RemoteProtocolError when it is none of what may come so."""
    try:
        return _datagram_decoder.decode(payload)
    except UNDECODABLE as exc:
        raise RemoteProtocolError(_explain("station", payload, exc)) from exc


def version_mismatch(theirs: int, peer: str) -> str:
    """The sentence both sides use when the protocol versions differ."""
    return (
        f"the {peer} speaks protocol version {theirs}, this program speaks {PROTOCOL_VERSION};"
        " install the same release of sentinel-robot on both machines"
    )


def _explain(peer: str, payload: bytes, exc: Exception) -> str:
    """Why a payload was refused; a first message of another version is recognised whatever else it holds."""
    try:
        theirs = _version_decoder.decode(payload).protocol
    except UNDECODABLE:
        theirs = PROTOCOL_VERSION
    if theirs != PROTOCOL_VERSION:
        return version_mismatch(theirs, peer)
    return f"the {peer} sent {len(payload)} bytes that are not a valid message: {explain(exc)}"
