"""Where a target is not found, one sentence says which board the images show instead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.calibration import CameraCalibration
from station.calibration.camera import Rejected
from station.calibration.target import Target, TargetKind
from station.calibration.target_page import page_target
from station.calibration.views import NO_BOARD, Views, other_board
from tests.support.target_images import T_cam_board, photograph, printed_page

CAMERA = CameraCalibration(
    width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0, distortion=(0.0, 0.0, 0.0, 0.0)
)


def missed(shown: Target, count: int, looked_at: int) -> Views:
    """So many images of a target in which another one was looked for."""
    page = printed_page(shown)
    tilts = np.random.default_rng(1).uniform(-0.4, 0.4, (count, 3))
    images = tuple(photograph(page, CAMERA, T_cam_board(shown, tilt, 0.42)) for tilt in tilts)
    rejected = tuple(Rejected(f"{i}.jpg", "no board", NO_BOARD) for i in range(count))
    return Views((), (640, 480), rejected, looked_at, images)


@pytest.mark.parametrize(
    ("shown", "more_columns", "more_rows", "sentence"),
    [
        ("chessboard", 1, 1, "6 x 9 inner corners (the file has to count those, not the squares), target.yaml"),
        ("chessboard", 0, -1, "they show a chessboard of 6 x 9 inner corners, target.yaml describes"),
        ("charuco", 0, 0, "they show markers of DICT_4X4, target.yaml describes a chessboard"),
        ("aprilgrid", 0, 0, "they show an AprilGrid, target.yaml describes a chessboard"),
    ],
)
def test_another_board_is_named(shown: TargetKind, more_columns: int, more_rows: int, sentence: str) -> None:
    chessboard = page_target("chessboard", "A4")
    asked = replace(chessboard, columns=chessboard.columns + more_columns, rows=chessboard.rows + more_rows)
    assert sentence in other_board(asked, missed(page_target(shown, "A4"), 2, 3))


def test_a_few_images_without_the_board_are_not_held_against_it() -> None:
    asked = replace(page_target("chessboard", "A4"), rows=8)
    assert other_board(asked, missed(page_target("chessboard", "A4"), 2, 4)) == ""
