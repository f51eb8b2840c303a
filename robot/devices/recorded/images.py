"""Image files as a robot's camera would send them: JPEG. JPEGs pass untouched, PNGs are encoded anew."""

from __future__ import annotations

from pathlib import Path

from shared.advice import install
from shared.errors import DataError, DeviceUnavailable

JPEG_QUALITY = 95  # next to no loss: a recorded PNG should look to SLAM as it did on disk
JPEG_START = b"\xff\xd8"
PNG_START = b"\x89PNG\r\n\x1a\n"
# JPEG markers that start a frame header (ITU-T T.81, table B.1): SOF0-3, 5-7, 9-11, 13-15.
_SIZE_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_BARE_MARKERS = {0x01, *range(0xD0, 0xD9)}  # no length follows


def read_size(encoded: bytes, path: Path) -> tuple[int, int]:
    """(width, height) in pixels from the file's header. Raises DataError where it is neither JPEG nor PNG."""
    if encoded.startswith(PNG_START) and len(encoded) >= 24:
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
    raise DataError(f"image {path} is not a readable JPEG or PNG; remove it or copy it again")


def to_jpeg(encoded: bytes, path: Path) -> bytes:
    """The image as JPEG. Raises DataError where it cannot be decoded."""
    if encoded.startswith(JPEG_START):
        return encoded
    try:
        import cv2
        import numpy as np
    except ImportError as exc:
        raise DeviceUnavailable(
            f"PNG frames are sent as JPEG, which needs OpenCV; run: {install('simulation')}"
        ) from exc
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED) if encoded else None
    if image is None:
        raise DataError(f"image {path} is not a readable JPEG or PNG; remove it or copy it again")
    if image.dtype == np.uint16:  # JPEG has 8 bits: without this everything above 255 would be white
        image = (image // 256).astype(np.uint8)
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(jpeg)
