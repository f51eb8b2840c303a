"""Image files as a robot's camera would send them: JPEG. JPEGs pass untouched, PNGs are encoded anew."""

from __future__ import annotations

from pathlib import Path

from shared.advice import install
from shared.errors import DataError, DeviceUnavailable
from shared.pictures import JPEG_START, picture_size

JPEG_QUALITY = 95  # next to no loss: a recorded PNG should look to SLAM as it did on disk


def read_size(encoded: bytes, path: Path) -> tuple[int, int]:
    """(width, height) in pixels from the file's header. Raises DataError where it is not a picture to be decoded."""
    try:
        return picture_size(encoded)
    except ValueError as exc:
        raise DataError(f"image {path} {exc}; remove it or copy it again") from exc


def to_jpeg(encoded: bytes, path: Path) -> bytes:
    """The image as JPEG. Raises DataError where it cannot be decoded."""
    read_size(encoded, path)
    if encoded.startswith(JPEG_START):
        return encoded
    try:
        import cv2
        import numpy as np
    except ImportError as exc:
        raise DeviceUnavailable(
            f"PNG frames are sent as JPEG, which needs OpenCV; run: {install('simulation')}"
        ) from exc
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DataError(f"image {path} is not a readable JPEG or PNG; remove it or copy it again")
    if image.dtype == np.uint16:  # JPEG has 8 bits: without this everything above 255 would be white
        image = (image // 256).astype(np.uint8)
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(jpeg)
