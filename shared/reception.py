"""Takes connections from the port. Who is still shaking hands is bounded, in number and in time.

asyncio's own TLS server takes any number of connections that never say a word; each costs memory and a file descriptor.
"""

from __future__ import annotations

import asyncio
import collections
import logging
import socket
from collections.abc import Awaitable, Callable
from typing import Any, Generic, TypeVar

logger = logging.getLogger(__name__)

P = TypeVar("P", bound=asyncio.Protocol)
PAUSE_S = 0.2  # when the machine has no file descriptor for another connection


async def _nothing_more(transport: asyncio.Transport, protocol: asyncio.Protocol) -> None:
    """Its handshake is enough."""


class Reception(Generic[P]):
    """Hands over connections whose handshake is done (without TLS: at once)."""

    def __init__(
        self,
        listener: socket.socket,
        tls: dict[str, Any],
        limit: int,
        make_protocol: Callable[[], P],
        until_in: Callable[[asyncio.Transport, P], Awaitable[None]] = _nothing_more,
    ) -> None:
        """`tls`: arguments of loop.connect_accepted_socket; `limit`: how many may shake hands at once.

        `until_in` returns when a connection whose handshake is done is no stranger any more; until then it counts too.
        When it is cancelled it must yield: another one needs the room.
        """
        self._listener = listener
        self._tls = tls
        self._limit = limit
        self._make_protocol = make_protocol
        self._until_in = until_in
        self._waiting: dict[asyncio.Task[None], str] = {}  # strangers and from where, the oldest first

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
                task = loop.create_task(self._receive(connection))
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
        """Of the address with most strangers the oldest yields: silence must not keep others out."""
        if len(self._waiting) < self._limit:
            return
        busiest, _ = collections.Counter(self._waiting.values()).most_common(1)[0]
        oldest = next(task for task, address in self._waiting.items() if address == busiest)
        oldest.cancel()
        del self._waiting[oldest]

    async def _receive(self, connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        try:
            transport, protocol = await loop.connect_accepted_socket(self._make_protocol, connection, **self._tls)
        except OSError as exc:  # also what TLS does not like, and a handshake that takes too long
            logger.debug("a connection ended before its handshake did: %s", exc)
            return
        await self._until_in(transport, protocol)
