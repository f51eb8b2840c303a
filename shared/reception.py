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
import sys
from collections.abc import Callable
from typing import Any

from shared.access import network_of
from shared.seats import Rank, Seats

logger = logging.getLogger(__name__)

PAUSE_S = 0.2  # when the machine has no file descriptor for another connection
SILENT_S = 5
ACCEPTED_AT_ONCE = 256  # then the event loop turns; one costs some 50 us
HANDSHAKES_AT_ONCE = 8  # begun in one turn of the event loop; one costs some 1 ms
MAX_FAMILIAR = 256  # addresses; the one that was heard from longest ago is forgotten
END_OF_TLS_WITHIN_S = 3.0  # asyncio would wait 30 s for the peer's goodbye


class Caller:
    """One connection from the moment it is taken. Its protocol calls `made` and `left`."""

    def __init__(
        self, connection: socket.socket, address: str, strangers: Seats, familiar: dict[str, None], within_s: float
    ) -> None:
        self.connection = connection
        self.is_known = False
        self._network = network_of(address)
        self._familiar = familiar
        self._transport: asyncio.Transport | None = None
        self.handshake: asyncio.Task[None] | None = None
        # Where somebody known has called from before, connections are preferred to those of other addresses.
        self.rank = Rank.HIGH if self._network in familiar else Rank.LOW
        self._seats, self._seat = strangers, strangers.take(self._network, self.rank, self.abort)
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
        else:
            self.left()
            self.connection.close()


class Reception:
    """Hands over connections whose handshake is done (without TLS: at once)."""

    def __init__(
        self,
        listener: socket.socket,
        tls: dict[str, Any],
        limit: int,
        within_s: float,
        make_protocol: Callable[[Caller], asyncio.Protocol],
        *,
        callers_speak_first: bool,
    ) -> None:
        """
        Args:
            tls: arguments of loop.connect_accepted_socket.
            limit: how many strangers there may be at once, at most half of them from one address.
            within_s: for how long one may stay a stranger.
            make_protocol: what a new connection speaks.
            callers_speak_first: who says nothing stays with the kernel for SILENT_S, where a connection costs least.
        """
        if callers_speak_first and sys.platform == "linux":
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, SILENT_S)
        self._listener = listener
        self._tls = tls | {"ssl_shutdown_timeout": END_OF_TLS_WITHIN_S} if tls else {}
        self._within_s = within_s
        self._make_protocol = make_protocol
        self._strangers = Seats(limit, max(1, limit // 2), oldest_yields=True)
        self._familiar: dict[str, None] = {}
        self._waiting: list[Caller] = []  # for their handshakes to begin
        self._handshakes: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Accept until cancelled; closes the listener."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                try:
                    if not self._waiting:
                        await _until_readable(loop, self._listener)
                    self._receive_all()
                except OSError as exc:
                    logger.warning("no connection can be taken just now: %s", exc)
                    await asyncio.sleep(PAUSE_S)
                self._begin_handshakes()
                await asyncio.sleep(0)  # a flood must not hold up the loop
        finally:
            self._listener.close()
            for caller in self._waiting:
                caller.abort()
            handshakes = list(self._handshakes)
            for task in handshakes:
                task.cancel()
            await asyncio.gather(*handshakes, return_exceptions=True)

    def _receive_all(self) -> None:
        """What waits in the kernel, which keeps no more than `listening.BACKLOG`."""
        with contextlib.suppress(BlockingIOError):
            for _ in range(ACCEPTED_AT_ONCE):
                self._receive(*self._listener.accept())

    def _receive(self, connection: socket.socket, address: object) -> None:
        connection.setblocking(False)
        if _has_ended(connection):
            connection.close()
            return
        host = str(address[0]) if isinstance(address, tuple) else ""
        caller = Caller(connection, host, self._strangers, self._familiar, self._within_s)
        if caller.is_seated:
            self._waiting.append(caller)
        else:
            caller.abort()

    def _begin_handshakes(self) -> None:
        """Of who is familiar first, and of not too many: a flood must hold up neither them nor the event loop."""
        waiting = sorted((c for c in self._waiting if c.is_seated), key=lambda c: c.rank, reverse=True)
        self._waiting = waiting[HANDSHAKES_AT_ONCE:]
        for caller in waiting[:HANDSHAKES_AT_ONCE]:
            self._begin_handshake(caller)

    def _begin_handshake(self, caller: Caller) -> None:
        handshake = asyncio.get_running_loop().create_task(self._shake_hands(caller))
        caller.handshake = handshake
        self._handshakes.add(handshake)

        def ended(_: asyncio.Task[None]) -> None:
            self._handshakes.discard(handshake)
            if not caller.is_made:  # it failed, or never began: no protocol will tell of the end
                caller.connection.close()
                caller.left()

        handshake.add_done_callback(ended)

    async def _shake_hands(self, caller: Caller) -> None:
        loop = asyncio.get_running_loop()
        try:
            await loop.connect_accepted_socket(lambda: self._make_protocol(caller), caller.connection, **self._tls)
        except OSError as exc:  # also what TLS does not like, and a handshake that takes too long
            logger.debug("a connection ended before its handshake did: %s", exc)


async def _until_readable(loop: asyncio.AbstractEventLoop, listener: socket.socket) -> None:
    """Not `loop.sock_accept`: what that has accepted when the task is cancelled belongs to nobody, and stays open."""
    readable = asyncio.Event()
    loop.add_reader(listener, readable.set)
    try:
        await readable.wait()
    finally:
        loop.remove_reader(listener)


def _has_ended(connection: socket.socket) -> bool:
    """Whether its caller is gone already, without a word."""
    try:
        return not connection.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return False
    except OSError:
        return True
