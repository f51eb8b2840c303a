"""Boards are found in images of the pages that are printed, and in real ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shared.calibration import CameraCalibration
from shared.errors import ConfigError, DataError
from shared.geometry import FloatArray
from station.calibration.boards import make_finder, view_board
from station.calibration.dictionaries import charuco_board
from station.calibration.target import Target, TargetKind
from station.calibration.target_file import read_target
from station.calibration.target_page import page_target
from station.vision.lens import Lens
from tests.support.paths import RECORDINGS
from tests.support.target_images import T_cam_board, photograph, printed_page, trimmed

CAMERA = CameraCalibration(
    width=752, height=480, fx=460.0, fy=458.0, cx=367.0, cy=248.0, distortion=(-0.28, 0.07, 2e-4, 0.0)
)
KINDS: tuple[TargetKind, ...] = ("aprilgrid", "charuco", "chessboard")


TELE = CameraCalibration(width=640, height=480, fx=600.0, fy=600.0, cx=322.0, cy=238.0, distortion=(0.05, 0, 0, 0))
WIDE = CameraCalibration(width=640, height=480, fx=310.0, fy=310.0, cx=322.0, cy=238.0, distortion=(-0.31, 0.09, 0, 0))


def true_corners(target: Target, T: FloatArray, camera: CameraCalibration = CAMERA) -> FloatArray:
    p_cam = target.corners @ T[:3, :3].T + T[:3, 3]
    return Lens(camera).project(p_cam[:, :2] / p_cam[:, 2:])


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_board_is_found_to_a_tenth_of_a_pixel(kind: TargetKind) -> None:
    target = page_target(kind, "A4")
    page = printed_page(target)
    T = T_cam_board(target, np.array([0.3, -0.25, 0.1]), 0.33)
    view = view_board(make_finder(target), target, photograph(page, CAMERA, T), "a", 7)
    assert view is not None
    assert len(view.ids) > 0.95 * len(target.corners)
    error = np.linalg.norm(view.corners_px - true_corners(target, T)[view.ids], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.1 and error.max() < 0.5
    assert view.blur_px == pytest.approx(0.9, abs=0.35)


def test_a_chessboard_upside_down_keeps_its_first_corner() -> None:
    target = page_target("chessboard", "A4")
    T = T_cam_board(target, np.array([0.0, 0.0, np.pi - 0.2]), 0.33)
    view = view_board(make_finder(target), target, photograph(printed_page(target), CAMERA, T), "a", 7)
    assert view is not None
    assert np.linalg.norm(view.corners_px - true_corners(target, T)[view.ids], axis=1).max() < 0.5


def test_of_a_chessboard_at_the_images_edge_a_part_is_found_whose_place_is_not_sure() -> None:
    target = page_target("chessboard", "A4")
    T = T_cam_board(target, np.array([0.2, -0.2, 0.0]), 0.3, shift=(-0.8, 0.0))
    view = view_board(make_finder(target), target, photograph(printed_page(target), CAMERA, T), "a", 0)
    assert view is not None and not view.ids_are_sure and 12 <= len(view.ids) < len(target.corners)
    truth = true_corners(target, T)
    nearest = np.linalg.norm(view.corners_px[:, None] - truth, axis=2).min(axis=1)
    assert nearest.max() < 0.5
    # The part is one of the board: neighbours in it are neighbours on the board.
    found = np.linalg.norm(view.corners_px[:, None] - truth, axis=2).argmin(axis=1)
    steps = np.diff(np.stack(np.divmod(found, target.columns)), axis=1)[:, np.diff(view.ids) == 1]
    assert (np.abs(steps).sum(axis=0) == 1).all()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_bright_chessboard_before_a_dark_room_is_found_though_it_is_tilted_far(axis: int) -> None:
    target = page_target("chessboard", "A4")
    T = T_cam_board(target, 1.2 * np.eye(3)[axis], 0.4)
    image = photograph(printed_page(target), TELE, T, wall=5)
    view = view_board(make_finder(target), target, image, "a", 7)
    assert view is not None and view.ids_are_sure
    assert np.linalg.norm(view.corners_px - true_corners(target, T, TELE)[view.ids], axis=1).max() < 0.5


def test_of_a_chessboard_without_a_border_no_row_is_left_out() -> None:
    """OpenCV gives a part of this one in which rows are two and three squares apart."""
    target = page_target("chessboard", "A4")
    T = T_cam_board(target, np.array([0.74, -0.19, -0.91]), 0.257, shift=(-0.0154, -0.3253))
    image = photograph(trimmed(printed_page(target), target), WIDE, T, seed=6)
    view = view_board(make_finder(target), target, image, "a", 7)
    if view is not None:
        truth = true_corners(target, T, WIDE)
        found = np.linalg.norm(view.corners_px[:, None] - truth, axis=2).argmin(axis=1)
        at = {int(i): np.array(divmod(int(j), target.columns)) for i, j in zip(view.ids, found, strict=True)}
        below = [np.abs(at[i + target.columns] - at[i]).sum() for i in at if i + target.columns in at]
        assert below and set(below) == {1}


@pytest.mark.parametrize("is_legacy", [False, True])
def test_a_charuco_board_of_an_even_number_of_rows_is_found_however_it_was_printed(is_legacy: bool) -> None:
    target = Target("charuco", 6, 5, 0.03, marker_m=0.022, dictionary="DICT_6X6_250")
    image = charuco_board(target, is_legacy).generateImage((490, 420), marginSize=30)
    view = view_board(make_finder(target), target, cv2.GaussianBlur(image, (0, 0), 1.0), "a", 7)
    assert view is not None and view.ids.tolist() == list(range(30))
    side = np.diff(view.corners_px[:2, 0])
    steps = target.corners[view.ids, :2] / target.square_m * side
    assert np.abs(view.corners_px - view.corners_px[0] - steps).max() < 0.5


@pytest.mark.parametrize("kind", ["aprilgrid", "charuco"])
def test_of_a_board_at_the_images_edge_the_visible_part_is_found_with_its_ids(kind: TargetKind) -> None:
    target = page_target(kind, "A4")
    T = T_cam_board(target, np.array([0.2, -0.2, 0.0]), 0.3, shift=(-0.9, 0.2))
    view = view_board(make_finder(target), target, photograph(printed_page(target), CAMERA, T), "a", 0)
    truth = true_corners(target, T)
    in_view = Lens(CAMERA).is_inside(truth, 8.0).sum()
    assert 0.3 * len(truth) < in_view < 0.8 * len(truth), "the test itself: a part is in view"
    assert view is not None and len(view.ids) > 0.5 * in_view
    error = np.linalg.norm(view.corners_px - truth[view.ids], axis=1)
    assert np.mean(error < 0.5) > 0.95  # the camera's fit leaves out what is left of wrong ones


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_found_where_there_is_no_board(kind: TargetKind) -> None:
    target = page_target(kind, "A4")
    noise = np.random.default_rng(0).integers(0, 255, (480, 752)).astype(np.uint8)
    for image in (np.full((480, 752), 90, np.uint8), cv2.GaussianBlur(noise, (0, 0), 3.0)):
        assert view_board(make_finder(target), target, image, "a", 0) is None


def test_a_board_before_a_blurred_lens_says_how_blurred_it_is() -> None:
    target = page_target("aprilgrid", "A4")
    T = T_cam_board(target, np.array([0.1, 0.2, 0.0]), 0.3)
    image = photograph(printed_page(target), CAMERA, T, blur_px=2.0)
    view = view_board(make_finder(target), target, image, "a", 0)
    assert view is not None and view.blur_px == pytest.approx(2.0, rel=0.25)


def test_euroc_images_show_nearly_all_of_the_grid() -> None:
    folder = RECORDINGS / "aprilgrid_euroc"
    if not folder.is_dir():
        pytest.skip("the recorded images are not on this machine")
    target = read_target(folder / "target.yaml")
    finder = make_finder(target)
    found = []
    for path in sorted(folder.glob("*.jpg")):
        view = view_board(finder, target, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), path.name, 0)
        found.append(0 if view is None else len(view.ids))
    assert min(found) >= 70 and np.median(found) >= 120


@pytest.mark.parametrize("marker_m", [0.0, 0.02, 0.03])
def test_a_charuco_board_whose_markers_fill_its_squares_is_refused(marker_m: float) -> None:
    with pytest.raises(ConfigError, match="not smaller than its square"):
        Target("charuco", 6, 9, 0.02, marker_m=marker_m)


def test_a_charuco_board_of_more_markers_than_its_dictionary_is_refused() -> None:
    with pytest.raises(DataError, match="too large for DICT_4X4_250"):
        charuco_board(Target("charuco", 50, 50, 0.02, marker_m=0.015))
