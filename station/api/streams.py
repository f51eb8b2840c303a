"""Pictures to a viewer: one, one after the other by a socket, or a stream that gives its seat back."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator

from fastapi import Response, WebSocket
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from station.api.limits import MAX_STREAMS, STREAMS_PER_TOKEN, Replaced, SeatsByKind, receive_text

# Little endian: seq u32, width u16, height u16, t_robot_ns i64, age_s f64 (NaN: clocks unknown), skipped u32, 0 u32.
HEADER = struct.Struct("<IHHqdII")
BOUNDARY = b"sentinel-frame"
STREAM = {"content": {"multipart/x-mixed-replace": {}}, "description": "JPEGs, one after the other"}


def image_response(encoded: bytes) -> Response:
    """A JPEG or PNG that never changes."""
    kind = "image/png" if encoded.startswith(b"\x89PNG") else "image/jpeg"
    return Response(encoded, media_type=kind, headers={"Cache-Control": "private, max-age=3600"})


class AcknowledgedPictures:
    """Pictures by a socket: the peer answers each with any text, and gets the next one then."""

    def __init__(self, socket: WebSocket) -> None:
        self._socket = socket
        self._acknowledged = asyncio.Event()

    async def hear(self) -> None:
        await receive_text(self._socket)
        self._acknowledged.set()

    async def send(self, picture: bytes) -> None:
        """Returns when it was answered."""
        self._acknowledged.clear()
        await self._socket.send_bytes(picture)
        await self._acknowledged.wait()


class SeatedStream(StreamingResponse):
    """Multipart JPEG that keeps one of its kind's seats as long as it is sent."""

    def __init__(self, parts: AsyncIterator[bytes], kind: str) -> None:
        super().__init__(parts, media_type=f"multipart/x-mixed-replace; boundary={BOUNDARY.decode()}")
        self._kind = kind

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        seats: SeatsByKind = scope["app"].state.seats
        try:
            async with seats.take(self._kind, MAX_STREAMS, STREAMS_PER_TOKEN, scope["state"]["visitor"]):
                await super().__call__(scope, receive, send)
        except Replaced:
            await send({"type": "http.response.body", "body": b"", "more_body": False})


def part_of_stream(jpeg: bytes) -> bytes:
    """A picture with the head that it has in a SeatedStream."""
    return b"--%s\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (BOUNDARY, len(jpeg), jpeg)
