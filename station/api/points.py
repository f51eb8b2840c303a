"""Point clouds on the wire: 16 bytes of header, 16 bytes per point, little endian (docs/api.md)."""

from __future__ import annotations

import struct
from typing import Any

from fastapi import Response

# magic, number of points here, number of the first one, number of points there are
POINTS_HEADER = struct.Struct("<4sIII")
POINTS_MAGIC = b"SLM1"
BINARY: dict[str, Any] = {
    "description": "header `SLM1`, count u32, first u32, total u32; then per point x y z float32, r g b place uint8",
    "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
}


def points_response(packed: bytes, first: int, total: int, source: str) -> Response:
    """Packed points (station/live.py) with their header."""
    header = POINTS_HEADER.pack(POINTS_MAGIC, len(packed) // 16, first, total)
    headers = {"X-Source": source, "Cache-Control": "no-store"}
    return Response(header + packed, media_type="application/octet-stream", headers=headers)
