"""Where a picture shows the tags of an AprilGrid, and where it should."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from robot.simulation.texture_strokes import ImageArray
from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray

KALIBR_ORDER = [1, 0, 3, 2]  # OpenCV's corners of such a tag, in kalibr's order


def read_grey(image_file: Path) -> ImageArray:
    image = cv2.imread(str(image_file), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return np.asarray(image, dtype=np.uint8)


def detect_tags(image: ImageArray) -> tuple[IntArray, npt.NDArray[np.float32]]:
    """Ids (m,) of corners in Target.corners and where they are seen (m, 2) px."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found, tags, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if not found:
        return np.empty(0, np.int64), np.empty((0, 2), np.float32)
    corners = np.concatenate([tag[0][KALIBR_ORDER] for tag in found])
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    cv2.cornerSubPix(image, corners, (3, 3), (-1, -1), criteria)
    return np.asarray(4 * tags.reshape(-1, 1) + np.arange(4), dtype=np.int64).ravel(), corners


def project(camera: CameraCalibration, p_cam: FloatArray) -> FloatArray:
    """(n, 2) px."""
    lens, zero = np.array(camera.distortion), np.zeros(3)
    if camera.model == "radtan":
        px, _ = cv2.projectPoints(p_cam, zero, zero, camera.K, lens)
    else:
        px, _ = cv2.fisheye.projectPoints(p_cam[:, None], zero, zero, camera.K, lens)
    return np.asarray(px, dtype=np.float64).reshape(-1, 2)
