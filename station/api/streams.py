"""Video to a viewer: the head of a picture, and a stream that gives its seat back."""

from __future__ import annotations

import struct
from collections.abc import AsyncIterator

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from station.api.limits import MAX_STREAMS, Seats

# Little endian: seq u32, width u16, height u16, t_robot_ns i64, age_s f64 (NaN: clocks unknown), skipped u32, 0 u32.
HEADER = struct.Struct("<IHHqdII")


BOUNDARY = b"sentinel-frame"


class SeatedStream(StreamingResponse):
    """Multipart JPEG that keeps one of its kind's seats as long as it is sent."""

    def __init__(self, parts: AsyncIterator[bytes], kind: str) -> None:
        super().__init__(parts, media_type=f"multipart/x-mixed-replace; boundary={BOUNDARY.decode()}")
        self._kind = kind

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        seats: Seats = scope["app"].state.seats
        with seats.take(self._kind, MAX_STREAMS):
            await super().__call__(scope, receive, send)


STREAM = {"content": {"multipart/x-mixed-replace": {}}, "description": "JPEGs, one after the other"}
