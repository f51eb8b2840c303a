"""Exact pictures of a flat board: every row at its own time, every exposure smeared along the true motion.

A picture is the mean of several passes. Each pass takes every pixel's ray (lens distortion undone) at one sub-pixel
offset and one instant of the exposure, turned by the camera's pose at the row's time, and looks up where the ray hits
the board: four offsets a pixel hold aliasing off, the instants make the motion blur.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from robot.simulation.calibration.board import Board
from robot.simulation.renderer import Float32Array, undistort
from robot.simulation.texture_strokes import ImageArray
from shared.calibration import CameraCalibration
from shared.geometry import FloatArray

# Where in a pixel the passes look: a square turned so that neither rows nor columns fall together.
OFFSETS_PX = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
PX_PER_PASS = 1.0  # of motion blur
MAX_PASSES = 16
BEND_ROUNDS = 3

PoseAt = Callable[[FloatArray], FloatArray]  # times (N,) s to T_board_cam (N, 4, 4)


@dataclass(frozen=True, slots=True)
class Optics:
    """What light, lens and sensor do to a picture."""

    exposure_s: float = 0.005
    light: float = 0.9  # grey levels per printed grey level
    gradient: float = 0.25  # how much darker one side of the image is
    lens_blur_px: float = 0.55
    noise: float = 1.8  # grey levels


class BoardCamera:
    """Takes pictures of one board."""

    def __init__(self, board: Board, camera: CameraCalibration, optics: Optics, rng: np.random.Generator) -> None:
        self._board, self._camera, self._optics, self._rng = board, camera, optics, rng
        self._rays = [_rays(camera, offset) for offset in OFFSETS_PX]
        self._field = _light_field(camera, optics, rng)

    def expose(self, pose: PoseAt, t_s: float) -> bytes:
        """A JPEG; t_s is the middle of the first row's exposure."""
        camera, optics = self._camera, self._optics
        passes = self._passes(pose, t_s)
        instants = ((np.arange(passes) + 0.5) / passes - 0.5) * optics.exposure_s
        row_times = t_s + camera.line_delay_s * np.arange(camera.height)
        poses = pose((instants[:, None] + row_times).ravel()).reshape(passes, camera.height, 4, 4)
        level = self._board.print.level_for(self._footprint_m(poses[0, camera.height // 2]))
        total = np.zeros((camera.height, camera.width), np.float32)
        for number in range(passes):
            rays = self._rays[number % len(self._rays)]
            cv2.accumulate(self._look(rays, poses[number], level), total)
        return self._develop(total / np.float32(passes))

    def _passes(self, pose: PoseAt, t_s: float) -> int:
        """As many as the motion blur needs, a multiple of the offsets."""
        half = self._optics.exposure_s / 2
        first, last = np.linalg.inv(pose(np.array([t_s - half, t_s + half])))
        size = np.array([self._board.width_m, self._board.height_m])
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size
        moved = [(T[:3, :2] @ corners.T + T[:3, 3:]).T for T in (first, last)]
        pixels = [self._camera.fx * p[:, :2] / np.maximum(p[:, 2:], 0.05) for p in moved]
        blur_px = float(np.linalg.norm(pixels[1] - pixels[0], axis=1).max())
        rounds = int(np.ceil(max(1.0, blur_px / PX_PER_PASS) / len(OFFSETS_PX)))
        return min(rounds * len(OFFSETS_PX), MAX_PASSES)

    def _footprint_m(self, T_board_cam: FloatArray) -> float:
        """The distance of two passes' rays on the board, where it stands across the view."""
        distance = float(np.linalg.norm(T_board_cam[:3, 3] - self._board.centre))
        return 0.5 * distance / self._camera.fx

    def _look(self, rays: Float32Array, T_board_cam: FloatArray, level: int) -> ImageArray:
        """What the rays (H, 3, W) meet: grey values (H, W)."""
        directions = np.matmul(T_board_cam[:, :3, :3].astype(np.float32), rays)
        origin = T_board_cam[:, :3, 3].astype(np.float32)[:, :, None]
        dx, dy, dz = directions[:, 0], directions[:, 1], directions[:, 2]
        reach = -origin[:, 2] / dz
        x = origin[:, 0] + reach * dx
        if self._board.bend_m:
            for _ in range(BEND_ROUNDS):
                reach = (self._height(x) - origin[:, 2]) / dz
                x = origin[:, 0] + reach * dx
        y = origin[:, 1] + reach * dy
        scale, offset = self._board.print.texel_map(level)
        map_x = x * np.float32(scale[0]) + np.float32(offset[0])
        map_y = y * np.float32(scale[1]) + np.float32(offset[1])
        picture = self._board.print.levels[level]
        return np.asarray(cv2.remap(picture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _height(self, x: Float32Array) -> Float32Array:
        """How far the bent board stands out at x: an arc from edge to edge, straight on beyond them."""
        half = self._board.width_m / 2
        share = np.clip(x / half - 1.0, -1.0, 1.0)
        return np.asarray(self._board.bend_m * (1.0 - share * share), dtype=np.float32)

    def _develop(self, light: Float32Array) -> bytes:
        """Lens blur, lamps, noise, JPEG."""
        if self._optics.lens_blur_px > 0:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), self._optics.lens_blur_px))
        noise = self._optics.noise * self._rng.standard_normal(light.shape, dtype=np.float32)
        signal = light * self._field
        noise *= np.sqrt(0.5 + signal / 200.0)  # shot noise grows with the light, read noise does not
        image = np.clip(np.rint(signal + noise), 0, 255).astype(np.uint8)
        ok, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])
        assert ok
        return encoded.tobytes()


def _rays(camera: CameraCalibration, offset_px: tuple[float, float]) -> Float32Array:
    """Rays (H, 3, W) through the pixels' centres shifted by the offset, z = 1, lens distortion undone."""
    u, v = np.meshgrid(np.arange(camera.width) + offset_px[0], np.arange(camera.height) + offset_px[1])
    xy = undistort(camera, np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1))
    rays = np.ones((camera.height, 3, camera.width), np.float32)
    rays[:, 0], rays[:, 1] = xy[..., 0], xy[..., 1]
    return rays


def _light_field(camera: CameraCalibration, optics: Optics, rng: np.random.Generator) -> Float32Array:
    """What the printed grey is multiplied with at each pixel (H, W): a lamp from one side, corners darker."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    x, y = u / camera.width - 0.5, v / camera.height - 0.5
    angle = rng.uniform(0, 2 * np.pi)
    shade = 1.0 + optics.gradient * (np.cos(angle) * x + np.sin(angle) * y)
    return np.asarray(optics.light * shade * (1.0 - 0.3 * (x * x + y * y)), dtype=np.float32)
