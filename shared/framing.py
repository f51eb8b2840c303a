"""Payloads with a checked header: their length, their checksum, a checksum of these. Bytes in, payloads out; no socket.

TCP's own checksum lets one damaged segment in some tens of thousands pass. Without ours a wrong byte in a length made
the receiver wait for megabytes that never come, and a wrong byte in a payload became a wrong number.
"""

from __future__ import annotations

import struct
import zlib

from shared.errors import LocalProtocolError, RemoteProtocolError

LENGTH_BYTES = 4
COUNTED = struct.Struct(">II")  # length of the payload, its CRC-32
CHECK = struct.Struct(">I")  # CRC-32 of these
HEADER_BYTES = COUNTED.size + CHECK.size
MAX_ROBOT_PAYLOAD = 4 * 1024 * 1024  # a 4K JPEG at high quality stays below 3 MiB
MAX_STATION_PAYLOAD = 4096  # commands are small; a robot must not collect megabytes for a stranger
DAMAGED = "the bytes were damaged on their way, or come from a program of another version"


def encode_payload(payload: bytes, max_payload: int) -> bytes:
    """The payload behind its header. Raises LocalProtocolError when it is empty or exceeds the limit."""
    if not 0 < len(payload) <= max_payload:
        raise LocalProtocolError(f"a payload of {len(payload)} bytes is outside 1..{max_payload}")
    counted = COUNTED.pack(len(payload), zlib.crc32(payload))
    return counted + CHECK.pack(zlib.crc32(counted)) + payload


class FrameDecoder:
    """Cuts a byte stream into payloads. Holds at most one payload and what came with it."""

    def __init__(self, max_payload: int) -> None:
        self._buffer = bytearray()
        self._max_payload = max_payload

    def receive(self, data: bytes) -> None:
        """Add bytes as they came from the peer."""
        self._buffer += data

    def next_payload(self) -> bytes | None:
        """Return the next whole payload, or None until more bytes arrive.

        Raises:
            RemoteProtocolError: the announced length is zero or above the limit, or a checksum is wrong; the stream
                cannot be followed further.
        """
        if len(self._buffer) < LENGTH_BYTES:
            return None
        length = int.from_bytes(self._buffer[:LENGTH_BYTES], "big")
        if not 0 < length <= self._max_payload:
            raise RemoteProtocolError(f"a payload of {length} bytes was announced, allowed are 1..{self._max_payload}")
        if len(self._buffer) < HEADER_BYTES:
            return None
        (check,) = CHECK.unpack_from(self._buffer, COUNTED.size)
        if zlib.crc32(self._buffer[: COUNTED.size]) != check:
            raise RemoteProtocolError(f"a header does not fit its checksum: {DAMAGED}")
        end = HEADER_BYTES + length
        if len(self._buffer) < end:
            return None
        payload = bytes(self._buffer[HEADER_BYTES:end])
        if zlib.crc32(payload) != COUNTED.unpack_from(self._buffer)[1]:
            raise RemoteProtocolError(f"a payload of {length} bytes does not fit its checksum: {DAMAGED}")
        del self._buffer[:end]
        return payload
