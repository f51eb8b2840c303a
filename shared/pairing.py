"""How a short code becomes a long secret between a robot and a station: CPace, bound to the robot's certificate.

No socket, no file, no clock. `cryptography` is imported only when somebody pairs.
"""

from __future__ import annotations

import hmac
import secrets
from typing import Literal

from shared.bounded import shown
from shared.cpace import SHARE_BYTES, generator, multiply, session_key
from shared.errors import ConfigError, RemoteProtocolError

CODE_DIGITS = 6
_CPACE, _SPAKE2 = b"C", (b"A", b"B")  # a message's first byte: how it was made; the second until November 2026
_CHANNEL = b"sentinel station, sentinel robot "  # and its certificate


def new_code() -> str:
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


def show_code(code: str) -> str:
    """As people read and type it: 123-456."""
    return f"{code[:3]}-{code[3:]}"


def parse_code(text: str) -> str:
    """The digits of a code as typed. Raises ConfigError."""
    digits = "".join(c for c in text if c not in " -\t")
    if len(digits) != CODE_DIGITS or not (digits.isascii() and digits.isdecimal()):
        raise ConfigError(f"{shown(text)} is no pairing code; it has six digits, for example 123-456")
    return digits


class Pake:
    """One side of one exchange; good for one try.

    Both put into it the fingerprint of the robot's certificate as they see it. Whoever stands in between shows the
    station another certificate, so the keys differ, and what was said on the way tells nothing about the code.
    """

    def __init__(self, side: Literal["robot", "station"], code: str, fingerprint: bytes) -> None:
        """Raises ConfigError: `cryptography` is not installed."""
        self._code = code
        self._begins = side == "station"
        self._scalar = secrets.token_bytes(SHARE_BYTES)
        self._key = b""
        try:
            share = multiply(self._scalar, generator(code.encode("ascii"), _CHANNEL + fingerprint))
        except ImportError as exc:
            raise ConfigError(
                f"pairing needs {exc.name}, which is not installed; install sentinel-robot with [robot] or [station]"
            ) from exc
        self.message = _CPACE + share

    def is_for(self, code: str) -> bool:
        """Whether this exchange was begun for that code."""
        return hmac.compare_digest(self._code, code)

    def receive(self, message: bytes) -> None:
        """The other side's message. Raises RemoteProtocolError: it is none."""
        if message.startswith(_SPAKE2):
            raise RemoteProtocolError("the peer pairs as an earlier release did; install the same release on both")
        try:
            if not message.startswith(_CPACE):
                raise ValueError("another exchange")
            secret = multiply(self._scalar, message[1:])
        except ValueError as exc:
            raise RemoteProtocolError("the peer's part of the pairing is not valid") from exc
        first, second = (self.message, message) if self._begins else (message, self.message)
        self._key = session_key(secret, (first, b""), (second, b""))

    def mac(self, of: Literal["robot", "station"]) -> bytes:
        """Shows that this side has the key."""
        return hmac.digest(self._key, b"confirm " + of.encode(), "sha256")

    def is_mac(self, of: Literal["robot", "station"], mac: bytes) -> bool:
        """Whether the other side has it too."""
        return bool(self._key) and hmac.compare_digest(self.mac(of), mac)
