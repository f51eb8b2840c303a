"""Corners that a visual front end can follow, counted alike in every kind of world."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

MOST = 300  # are asked for
STRONG = (
    4e-4  # smaller eigenvalue of the gradients in 5x5 pixels, OpenCV's scale: nearly all of 300 in the real kitchen
)


def strong_corners(grey: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.float32], int]:
    """The corners (n, 1, 2) of an image, 12 pixels apart, and how many of them are strong."""
    found = cv2.goodFeaturesToTrack(grey, MOST, 0.01, 12)
    p = np.empty((0, 1, 2), np.float32) if found is None else np.asarray(found, np.float32)
    at = np.round(p[:, 0]).astype(int)
    return p, int((cv2.cornerMinEigenVal(grey, 5)[at[:, 1], at[:, 0]] >= STRONG).sum())
