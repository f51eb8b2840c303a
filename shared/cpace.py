"""CPace on X25519 with SHA-512, one side beginning: how two who know a short code agree on a long secret.

Source: draft-irtf-cfrg-cpace, suite CPACE-X25519-SHA512 (sections 6 and 7, test vectors in appendix B.1). Every
multiplication with a secret number is `cryptography`'s X25519, in constant time. The map of the code onto the curve is
Python's arithmetic: without a branch or index that depends on the code, but not in constant time.
"""

from __future__ import annotations

import hashlib

SHARE_BYTES = 32
_NAME, _KEY_NAME = b"CPace255", b"CPace255_ISK"
_BLOCK_BYTES = 128  # of SHA-512
_Q = 2**255 - 19
_A = 486662  # Curve25519: y^2 = x^3 + A x^2 + x
_HALF = pow(2, -1, _Q)


def generator(code: bytes, channel: bytes, sid: bytes = b"") -> bytes:
    """The point (32 bytes, its u-coordinate) that stands for this code on this channel."""
    # The zeros fill a block of the hash, so that its time tells nothing of the code's length.
    zeros = bytes(max(0, _BLOCK_BYTES - 1 - len(_with_length(code)) - len(_with_length(_NAME))))
    digest = hashlib.sha512(_join(_NAME, code, zeros, channel, sid)).digest()[:SHARE_BYTES]
    return _elligator2(int.from_bytes(digest, "little") % 2**255).to_bytes(SHARE_BYTES, "little")


def multiply(scalar: bytes, point: bytes) -> bytes:
    """A point (32 bytes) times a secret number. Raises ValueError: no point, or one of low order."""
    from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

    return X25519PrivateKey.from_private_bytes(scalar).exchange(X25519PublicKey.from_public_bytes(point))


def session_key(secret: bytes, first: tuple[bytes, bytes], second: tuple[bytes, bytes], sid: bytes = b"") -> bytes:
    """The key (64 bytes) of both, from the secret point and from what each has sent: share and associated data."""
    return hashlib.sha512(_join(_KEY_NAME, sid, secret) + _join(*first) + _join(*second)).digest()


def _elligator2(r: int) -> int:
    """A point's u-coordinate for any number (RFC 9380, 6.7.2, with Z = 2)."""
    v = -_A * pow(1 + 2 * r * r, _Q - 2, _Q) % _Q
    is_square = pow(v * v * v + _A * v * v + v, (_Q - 1) // 2, _Q)  # 1, or -1
    return (is_square * v - (1 - is_square) * _A * _HALF) % _Q


def _with_length(part: bytes) -> bytes:
    """Behind its length, seven bits a byte, the lowest first."""
    length, head = len(part), b""
    while length > 127:
        head += bytes([length & 127 | 128])
        length >>= 7
    return head + bytes([length]) + part


def _join(*parts: bytes) -> bytes:
    return b"".join(map(_with_length, parts))
