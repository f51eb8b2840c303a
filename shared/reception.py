"""Takes connections from the port. Who is not known yet is bounded, in number, by address and in time.

A connection is a stranger from when it is taken until somebody known has spoken on it, through TLS handshake, request
and refusal. Strangers have seats of their own, so that they take neither memory, nor file descriptors, nor seats from
those who are known.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable
from typing import Any

from shared.access import network_of
from shared.seats import Rank, Seats

logger = logging.getLogger(__name__)

PAUSE_S = 0.2  # when the machine has no file descriptor for another connection
ACCEPTED_AT_ONCE = 64  # then the event loop turns
MAX_FAMILIAR = 256  # addresses; the one that was heard from longest ago is forgotten
END_OF_TLS_WITHIN_S = 3.0  # asyncio would wait 30 s for the peer's goodbye


class Caller:
    """One connection from the moment it is taken. Its protocol calls `made` and `left`."""

    def __init__(self, address: str, strangers: Seats, familiar: dict[str, None], within_s: float) -> None:
        self.is_known = False
        self._network = network_of(address)
        self._familiar = familiar
        self._transport: asyncio.Transport | None = None
        self.handshake: asyncio.Task[None] | None = None
        # Where somebody known has called from before, connections are preferred to those of other addresses.
        rank = Rank.HIGH if self._network in familiar else Rank.LOW
        self._seats, self._seat = strangers, strangers.take(self._network, rank, self.abort)
        self._patience = asyncio.get_running_loop().call_later(within_s, self.abort)

    def made(self, transport: asyncio.Transport) -> None:
        """The handshake is done."""
        self._transport = transport

    @property
    def is_seated(self) -> bool:
        """Whether there is room for it."""
        return self._seat is not None

    @property
    def is_made(self) -> bool:
        return self._transport is not None

    def know(self, seats: Seats, holder: str, rank: Rank, end: Callable[[], None] | None = None) -> bool:
        """It is this holder's from now on, in one of these seats; False: there is none for it.

        `end`: what is to happen when it has to yield; None: the connection is ended at once.
        """
        if self.is_known and self._seat is not None and self._seat.holder == holder:
            return True
        seat = seats.take(holder, rank, end or self.abort)
        if seat is None:
            return False
        self.left()
        self.is_known, self._seats, self._seat = True, seats, seat
        self._familiar.pop(self._network, None)
        self._familiar[self._network] = None
        if len(self._familiar) > MAX_FAMILIAR:
            del self._familiar[next(iter(self._familiar))]
        return True

    def left(self) -> None:
        """It is gone, or goes on as a known one's."""
        self._patience.cancel()
        if self._seat is not None:
            self._seats.leave(self._seat)
            self._seat = None

    def abort(self) -> None:
        """End the connection at once."""
        if self._transport is not None:
            self._transport.abort()
        elif self.handshake is not None:
            self.handshake.cancel()


class Reception:
    """Hands over connections whose handshake is done (without TLS: at once)."""

    def __init__(
        self,
        listener: socket.socket,
        tls: dict[str, Any],
        limit: int,
        within_s: float,
        make_protocol: Callable[[Caller], asyncio.Protocol],
    ) -> None:
        """
        Args:
            tls: arguments of loop.connect_accepted_socket.
            limit: how many strangers there may be at once, at most half of them from one address.
            within_s: for how long one may stay a stranger.
            make_protocol: what a new connection speaks.
        """
        self._listener = listener
        self._tls = tls | {"ssl_shutdown_timeout": END_OF_TLS_WITHIN_S} if tls else {}
        self._within_s = within_s
        self._make_protocol = make_protocol
        self._strangers = Seats(limit, max(1, limit // 2), oldest_yields=True)
        self._familiar: dict[str, None] = {}
        self._handshakes: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Accept until cancelled; closes the listener."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                try:
                    connection, address = await loop.sock_accept(self._listener)
                    self._receive(connection, address)
                    self._receive_all()
                except OSError as exc:
                    logger.warning("no connection can be taken just now: %s", exc)
                    await asyncio.sleep(PAUSE_S)
                await asyncio.sleep(0)  # a flood must not hold up the loop
        finally:
            self._listener.close()
            handshakes = list(self._handshakes)
            for task in handshakes:
                task.cancel()
            await asyncio.gather(*handshakes, return_exceptions=True)

    def _receive_all(self) -> None:
        """What else waits. The kernel keeps 128, and whoever comes when a flood fills that waits a second and more."""
        with contextlib.suppress(BlockingIOError):
            for _ in range(ACCEPTED_AT_ONCE):
                self._receive(*self._listener.accept())

    def _receive(self, connection: socket.socket, address: object) -> None:
        connection.setblocking(False)
        host = str(address[0]) if isinstance(address, tuple) else ""
        caller = Caller(host, self._strangers, self._familiar, self._within_s)
        if not caller.is_seated:
            connection.close()
            caller.left()
            return
        handshake = asyncio.get_running_loop().create_task(self._shake_hands(connection, caller))
        caller.handshake = handshake
        self._handshakes.add(handshake)

        def ended(_: asyncio.Task[None]) -> None:
            self._handshakes.discard(handshake)
            if not caller.is_made:  # it failed, or never began: no protocol will tell of the end
                connection.close()
                caller.left()

        handshake.add_done_callback(ended)

    async def _shake_hands(self, connection: socket.socket, caller: Caller) -> None:
        loop = asyncio.get_running_loop()
        try:
            await loop.connect_accepted_socket(lambda: self._make_protocol(caller), connection, **self._tls)
        except OSError as exc:  # also what TLS does not like, and a handshake that takes too long
            logger.debug("a connection ended before its handshake did: %s", exc)
