"""Datagrams of one session, sealed: nobody else can read them, make one, or send one again. No socket.

A header of 12 bytes, the session's number and the datagram's own, is the nonce of ChaCha20-Poly1305 as well. Each
direction has a key of its own, so that no nonce is used twice. ChaCha20 because a Raspberry Pi 4 has no instructions
for AES. Sources: RFC 8439; replayed numbers: RFC 4303, section 3.4.3.
"""

from __future__ import annotations

import struct

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

HEADER = struct.Struct(">IQ")  # session, number
TAG_BYTES = 16
MAX_DATAGRAM = 1200  # bytes: fits wherever IPv6 does, a VPN's headers included
MAX_CONTENT = MAX_DATAGRAM - HEADER.size - TAG_BYTES
KEY_BYTES = 32
WINDOW = 1024  # numbers behind the newest that may still come: some pictures'


def session_of(datagram: bytes) -> int:
    """Which session a datagram says it belongs to; -1: it is none of ours."""
    if not HEADER.size + TAG_BYTES < len(datagram) <= MAX_DATAGRAM:
        return -1
    session: int = HEADER.unpack_from(datagram)[0]
    return session


class Sealer:
    """Seals what one side sends."""

    def __init__(self, key: bytes, session: int) -> None:
        self._cipher = ChaCha20Poly1305(key)
        self._session = session
        self.next_number = 0

    def seal(self, content: bytes) -> bytes:
        header = HEADER.pack(self._session, self.next_number)
        self.next_number += 1
        return header + self._cipher.encrypt(header, content, header)


class Opener:
    """Opens what the other side sent, each once."""

    def __init__(self, key: bytes, session: int) -> None:
        self._cipher = ChaCha20Poly1305(key)
        self._session = session
        self._seen = 0  # bit n: the number `newest - n` was opened
        self.newest = -1
        self.refused = 0

    def open(self, datagram: bytes) -> bytes | None:
        """The content; None: it is not the other side's, was here before, or is too old to tell."""
        if session_of(datagram) != self._session:
            self.refused += 1
            return None
        header = datagram[: HEADER.size]
        number: int = HEADER.unpack(header)[1]
        age = self.newest - number
        if age >= WINDOW or (age >= 0 and self._seen >> age & 1):
            self.refused += 1
            return None
        try:
            content = self._cipher.decrypt(header, datagram[HEADER.size :], header)
        except InvalidTag:
            self.refused += 1
            return None
        if age < 0:
            self._seen = (self._seen << min(-age, WINDOW) | 1) & ((1 << WINDOW) - 1)
            self.newest = number
        else:
            self._seen |= 1 << age
        return content
