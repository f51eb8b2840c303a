"""Whether the board that a camera saw is laid out as the target's file says, which no lens has to be known for."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from station.calibration.boards import edges, homography, surface_powers
from station.calibration.target import BoardView, Target

OTHER_BOARD = (
    "the board that is seen is not the one in target.yaml: its corners lie elsewhere (its columns, rows, tag family or"
    " kind differ); give the file of the board that was used"
)


def is_other_board(target: Target, views: Sequence[BoardView]) -> bool:
    """Whether the board that most of these views show has its fields in other places than the target."""
    others = sum(not fits_layout(target, view) for view in views)
    return 2 * others > len(views)


def fits_layout(target: Target, view: BoardView) -> bool:
    """Whether corners lie where the others say, nearer than half a field: than a field that was taken for another.

    That asks nothing of the lens: a flat board through any is a homography and a smooth rest. Tags whose columns are
    counted otherwise lie whole fields from there, those of bent boards and of other gaps a small part of one.
    """
    p_board = target.corners[view.ids, :2]
    H = homography(p_board, view.corners_px)
    if H is None:
        return False
    away = view.corners_px - cv2.perspectiveTransform(p_board[None], H)[0]
    A = surface_powers(p_board)
    if len(p_board) >= 2 * A.shape[1]:
        away = away - A @ np.linalg.lstsq(A, away, rcond=None)[0]
    where = np.full(len(target.corners), -1)
    where[view.ids] = np.arange(len(view.ids))
    begin, end = where[edges(target)].T
    seen = (begin >= 0) & (end >= 0)
    sides = np.linalg.norm(view.corners_px[begin[seen]] - view.corners_px[end[seen]], axis=1)
    return not seen.any() or float(np.median(np.linalg.norm(away, axis=1))) < 0.5 * float(np.median(sides))
