"""New corners, spread over the image: at most one per grid cell that has no track yet."""

from __future__ import annotations

import cv2
import numpy as np

from shared.geometry import FloatArray
from station.model.frames import ImageArray

SUBPIX_WINDOW = (4, 4)
SUBPIX_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.02)


def detect_corners(
    grey: ImageArray,
    existing_px: FloatArray,
    wanted: int,
    cell_px: int,
    min_response: float,
    border_px: int = 12,
) -> FloatArray:
    """The strongest Shi-Tomasi corner of each empty cell, best first, refined to sub-pixel.

    Responses are computed at half resolution: a sixth of the time, and the sub-pixel step restores the position.
    Args:
        existing_px: (N, 2) pixels of live tracks; cells within half a cell of one of them stay empty.
        wanted: at most that many corners.
        min_response: smallest eigenvalue that counts, in OpenCV's units on a grey image in [0, 1].
    Returns:
        (M, 2) pixels, M <= wanted.
    """
    if wanted <= 0:
        return np.zeros((0, 2))
    half = np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    response = np.asarray(cv2.cornerMinEigenVal(half, 3, ksize=3), dtype=np.float32)
    border = border_px // 2
    response[:border] = response[-border:] = 0.0
    response[:, :border] = response[:, -border:] = 0.0
    for u, v in np.rint(existing_px * 0.5 - 0.25).astype(int).tolist():
        cv2.circle(response, (u, v), cell_px // 4, 0.0, -1)

    cell = cell_px // 2
    rows, cols = half.shape[0] // cell, half.shape[1] // cell
    blocks = response[: rows * cell, : cols * cell].reshape(rows, cell, cols, cell)
    cells = blocks.swapaxes(1, 2).reshape(rows * cols, cell * cell)
    best = np.argmax(cells, axis=1)
    strength = cells[np.arange(rows * cols), best]
    row, col = np.divmod(np.arange(rows * cols), cols)
    corners = np.stack([col * cell + best % cell, row * cell + best // cell], axis=1).astype(np.float64)
    order = np.argsort(-strength, kind="stable")
    order = order[strength[order] > min_response]
    corners = _spread(corners[order], cell_px / 4.0, wanted)
    if not len(corners):
        return np.zeros((0, 2))
    start = (corners * 2.0 + 0.5).astype(np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(grey, start, SUBPIX_WINDOW, (-1, -1), SUBPIX_CRITERIA)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _spread(points: FloatArray, min_distance: float, wanted: int) -> FloatArray:
    """The first `wanted` of the points (N, 2), best first, that are no nearer than min_distance to a better one."""
    kept = np.empty((min(wanted, len(points)), 2))
    count = 0
    for point in points:
        off = kept[:count] - point
        if count and float((off * off).sum(axis=1).min()) < min_distance * min_distance:
            continue
        kept[count] = point
        count += 1
        if count == wanted:
            break
    return kept[:count]
