"""The printed AprilGrid of the simulator: its geometry, its print, and the wall behind it.

Board frame: origin at the lower left corner of tag 0, x along the row of tags, y up the columns, z out of the print,
towards the camera. Tags count from the lower left by rows, as kalibr's; each has a black border two bits wide and
stands on its head, so that its corners follow each other as kalibr's do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from robot.simulation.renderer import Float32Array
from robot.simulation.texture_strokes import ImageArray
from shared.geometry import FloatArray, se3, so3_exp

TAGS = 6  # along each side of the boards that are drawn here
BORDER_BITS = 2
BLACK, WHITE = 24, 222  # printed, in a well-lit room
NUM_LEVELS = 6  # of half the size each
TAG_TEXELS, GAP_TEXELS = 120, 36  # on the finest level: twelve for each of a tag's ten cells
MARGIN_TEXELS = 2 * GAP_TEXELS  # white around the grid
SPACING = GAP_TEXELS / TAG_TEXELS  # gap between tags as a share of their side, as kalibr's boards have it


@dataclass(frozen=True)
class Board:
    """An AprilGrid of `columns` x `rows` tags of side `tag_m`."""

    columns: int
    rows: int
    tag_m: float
    bend_m: float = 0.0  # how far the middle stands out from the line between left and right edge

    @property
    def gap_m(self) -> float:
        return SPACING * self.tag_m

    @property
    def width_m(self) -> float:
        return self.columns * self.tag_m + (self.columns - 1) * self.gap_m

    @property
    def height_m(self) -> float:
        return self.rows * self.tag_m + (self.rows - 1) * self.gap_m

    @property
    def margin_m(self) -> float:
        """White paper around the grid."""
        return self.tag_m * MARGIN_TEXELS / TAG_TEXELS

    @property
    def centre(self) -> FloatArray:
        """(3,) m."""
        return np.array([self.width_m / 2, self.height_m / 2, 0.0])

    def yaml(self) -> str:
        """kalibr's target.yaml."""
        return (
            f"target_type: 'aprilgrid'\ntagCols: {self.columns}\ntagRows: {self.rows}\n"
            f"tagSize: {self.tag_m:.9g}  # m, side of a tag's black square\n"
            f"tagSpacing: {SPACING:.9g}  # gap between tags as a share of tagSize\n"
        )

    @cached_property
    def print(self) -> Print:
        return Print(self)


# The camera sees the board as it is printed: x to the right, y up, z towards the camera.
R_CAM_BOARD_FACING = np.diag([1.0, -1.0, -1.0])


def board_ahead(
    board: Board, distance_m: float, aside_m: tuple[float, float] = (0.0, 0.0), turned_rad: FloatArray | None = None
) -> FloatArray:
    """T_cam_board (4, 4) of a board whose centre is `distance_m` ahead and `aside_m` to the right and below.

    `turned_rad` (3,) is how it is turned in front of the camera, a rotation vector in camera axes.
    """
    R = R_CAM_BOARD_FACING if turned_rad is None else so3_exp(turned_rad) @ R_CAM_BOARD_FACING
    return se3(R, np.array([*aside_m, distance_m]) - R @ board.centre)


class Print:
    """Grey pictures of the board and the wall around it, each level of half the size of the one before."""

    def __init__(self, board: Board) -> None:
        sheet = _draw_grid(board.columns, board.rows, TAG_TEXELS, GAP_TEXELS)
        height, width = sheet.shape
        wall = _draw_wall(3 * height, 3 * width)
        wall[height : 2 * height, width : 2 * width] = sheet
        self._texel_m = board.tag_m / TAG_TEXELS
        # Edges of the texels where x and y are 0: lower left corner of tag 0, inside the white margin.
        self._origin = np.array([width + MARGIN_TEXELS, 2 * height - MARGIN_TEXELS])
        self._levels = [wall]
        for _ in range(NUM_LEVELS - 1):
            last = self._levels[-1]
            half = (last.shape[1] // 2, last.shape[0] // 2)
            self._levels.append(
                np.asarray(cv2.resize(last[: 2 * half[1], : 2 * half[0]], half, interpolation=cv2.INTER_AREA))
            )

    def level_for(self, footprint_m: float) -> int:
        """The level whose texels are about as large as a length on the board."""
        return int(np.clip(np.rint(np.log2(footprint_m / self._texel_m)), 0, NUM_LEVELS - 1))

    def look(self, x: Float32Array, y: Float32Array, level: int) -> ImageArray:
        """Grey values at places (h, w) m of the board's frame."""
        density = 1.0 / (self._texel_m * 2**level)
        # The centre of the first texel is (0, 0).
        u0, v0 = self._origin / 2**level - 0.5
        map_x, map_y = x * np.float32(density), y * np.float32(-density)
        map_x += np.float32(u0)
        map_y += np.float32(v0)
        return np.asarray(
            cv2.remap(self._levels[level], map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )


def _draw_grid(columns: int, rows: int, tag: int, gap: int) -> ImageArray:
    """The sheet of paper: tags, the black squares between their corners, a white margin."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    pitch, margin = tag + gap, MARGIN_TEXELS
    height, width = rows * pitch - gap + 2 * margin, columns * pitch - gap + 2 * margin
    sheet = np.full((height, width), WHITE, np.uint8)
    for number in range(columns * rows):
        row, column = divmod(number, columns)
        marker = cv2.aruco.generateImageMarker(dictionary, number, tag, borderBits=BORDER_BITS)
        top, left = height - margin - row * pitch - tag, margin + column * pitch
        sheet[top : top + tag, left : left + tag] = np.where(np.rot90(marker, 2) > 127, WHITE, BLACK)
    for row in range(rows + 1):
        for column in range(columns + 1):
            top, left = height - margin - row * pitch, margin + column * pitch - gap
            sheet[top : top + gap, left : left + gap] = BLACK
    return sheet


def _draw_wall(height: int, width: int) -> ImageArray:
    """Painted plaster with a few soft shades, the same for every board."""
    rng = np.random.default_rng(20)
    coarse = rng.uniform(95, 165, (9, 9)).astype(np.float32)
    wall = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grain = cv2.resize(rng.standard_normal((height // 4, width // 4), dtype=np.float32), (width, height))
    return np.asarray(np.clip(wall + 3.0 * grain, 0, 255), dtype=np.uint8)
