"""Images of a printed target: the page itself, drawn, and seen by a camera whose numbers are known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, se3
from station.calibration.target import Target
from station.calibration.target_page import PAGE_MM, PageSize, draw_page
from station.vision.lens import Lens

Image = npt.NDArray[np.uint8]
PIXELS_PER_MM = 8
WALL = 150  # grey level around the page


@dataclass(frozen=True)
class Page:
    """A page as the printer leaves it."""

    image: Image  # (H, W), PIXELS_PER_MM
    H_page_board: FloatArray  # (3, 3), from the board's coordinates (m) to the page's pixels


def printed_page(target: Target, size: PageSize = "A4") -> Page:
    """The page that `station calibrate target` writes, with where the board lies on it."""
    figure = draw_page(target, size)
    figure.set_dpi(25.4 * PIXELS_PER_MM)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[..., 0].copy()
    return Page(image, _board_on_page(target, size, len(image)))


def trimmed(page: Page, target: Target) -> Page:
    """The page of a chessboard with its white border cut off."""
    outer = np.array([[-1, -1], [target.columns, target.rows]]) * target.square_m
    (left, top), (right, bottom) = np.rint(cv2.perspectiveTransform(outer[None], page.H_page_board)[0]).astype(int)
    image = np.full_like(page.image, WALL)
    image[top:bottom, left:right] = page.image[top:bottom, left:right]
    return Page(image, page.H_page_board)


def _board_on_page(target: Target, size: PageSize, height_px: int) -> FloatArray:
    """Independent of how the page is drawn, but for the margins: the board stands in the middle over the ruler."""
    width_mm, height_mm = PAGE_MM[size]
    square, gap = 1e3 * target.square_m, 1e3 * target.gap_m
    s = PIXELS_PER_MM
    if target.kind == "aprilgrid":
        width, height = (n * (square + gap) + gap for n in (target.columns, target.rows))
        x0, y0 = (width_mm - width) / 2 + gap, 14.0 + (height_mm - 14.0 - height) / 2 + gap
        return np.array([[1e3 * s, 0, s * x0 - 0.5], [0, -1e3 * s, height_px - s * y0 - 0.5], [0, 0, 1]])
    width, height = (square * (n + 1) for n in (target.columns, target.rows))
    x0, y0 = (width_mm - width) / 2 + square, 14.0 + (height_mm - 14.0 - height) / 2 + height - square
    return np.array([[1e3 * s, 0, s * x0 - 0.5], [0, 1e3 * s, height_px - s * y0 - 0.5], [0, 0, 1]])


def photograph(
    page: Page,
    camera: CameraCalibration,
    T_cam_board: FloatArray,
    blur_px: float = 0.7,
    noise: float = 2.0,
    seed: int = 0,
    wall: int = WALL,
) -> Image:
    """The page on a grey wall through the camera's lens."""
    v, u = np.mgrid[: 2 * camera.height, : 2 * camera.width]  # two samples a pixel in each direction
    uv = (np.stack([u, v], axis=-1) + 0.5) / 2 - 0.5
    rays = Lens(camera).unproject(uv)
    H_cam_board = np.column_stack([T_cam_board[:3, :2], T_cam_board[:3, 3]])
    H = page.H_page_board @ np.linalg.inv(H_cam_board)
    at = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2) @ H.T
    xy = (at[..., :2] / at[..., 2:]).astype(np.float32)
    fine = cv2.GaussianBlur(page.image, (0, 0), 0.8)
    seen = cv2.remap(fine, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=wall)
    seen[at[..., 2] * np.sign(at[camera.height, camera.width, 2]) <= 0] = wall
    small = cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA).astype(np.float64)
    blurred = cv2.GaussianBlur(small, (0, 0), blur_px) if blur_px > 0 else small
    dim = 20.0 + 0.8 * blurred + np.random.default_rng(seed).normal(0.0, noise, blurred.shape)
    return np.clip(dim, 0, 255).astype(np.uint8)


def T_cam_board(
    target: Target, tilt: FloatArray, distance_m: float, shift: tuple[float, float] = (0.0, 0.0)
) -> FloatArray:
    """A board that faces the camera, turned by a rotation vector about its own middle, and shifted in the view.

    shift: of the board's middle off the optical axis, in distances.
    """
    facing = np.diag([1.0, -1.0, -1.0]) if target.kind == "aprilgrid" else np.eye(3)
    R = cv2.Rodrigues(np.asarray(tilt, dtype=np.float64))[0] @ facing
    middle = target.corners.mean(axis=0)
    return se3(R, distance_m * np.array([*shift, 1.0]) - R @ middle)
