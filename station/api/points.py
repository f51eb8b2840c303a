"""Point clouds on the wire: 16 bytes of header, 16 bytes per point, little endian (docs/api.md)."""

from __future__ import annotations

import asyncio
import struct
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from fastapi import Depends, Header, Query, Response

from station.files.ply import cloud_columns, encode_ply

# magic, number of points here, number of the first one, number of points there are
POINTS_HEADER = struct.Struct("<4sIII")
POINTS_MAGIC = b"SLM1"
BINARY: dict[str, Any] = {
    "description": "header `SLM1`, count u32, first u32, total u32; then per point x y z float32, r g b place uint8",
    "content": {
        "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
        "application/x-ply": {},
    },
}
PLY_TYPES = ("application/x-ply", "application/ply", "model/ply", "text/ply")


async def _wants_ply(
    format: Annotated[Literal["binary", "ply"] | None, Query()] = None,
    accept: Annotated[str, Header(include_in_schema=False)] = "",
) -> bool:
    return format == "ply" or (format is None and any(kind in accept for kind in PLY_TYPES))


WantsPly = Annotated[bool, Depends(_wants_ply)]


def points_response(packed: bytes, first: int, total: int, source: str) -> Response:
    """Packed points (station/robots/live_slam.py) with their header."""
    header = POINTS_HEADER.pack(POINTS_MAGIC, len(packed) // 16, first, total)
    headers = {"X-Source": source, "Cache-Control": "no-store"}
    return Response(header + packed, media_type="application/octet-stream", headers=headers)


async def ply_response(p: npt.NDArray[np.floating], rgb: npt.NDArray[np.uint8], source: str, name: str) -> Response:
    """Points (n, 3) with their colours (n, 3) as a PLY file to download."""
    return Response(
        await asyncio.to_thread(encode_ply, cloud_columns(p, rgb)),
        media_type="application/x-ply",
        headers={"Content-Disposition": f'attachment; filename="{name}.ply"', "X-Source": source},
    )
