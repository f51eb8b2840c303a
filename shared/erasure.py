"""Parity for lost pieces: of n pieces and m of parity, all equally long, any n restore the n.

Systematic Reed-Solomon code over GF(256): parity is a Cauchy matrix times the pieces, so that every square part of it
can be inverted. Its columns are scaled until its first row is all ones: one piece of parity is the pieces' XOR.
Multiplying a piece by a constant is `bytes.translate`, adding is XOR of whole numbers: no library is needed, and the
only one that is kept (zfec) has no wheel for the Raspberry Pi.
Sources: Blömer et al., "An XOR-based erasure-resilient coding scheme", ICSI TR-95-048, 1995 (Cauchy matrix); Plank,
"A tutorial on Reed-Solomon coding for fault-tolerance in RAID-like systems", Software: Practice and Experience, 1997.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache

MAX_PIECES = 256  # with parity: each has its own element of the field
_POLYNOMIAL = 0x11D  # x^8 + x^4 + x^3 + x^2 + 1, of which x is a generator


def _powers() -> list[int]:
    """x^0 .. x^254."""
    values = [1]
    while len(values) < 255:
        doubled = values[-1] << 1
        values.append(doubled ^ _POLYNOMIAL if doubled & 0x100 else doubled)
    return values


_EXP = _powers()
_LOG = {value: exponent for exponent, value in enumerate(_EXP)}


def multiply(a: int, b: int) -> int:
    """In GF(256)."""
    return _EXP[(_LOG[a] + _LOG[b]) % 255] if a and b else 0


def divide(a: int, b: int) -> int:
    """In GF(256); b is not 0."""
    return _EXP[(_LOG[a] - _LOG[b]) % 255] if a else 0


@cache
def _times(factor: int) -> bytes:
    """The table of products with a factor, for `bytes.translate`."""
    return bytes(multiply(factor, value) for value in range(256))


@cache
def _coefficient(row: int, column: int) -> int:
    """Of the Cauchy matrix 1 / (x_row + y_column), x = 255, 254, ..., y = 0, 1, ..., each column over its first."""
    return divide(255 ^ column, (255 - row) ^ column)


def _combine(terms: Iterable[tuple[int, bytes]], size: int) -> bytes:
    """Sum of factor times piece."""
    total = 0
    for factor, piece in terms:
        total ^= int.from_bytes(piece if factor == 1 else piece.translate(_times(factor)), "little")
    return total.to_bytes(size, "little")


def parity(pieces: Sequence[bytes], count: int) -> list[bytes]:
    """`count` pieces of parity. Together there may be MAX_PIECES."""
    return [
        _combine(((_coefficient(row, column), piece) for column, piece in enumerate(pieces)), len(pieces[0]))
        for row in range(count)
    ]


def restore(arrived: Mapping[int, bytes], num_pieces: int) -> list[bytes]:
    """The pieces, from any `num_pieces` of them and their parity.

    Args:
        arrived: number → piece; parity is numbered from `num_pieces` on.
    """
    lost = [column for column in range(num_pieces) if column not in arrived]
    rows = [number - num_pieces for number in sorted(arrived) if number >= num_pieces][: len(lost)]
    size = len(next(iter(arrived.values())))
    known = [(column, arrived[column]) for column in range(num_pieces) if column in arrived]
    sums = [
        _combine(
            [(_coefficient(row, column), piece) for column, piece in known] + [(1, arrived[num_pieces + row])], size
        )
        for row in rows
    ]
    inverse = _inverse([[_coefficient(row, column) for column in lost] for row in rows])
    found = {
        column: _combine(zip(factors, sums, strict=True), size) for column, factors in zip(lost, inverse, strict=True)
    }
    return [found[column] if column in found else arrived[column] for column in range(num_pieces)]


def _inverse(matrix: list[list[int]]) -> list[list[int]]:
    """By Gauss and Jordan's elimination. Square parts of a Cauchy matrix have one, and their pivots are not 0."""
    size = len(matrix)
    rows = [[*row, *(int(i == j) for j in range(size))] for i, row in enumerate(matrix)]
    for pivot in range(size):
        lead = rows[pivot][pivot]
        rows[pivot] = [divide(value, lead) for value in rows[pivot]]
        for other in range(size):
            if other != pivot and (factor := rows[other][pivot]):
                rows[other] = [
                    value ^ multiply(factor, basis) for value, basis in zip(rows[other], rows[pivot], strict=True)
                ]
    return [row[size:] for row in rows]
