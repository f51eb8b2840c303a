"""What waits at a UDP socket."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

from shared.datagrams import MAX_DATAGRAM

READ_AT_ONCE = 64  # then the event loop turns


def waiting_datagrams(port: socket.socket) -> Iterator[tuple[bytes, Any]]:
    """Datagrams that have come to a non-blocking socket, with their senders; longer ones than ours by one byte."""
    for _ in range(READ_AT_ONCE):
        try:
            yield port.recvfrom(MAX_DATAGRAM + 1)
        except OSError:  # none is left; or the word that what was sent last met nobody
            return
