"""Length-prefixed payloads: four bytes big-endian length, then the payload. Bytes in, payloads out; no socket."""

from __future__ import annotations

from shared.errors import LocalProtocolError, RemoteProtocolError

LENGTH_BYTES = 4
MAX_ROBOT_PAYLOAD = 4 * 1024 * 1024  # a 4K JPEG at high quality stays below 3 MiB
MAX_STATION_PAYLOAD = 4096  # commands are small; a robot must not collect megabytes for a stranger


def encode_payload(payload: bytes, max_payload: int) -> bytes:
    """The payload with its length in front. Raises LocalProtocolError when it is empty or exceeds the limit."""
    if not 0 < len(payload) <= max_payload:
        raise LocalProtocolError(f"a payload of {len(payload)} bytes is outside 1..{max_payload}")
    return len(payload).to_bytes(LENGTH_BYTES, "big") + payload


class FrameDecoder:
    """Cuts a byte stream into length-prefixed payloads. Holds at most one payload and what came with it."""

    def __init__(self, max_payload: int) -> None:
        self._buffer = bytearray()
        self._max_payload = max_payload

    def receive(self, data: bytes) -> None:
        """Add bytes as they came from the peer."""
        self._buffer += data

    @property
    def is_between_payloads(self) -> bool:
        """False while part of a payload is held: a stream that ends now was cut."""
        return not self._buffer

    def next_payload(self) -> bytes | None:
        """Return the next whole payload, or None until more bytes arrive.

        Raises:
            RemoteProtocolError: the announced length is zero or above the limit; the stream cannot be followed further.
        """
        if len(self._buffer) < LENGTH_BYTES:
            return None
        length = int.from_bytes(self._buffer[:LENGTH_BYTES], "big")
        if not 0 < length <= self._max_payload:
            raise RemoteProtocolError(f"a payload of {length} bytes was announced, allowed are 1..{self._max_payload}")
        end = LENGTH_BYTES + length
        if len(self._buffer) < end:
            return None
        payload = bytes(self._buffer[LENGTH_BYTES:end])
        del self._buffer[:end]
        return payload
