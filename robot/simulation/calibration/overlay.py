"""A board that hangs in a simulated world, drawn into its pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robot.simulation.calibration.board import Board
from robot.simulation.calibration.board_camera import OFFSETS_PX, pass_level, rays_at, where_rays_meet
from robot.simulation.renderer import Float32Array, Rendering, poses_by_row
from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, inverse


@dataclass(frozen=True, slots=True, eq=False)
class HungBoard:
    """A board and where it hangs."""

    board: Board
    T_world_board: FloatArray  # (4, 4)


class BoardOverlay:
    """Draws boards into the pictures of one camera, at every row's own pose."""

    def __init__(self, camera: CameraCalibration) -> None:
        self._camera = camera
        self._board: Board | None = None  # with its print, which takes a moment to draw

    @cached_property
    def _rays(self) -> list[Float32Array]:
        """Through the pixels' centres, and at each offset. Most cameras never see a board, and this takes a moment."""
        return [rays_at(self._camera, offset) for offset in ((0.0, 0.0), *OFFSETS_PX)]

    def draw(self, hung: HungBoard, rendering: Rendering, T_world_cam_rows: FloatArray) -> None:
        """Paint the sheet over image and depth where it is nearer than what is there; poses as `Renderer.render`'s."""
        if self._board != hung.board:
            self._board = hung.board
        T_board_cam = inverse(hung.T_world_board) @ T_world_cam_rows
        R, t = poses_by_row(T_board_cam, self._camera.height)
        if t[len(t) // 2, 2] <= 0:
            return  # seen from behind
        x, y, depth = where_rays_meet(self._board, self._rays[0], R, t)
        margin, board = self._board.margin_m, self._board
        is_sheet = (depth > 0) & (depth * rendering.inverse_depth < 1.0)
        is_sheet &= np.abs(x - board.width_m / 2) < board.width_m / 2 + margin
        is_sheet &= np.abs(y - board.height_m / 2) < board.height_m / 2 + margin
        rows, columns = np.nonzero(is_sheet.any(axis=1))[0], np.nonzero(is_sheet.any(axis=0))[0]
        if not len(rows):
            return
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        level = pass_level(board, self._camera, T_board_cam[len(T_board_cam) // 2])
        grey = np.zeros(is_sheet[part].shape, np.float32)
        for rays in self._rays[1:]:
            px, py, _ = where_rays_meet(board, rays[part[0], :, part[1]], R[part[0]], t[part[0]])
            grey += board.print.look(px, py, level)
        seen = is_sheet[part]
        rendering.image[part][seen] = np.rint(grey / len(OFFSETS_PX)).astype(np.uint8)[seen][:, None]
        rendering.inverse_depth[part][seen] = 1.0 / depth[part][seen]
