"""The painter of stickers that name rooms."""

from __future__ import annotations

import cv2
import numpy as np

from robot.simulation.texture_strokes import Canvas
from shared.room_sticker import CODE_SIDE_M, sticker_modules


def paint_sticker(canvas: Canvas) -> None:
    """White paper with the code, the name beneath."""
    canvas.fill((238, 242, 243))
    width, height = canvas.size_px
    modules = sticker_modules(canvas.text)
    side = round(CODE_SIDE_M * canvas.texels_per_m)
    rim = (width - side) // 2
    grey = np.where(modules, 28, 240).astype(np.uint8)
    code = cv2.resize(grey, (side, side), interpolation=cv2.INTER_NEAREST)
    canvas.image[rim : rim + side, rim : rim + side] = code[:, :, None]
    scale = min(1.0, 0.8 * width / max(1, cv2.getTextSize(canvas.text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 3)[0][0]))
    text_width = cv2.getTextSize(canvas.text, cv2.FONT_HERSHEY_SIMPLEX, scale, 3)[0][0]
    at = ((width - text_width) // 2, (height + rim + side) // 2)
    cv2.putText(canvas.image, canvas.text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (30, 30, 30), 3, cv2.LINE_AA)
