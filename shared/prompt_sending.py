"""TCP sockets that send at once, and keep what waits where it can still be overtaken: with us, not in the kernel."""

from __future__ import annotations

import contextlib
import socket

UNSENT_BYTES = 16 * 1024  # of pictures: the kernel takes no more while so much of ours has not been sent once
UNSENT_COMMAND_BYTES = 256  # of commands: two of them; the next ones wait where the newest wins
CONGESTION = b"bbr"  # a lost packet halves no rate: on Wi-Fi it says nothing of a queue


def send_promptly(connection: socket.socket, unsent_bytes: int) -> None:
    """Set what the kernel knows of it; on other systems than Linux only that nothing waits to be filled up."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for name, value in (("TCP_NOTSENT_LOWAT", unsent_bytes), ("TCP_CONGESTION", CONGESTION)):
        if (option := getattr(socket, name, None)) is not None:
            with contextlib.suppress(OSError):  # a kernel without it, or one that lets only some choose it
                connection.setsockopt(socket.IPPROTO_TCP, option, value)
