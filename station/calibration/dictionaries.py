"""The printed codes of targets, as OpenCV names them."""

from __future__ import annotations

from typing import Any

import cv2

from shared.errors import DataError
from station.calibration.target import Target

APRIL_DICTIONARY = "DICT_APRILTAG_36h11"
APRIL_BORDER_BITS = 2  # of kalibr's grid; an AprilTag by itself has one
APRIL_BITS = 6  # a side, without the border
DEFAULT_CHARUCO_DICTIONARY = "DICT_4X4_250"
CHARUCO_DICTIONARIES = (
    *(f"DICT_{side}X{side}_{count}" for side in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    APRIL_DICTIONARY,
)


def april_dictionary() -> Any:
    """OpenCV's dictionary of AprilTag 36h11."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, APRIL_DICTIONARY))


def charuco_board(target: Target) -> Any:
    """OpenCV's board of a ChArUco target. Its corners have the ids of Target.corners.

    Raises DataError: it has more markers than its dictionary.
    """
    name = target.dictionary or DEFAULT_CHARUCO_DICTIONARY
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    size = (target.columns + 1, target.rows + 1)
    markers = size[0] * size[1] // 2
    if markers > len(dictionary.bytesList):
        raise DataError(f"a board of {markers} markers is too large for {name}, which has {len(dictionary.bytesList)}")
    return cv2.aruco.CharucoBoard(size, target.square_m, target.marker_m, dictionary)
