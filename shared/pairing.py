"""How a short code becomes a long secret between a robot and a station: SPAKE2, bound to the robot's certificate.

No socket, no file, no clock. `spake2` is imported only when somebody pairs.
"""

from __future__ import annotations

import hmac
import secrets
from typing import Any, Literal

from shared.errors import ConfigError, RemoteProtocolError

CODE_DIGITS = 6
_STATION, _ROBOT = b"sentinel station", b"sentinel robot"


def new_code() -> str:
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


def show_code(code: str) -> str:
    """As people read and type it: 123-456."""
    return f"{code[:3]}-{code[3:]}"


def parse_code(text: str) -> str:
    """The digits of a code as typed. Raises ConfigError."""
    digits = "".join(c for c in text if c not in " -\t")
    if len(digits) != CODE_DIGITS or not (digits.isascii() and digits.isdecimal()):
        raise ConfigError(f"{text!r} is no pairing code; it has six digits, for example 123-456")
    return digits


class Pake:
    """One side of one exchange; good for one try.

    Both put into it the fingerprint of the robot's certificate as they see it. Whoever stands in between shows the
    station another certificate, so the keys differ, and what was said on the way tells nothing about the code.
    """

    def __init__(self, side: Literal["robot", "station"], code: str, fingerprint: bytes) -> None:
        """Raises ConfigError: `spake2` is not installed."""
        try:
            from spake2 import SPAKE2_A, SPAKE2_B
        except ImportError as exc:
            raise ConfigError(
                f"pairing needs {exc.name}, which is not installed; install sentinel-robot with [robot] or [station]"
            ) from exc
        kind = SPAKE2_A if side == "station" else SPAKE2_B
        self._code = code
        self._exchange: Any = kind(code.encode("ascii"), idA=_STATION, idB=_ROBOT + fingerprint)
        self.message: bytes = self._exchange.start()
        self._key = b""

    def is_for(self, code: str) -> bool:
        """Whether this exchange was begun for that code."""
        return hmac.compare_digest(self._code, code)

    def receive(self, message: bytes) -> None:
        """The other side's message. Raises RemoteProtocolError: it is none."""
        from spake2 import SPAKEError
        from spake2.ed25519_basic import NotOnCurve

        try:
            self._key = self._exchange.finish(message)
        except (SPAKEError, NotOnCurve, ValueError, AssertionError) as exc:
            raise RemoteProtocolError("the peer's part of the pairing is not valid") from exc

    def mac(self, of: Literal["robot", "station"]) -> bytes:
        """Shows that this side has the key."""
        return hmac.digest(self._key, b"confirm " + of.encode(), "sha256")

    def is_mac(self, of: Literal["robot", "station"], mac: bytes) -> bool:
        """Whether the other side has it too."""
        return bool(self._key) and hmac.compare_digest(self.mac(of), mac)
