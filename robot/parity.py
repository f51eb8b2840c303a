"""How many pieces of parity a picture needs on a link that loses some. Pure."""

from __future__ import annotations

import math

from shared.picture_pieces import MAX_PARITY

REMEMBERED_PIECES = 500.0  # some seconds of pictures on a thin link
FIRST_LOSS = 0.05  # before anything is measured, as much as was seen in this many pieces:
FIRST_PIECES = 50.0
MOST_CLUSTERED = 10.0  # by chance a few losses look like more
SIGMAS = 2.0  # one picture in some forty may lack a piece: the next one follows at once


class Losses:
    """What share of pieces is lost, and how much more than by chance they are lost together."""

    def __init__(self) -> None:
        self._pieces, self._lost = FIRST_PIECES, FIRST_LOSS * FIRST_PIECES
        self._squares = self._expected_squares = 1.0

    @property
    def share(self) -> float:
        return self._lost / self._pieces

    @property
    def clustering(self) -> float:
        """Variance of the number lost of a picture, over that of independent losses; 1 at least."""
        return min(max(1.0, self._squares / self._expected_squares), MOST_CLUSTERED)

    def note(self, pieces: int, lost: int) -> None:
        """Of a picture's pieces so many did not arrive."""
        kept = math.exp(-pieces / REMEMBERED_PIECES)
        expected = pieces * self.share
        variance = expected * (1.0 - self.share)
        self._squares = kept * self._squares + (lost - expected) ** 2
        self._expected_squares = kept * self._expected_squares + variance
        self._pieces = kept * self._pieces + pieces
        self._lost = kept * self._lost + lost

    def parity(self, pieces: int) -> int:
        """So that `SIGMAS` more than are usually lost of the pieces and their parity may be lost.

        No more than half as much as there are pieces, and two: where so much is lost a queue overflows, and more of it
        fills that.
        """
        most = min(pieces // 2 + 2, MAX_PARITY)
        for count in range(1, most):
            usual = (pieces + count) * self.share
            # Half a piece more: whole numbers are compared with a continuous distribution.
            if usual + SIGMAS * math.sqrt(usual * (1.0 - self.share) * self.clustering) <= count + 0.5:
                return count
        return most
