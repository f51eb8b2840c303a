"""A picture cut into pieces for datagrams, with parity, and put together from enough of them. No socket, no clock.

Each piece says of which picture it is, so that the station needs to know nothing before.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass, field

from shared.datagrams import MAX_CONTENT
from shared.erasure import MAX_PIECES, parity, restore
from shared.messages import MAX_REPORTED_PICTURES

PIECE = 1  # first byte of a datagram from the robot that holds a piece; a message begins otherwise (MESSAGE)
MESSAGE = 2
_HEADER = struct.Struct(">BIBBBI")  # PIECE, picture, piece, pieces, of parity, bytes of the picture
PIECE_BYTES = MAX_CONTENT - _HEADER.size
MAX_PARITY = 64
MAX_PICTURE_BYTES = (MAX_PIECES - 1 - MAX_PARITY) * PIECE_BYTES  # 220 kB: larger ones go by the connection
# A picture's pieces leave within 120 ms (robot/frame_budget.py); jitter comes on top.
WHOLE_WITHIN_NS = 250_000_000


def num_pieces(num_bytes: int) -> int:
    """Of a picture of so many bytes, without parity."""
    return -(-num_bytes // PIECE_BYTES)


def cut(content: bytes, picture: int, num_parity: int) -> list[bytes]:
    """The contents of a picture's datagrams; `picture` counts those of one session."""
    count = num_pieces(len(content))
    size = -(-len(content) // count)
    pieces = [content[n * size : (n + 1) * size].ljust(size, b"\0") for n in range(count)]
    return [
        _HEADER.pack(PIECE, picture, n, count, num_parity, len(content)) + piece
        for n, piece in enumerate(pieces + parity(pieces, num_parity))
    ]


@dataclass(slots=True)
class ArrivingPicture:
    """What has come of a picture."""

    picture: int
    num_pieces: int
    num_parity: int
    num_bytes: int
    first_piece: int
    first_ns: int
    last_piece: int
    last_ns: int
    pieces: dict[int, bytes] = field(default_factory=dict)  # empty again as soon as nothing is waited for
    count: int = 0
    is_over: bool = False  # put together, or given up

    @property
    def piece_bytes(self) -> int:
        return -(-self.num_bytes // self.num_pieces)


class Assembler:
    """Puts pictures together. A picture is handed out once, as soon as it is whole, and never behind a newer one."""

    def __init__(self) -> None:
        self.newest: deque[ArrivingPicture] = deque(maxlen=MAX_REPORTED_PICTURES)  # in their order
        self._newest_whole = -1
        self.refused = 0  # pieces that no robot of ours sends

    def add(self, content: bytes, now_ns: int) -> bytes | None:
        """A piece has come; returns the picture that it makes whole."""
        if len(content) < _HEADER.size:
            self.refused += 1
            return None
        _, picture, number, count, num_parity, num_bytes = _HEADER.unpack_from(content)
        piece = content[_HEADER.size :]
        if not (number < count + num_parity < MAX_PIECES and 0 < count <= num_bytes) or count != num_pieces(num_bytes):
            self.refused += 1
            return None
        arriving = self._arriving(
            ArrivingPicture(picture, count, num_parity, num_bytes, number, now_ns, number, now_ns)
        )
        if arriving is None:
            return None
        told = (arriving.num_pieces, arriving.num_parity, arriving.num_bytes)
        if (count, num_parity, num_bytes) != told or len(piece) != arriving.piece_bytes or number in arriving.pieces:
            self.refused += 1
            return None
        arriving.count += 1
        arriving.last_piece, arriving.last_ns = number, now_ns
        if arriving.is_over:
            return None
        arriving.pieces[number] = piece
        if now_ns - arriving.first_ns > WHOLE_WITHIN_NS or picture < self._newest_whole:
            self._end(arriving)
            return None
        if len(arriving.pieces) < count:
            return None
        whole = b"".join(restore(arriving.pieces, count))[:num_bytes]
        self._newest_whole = picture
        self._end(arriving)
        return whole

    def _arriving(self, begun: ArrivingPicture) -> ArrivingPicture | None:
        """The picture of a piece; None: it is older than those that are still known."""
        found = next((known for known in self.newest if known.picture == begun.picture), None)
        if found is not None:
            return found
        if self.newest and begun.picture < self.newest[-1].picture:
            return None  # all its pieces were overtaken
        self.newest.append(begun)
        return begun

    def _end(self, arriving: ArrivingPicture) -> None:
        arriving.is_over = True
        arriving.pieces.clear()
