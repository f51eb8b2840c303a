"""Who may do what, and how a token proves itself. No file, no socket, no clock (docs/access.md)."""

from __future__ import annotations

import base64
import binascii
import functools
import hashlib
import hmac
import ipaddress
import secrets
from dataclasses import dataclass
from enum import Enum

SECRET_BYTES = 32
CHALLENGE_BYTES = 32
_ID_BYTES = 6
_PREFIX = "sentinel"  # so that secret scanners, and people, know one when they see it
_JOIN = b"sentinel join 1"


class Role(Enum):
    """What somebody may do. Each includes the ones before it."""

    WATCH = "watch"  # see everything, and stop the robot
    DRIVE = "drive"  # move it, record, build and name: all that can be undone
    ADMIN = "admin"  # delete, and decide who may

    def includes(self, needed: Role) -> bool:
        """Whether this role may do what `needed` may."""
        return _RANK[self] >= _RANK[needed]


_RANK = {role: rank for rank, role in enumerate(Role)}


@dataclass(frozen=True, slots=True)
class Token:
    """What a person or program keeps. Never logged: `str` and `repr` show only the id."""

    id: str
    secret: bytes

    @classmethod
    def new(cls) -> Token:
        return cls(secrets.token_hex(_ID_BYTES), secrets.token_bytes(SECRET_BYTES))

    @classmethod
    def parse(cls, text: str) -> Token | None:
        """None: that is no token."""
        prefix, _, rest = text.strip().partition("_")
        token_id, _, secret = rest.partition("_")
        try:
            raw = base64.b64decode(secret + "=", altchars=b"-_", validate=True)
        except (binascii.Error, ValueError):
            return None
        is_whole = prefix == _PREFIX and len(raw) == SECRET_BYTES and len(token_id) == 2 * _ID_BYTES
        return cls(token_id, raw) if is_whole and token_id.isalnum() and token_id.isascii() else None

    @property
    def text(self) -> str:
        """The one form it is shown and typed in."""
        return f"{_PREFIX}_{self.id}_{base64.urlsafe_b64encode(self.secret).decode().rstrip('=')}"

    @property
    def digest(self) -> bytes:
        """What a book keeps instead. Of 256 random bits there is nothing to guess, so one hash is enough."""
        return hashlib.sha256(self.secret).digest()

    def __repr__(self) -> str:
        return f"Token({self.id})"


def is_secret_of(secret: bytes, digest: bytes) -> bool:
    """Compares in constant time."""
    return hmac.compare_digest(hashlib.sha256(secret).digest(), digest)


def new_challenge() -> bytes:
    """Fresh for each connection, so that no answer fits twice."""
    return secrets.token_bytes(CHALLENGE_BYTES)


def prove(token: Token, challenge: bytes, fingerprint: bytes) -> bytes:
    """The answer to a challenge, for the peer with this certificate only. Source: RFC 5802, ClientProof."""
    return _xor(token.secret, _signature(token.digest, challenge, fingerprint, token.id))


def is_proof(proof: bytes, digest: bytes, token_id: str, challenge: bytes, fingerprint: bytes) -> bool:
    """Whether the answer came from somebody who has the token itself; the digest alone makes none."""
    if len(proof) != SECRET_BYTES:
        return False
    return is_secret_of(_xor(proof, _signature(digest, challenge, fingerprint, token_id)), digest)


def _signature(digest: bytes, challenge: bytes, fingerprint: bytes, token_id: str) -> bytes:
    parts = (_JOIN, challenge, fingerprint, token_id.encode())
    said = b"".join(len(part).to_bytes(4, "big") + part for part in parts)
    return hmac.digest(digest, said, "sha256")


def _xor(a: bytes, b: bytes) -> bytes:
    return bytes(x ^ y for x, y in zip(a, b, strict=True))


class GuessLimit:
    """How many different wrong secrets an address may show before it is told to wait.

    The right one is let in meanwhile: others share an address (a router's, an IPv6 network's), and nobody's guesses may
    keep them from stopping a robot. Nothing is lost by that: 256 random bits are found neither at ten tries a minute
    nor at a million. The same wrong one again (a page with an old cookie) is no new guess. Memory is bounded: who was
    seen longest ago is forgotten first.
    """

    def __init__(self, limit: int = 10, window_s: float = 60.0, max_addresses: int = 1024) -> None:
        self._limit, self._window_s, self._max = limit, window_s, max_addresses
        self._wrong: dict[str, dict[bytes, float]] = {}  # address → hash of what was shown → when

    def wait_s(self, address: str, now_s: float) -> float:
        """How long this address is to wait before it shows something else; 0: not at all."""
        shown = self._wrong.get(network_of(address), {})
        recent = sorted(t for t in shown.values() if 0 <= now_s - t < self._window_s)  # a clock may be set back
        return 0.0 if len(recent) < self._limit else recent[-self._limit] + self._window_s - now_s

    def wrong(self, address: str, shown: bytes, now_s: float) -> None:
        """It showed something that fits nobody."""
        address = network_of(address)
        seen = self._wrong.pop(address, {})
        seen = {key: t for key, t in seen.items() if 0 <= now_s - t < self._window_s}
        if len(seen) < self._limit:
            seen.setdefault(hashlib.sha256(shown).digest(), now_s)
        self._wrong[address] = seen
        while len(self._wrong) > self._max:
            del self._wrong[next(iter(self._wrong))]


@functools.lru_cache(maxsize=1024)
def network_of(address: str) -> str:
    """Whom an address is counted as.

    An IPv4 address (also as a socket for both kinds shows it), or the half of an IPv6 address that a home has.
    """
    try:
        known = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(known, ipaddress.IPv4Address):
        return str(known)
    return str(known.ipv4_mapped or ipaddress.ip_network((known, 64), strict=False))
