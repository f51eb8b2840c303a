"""Encoded pictures before they are decoded: what they are, and how large they will be; and depth as one."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

JPEG_START = b"\xff\xd8"
PNG_START = b"\x89PNG\r\n\x1a\n"
MAX_PIXELS = 2**26  # 8192 x 8192, as large as a calibration may say; 200 MB decoded in colour
# JPEG markers that start a frame header (ITU-T T.81, table B.1): SOF0-3, 5-7, 9-11, 13-15.
_SIZE_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_BARE_MARKERS = {0x01, *range(0xD0, 0xD9)}  # no length follows


def picture_size(encoded: bytes) -> tuple[int, int]:
    """(width, height) in pixels from the header of a JPEG or PNG file.

    Raises:
        ValueError: it is neither, or has more pixels than are decoded; goes on a sentence that begins with its name.
    """
    width, height = _size(encoded)
    if not width or not height:
        raise ValueError("is not a readable JPEG or PNG")
    if width * height > MAX_PIXELS:
        raise ValueError(f"has {width}x{height} pixels, more than the {MAX_PIXELS} that are decoded")
    return width, height


def why_not_as_announced(encoded: bytes, width: int, height: int) -> str:
    """Why a picture is none of those pixels, by its own header; empty: it is one. Goes on a sentence.

    A browser takes memory for what a JPEG itself says, up to 65,535 x 65,535 pixels; and what is computed from another
    size with the camera's calibration is wrong without a sign of it.
    """
    try:
        own = picture_size(encoded)
    except ValueError as exc:
        return str(exc)
    return "" if own == (width, height) else f"is {own[0]}x{own[1]} pixels, announced were {width}x{height}"


def _size(encoded: bytes) -> tuple[int, int]:
    """(0, 0) where it is neither."""
    if encoded.startswith(PNG_START) and encoded[12:16] == b"IHDR" and len(encoded) >= 24:
        return int.from_bytes(encoded[16:20], "big"), int.from_bytes(encoded[20:24], "big")
    position = 2
    while encoded.startswith(JPEG_START) and position + 9 <= len(encoded) and encoded[position] == 0xFF:
        marker = encoded[position + 1]
        if marker in _SIZE_MARKERS:
            height = int.from_bytes(encoded[position + 5 : position + 7], "big")
            return int.from_bytes(encoded[position + 7 : position + 9], "big"), height
        if marker == 0xFF:  # filling
            position += 1
        elif marker in _BARE_MARKERS:
            position += 2
        else:
            position += 2 + int.from_bytes(encoded[position + 2 : position + 4], "big")
    return 0, 0


def depth_png(millimetres: npt.NDArray[np.uint16]) -> bytes:
    """A PNG file of 16 bit grey, of (H, W). Needs no OpenCV, which a robot may lack."""
    height, width = millimetres.shape
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    rows = np.zeros((height, 1 + 2 * width), dtype=np.uint8)  # before each row its filter: none
    rows[:, 1:] = millimetres.astype(">u2").view(np.uint8).reshape(height, 2 * width)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 1)), (b"IEND", b""))
    return PNG_START + b"".join(_png_part(kind, body) for kind, body in parts)


def _png_part(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
