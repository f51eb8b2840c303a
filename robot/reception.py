"""Takes connections from the port. Who is still shaking hands is bounded, in number and in time.

asyncio's own TLS server takes any number of connections that never say a word; each costs memory and a file descriptor.
"""

from __future__ import annotations

import asyncio
import collections
import logging
import socket
from collections.abc import Callable
from typing import Any

logger = logging.getLogger(__name__)

PAUSE_S = 0.2  # when the machine has no file descriptor for another connection


class Reception:
    """Hands over connections whose handshake is done (without TLS: at once)."""

    def __init__(
        self,
        listener: socket.socket,
        tls: dict[str, Any],
        limit: int,
        take_in: Callable[[asyncio.StreamReader, asyncio.StreamWriter], None],
    ) -> None:
        """`tls`: arguments of loop.connect_accepted_socket; `limit`: how many may shake hands at once."""
        self._listener = listener
        self._tls = tls
        self._limit = limit
        self._take_in = take_in
        self._waiting: dict[asyncio.Task[None], str] = {}  # handshakes under way and from where, the oldest first

    @property
    def num_waiting(self) -> int:
        """Handshakes under way."""
        return len(self._waiting)

    async def run(self) -> None:
        """Accept until cancelled; closes the listener."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                try:
                    connection, address = await loop.sock_accept(self._listener)
                except OSError as exc:
                    logger.warning("no connection can be taken just now: %s", exc)
                    await asyncio.sleep(PAUSE_S)
                    continue
                self._make_room()
                task = loop.create_task(self._shake_hands(connection))
                self._waiting[task] = str(address[0]) if isinstance(address, tuple) else ""
                task.add_done_callback(lambda done: self._waiting.pop(done, None))
                await asyncio.sleep(0)  # it owns the connection once it has begun; a flood must not hold up the loop
        finally:
            self._listener.close()
            waiting = list(self._waiting)
            for task in waiting:
                task.cancel()
            await asyncio.gather(*waiting, return_exceptions=True)

    def _make_room(self) -> None:
        """Of the address with most handshakes the oldest yields: silence must not keep others out."""
        if len(self._waiting) < self._limit:
            return
        busiest, _ = collections.Counter(self._waiting.values()).most_common(1)[0]
        oldest = next(task for task, address in self._waiting.items() if address == busiest)
        oldest.cancel()
        del self._waiting[oldest]

    async def _shake_hands(self, connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        reader = asyncio.StreamReader(loop=loop)
        protocol = asyncio.StreamReaderProtocol(reader, self._take_in, loop=loop)
        try:
            await loop.connect_accepted_socket(lambda: protocol, connection, **self._tls)
        except OSError as exc:  # also what TLS does not like, and a handshake that takes too long
            logger.debug("a connection ended before its handshake did: %s", exc)
