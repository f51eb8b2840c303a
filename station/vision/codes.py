"""Codes on stickers (QR) in pictures, far or oblique as a robot sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from shared.geometry import FloatArray
from station.model.frames import ImageArray

if TYPE_CHECKING:
    import zxingcpp

ENLARGED_WIDTH_PX = 1920  # at three times VGA 119 of 120 codes of 2.5 px a module are read, as they are 83


@dataclass(frozen=True, slots=True, eq=False)
class SeenCode:
    """One code in one picture."""

    text: str
    corners_px: FloatArray  # (4, 2) of the code without its rim: top left, top right, bottom right, bottom left


def read_codes(grey: ImageArray) -> list[SeenCode]:
    """All QR codes of a picture (H, W)."""
    # Not kept for good by what workers are forked from: its binding calls that a leak, when the station ends.
    import zxingcpp

    scale = max(1, round(ENLARGED_WIDTH_PX / grey.shape[1]))
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    only_qr = zxingcpp.BarcodeFormats(zxingcpp.BarcodeFormat.QRCode)
    found = zxingcpp.read_barcodes(large, formats=only_qr, try_invert=False)
    return [SeenCode(code.text, _corners(code.position, scale)) for code in found]


def _corners(position: zxingcpp.Position, scale: int) -> FloatArray:
    """Pixel (0, 0) has its centre there at either size."""
    corners = (position.top_left, position.top_right, position.bottom_right, position.bottom_left)
    return (np.array([[p.x, p.y] for p in corners], dtype=np.float64) + 0.5) / scale - 0.5
