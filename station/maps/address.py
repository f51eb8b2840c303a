"""What some bytes must be: their SHA-256, and a CRC-32 that finds a single wrong bit (docs/maps.md)."""

from __future__ import annotations

import hashlib
import re
import zlib

ADDRESS = re.compile(r"[0-9a-f]{64}-[0-9a-f]{8}")
ADDRESS_LENGTH = 64 + 1 + 8
_POLYNOMIAL = 0xEDB88320  # CRC-32 of IEEE 802.3, bits reversed, as zlib computes it


def address_of(data: bytes) -> str:
    """`sha256-crc32`, both in hexadecimal: the name these bytes are kept under."""
    return f"{hashlib.sha256(data).hexdigest()}-{zlib.crc32(data):08x}"


def is_whole(data: bytes, address: str) -> bool:
    """Whether these are the bytes of this address."""
    return address_of(data) == address


def heal(data: bytes, address: str) -> bytes | None:
    """The bytes of this address where one wrong bit is all that `data` differs by; None otherwise.

    CRC-32 is linear: the two CRCs' difference is that of the wrong bit alone, x^(its distance from the end) mod the
    polynomial, and below 2^32 - 1 bits no two places give the same. The SHA-256 then proves the result.
    """
    wrong = zlib.crc32(data) ^ int(address.rpartition("-")[2], 16)
    if wrong == 0 or not data:
        return None
    syndromes = [_POLYNOMIAL]  # of the eight bits of the last byte, the highest bit first
    for _ in range(7):
        syndromes.append(_step(syndromes[-1]))
    if wrong in (found := {s: bit for bit, s in enumerate(syndromes)}):
        return _flipped(data, len(data) - 1, 7 - found[wrong], address)
    # Walk the difference backwards, a byte a step, until it is that of a bit of the byte walked to.
    state = wrong
    for position in range(len(data) - 2, -1, -1):
        state = _back_one_byte(state)
        if state in found:
            return _flipped(data, position, 7 - found[state], address)
    return None


def wrong_bits(found: bytes, wanted: bytes) -> int:
    """By how many bits two differ; by all of them where they are not of one length."""
    if len(found) != len(wanted):
        return 8 * max(len(found), len(wanted))
    return (int.from_bytes(found) ^ int.from_bytes(wanted)).bit_count()


def is_nearly(found: bytes, wanted: bytes) -> bool:
    """Whether one wrong bit at most is all that they differ by. For what is known by heart and has no address."""
    return wrong_bits(found, wanted) <= 1


def _flipped(data: bytes, position: int, bit: int, address: str) -> bytes | None:
    healed = bytearray(data)
    healed[position] ^= 1 << bit
    return bytes(healed) if is_whole(bytes(healed), address) else None


def _step(state: int) -> int:
    """Multiply by x: one bit nearer to the beginning."""
    return (state >> 1) ^ (_POLYNOMIAL if state & 1 else 0)


def _unstep(state: int) -> int:
    """Divide by x. The polynomial's top bit tells whether it was added."""
    return ((state ^ _POLYNOMIAL) << 1 | 1) if state & 0x80000000 else state << 1


def _back_eight(state: int) -> int:
    for _ in range(8):
        state = _unstep(state)
    return state & 0xFFFFFFFF


_BACK = [_back_eight(high << 24) for high in range(256)]


def _back_one_byte(state: int) -> int:
    return (state << 8 & 0xFFFFFFFF) ^ _BACK[state >> 24]
