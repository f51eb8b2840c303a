"""The printed codes of targets, as OpenCV names them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from shared.errors import DataError
from station.calibration.target import Target
from station.model.frames import ImageArray

APRIL_DICTIONARY = "DICT_APRILTAG_36h11"
APRIL_BORDER_BITS = 2  # of kalibr's grid; an AprilTag by itself has one
APRIL_BITS = 6  # a side, without the border
DEFAULT_CHARUCO_DICTIONARY = "DICT_4X4_250"
LEAST_MARKERS = 4  # different ones, of which noise and writing show one now and then
CHARUCO_DICTIONARIES = (
    *(f"DICT_{side}X{side}_{count}" for side in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    APRIL_DICTIONARY,
)


def april_dictionary() -> Any:
    """OpenCV's dictionary of AprilTag 36h11."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, APRIL_DICTIONARY))


def charuco_board(target: Target, is_legacy: bool = False) -> Any:
    """OpenCV's board of a ChArUco target. Its corners have the ids of Target.corners.

    Args:
        is_legacy: black and white changed over, as OpenCV before 4.6 and others print an even number of rows.

    Raises DataError: it has more markers than its dictionary.
    """
    name = target.dictionary or DEFAULT_CHARUCO_DICTIONARY
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    size = (target.columns + 1, target.rows + 1)
    markers = size[0] * size[1] // 2
    if markers > len(dictionary.bytesList):
        raise DataError(f"a board of {markers} markers is too large for {name}, which has {len(dictionary.bytesList)}")
    board = cv2.aruco.CharucoBoard(size, target.square_m, target.marker_m, dictionary)
    board.setLegacyPattern(is_legacy)
    return board


def charuco_markers(image: ImageArray) -> str:
    """The kind of markers that an image shows, as "DICT_6X6"; empty where fewer than LEAST_MARKERS of one are seen."""
    for side in (4, 5, 6, 7):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{side}X{side}_250"))
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)
        if len(np.unique(() if ids is None else ids)) >= LEAST_MARKERS:
            return f"DICT_{side}X{side}"
    return ""
