"""Exact pictures of a flat board: every row at its own time, every exposure smeared along the true motion.

A picture is the mean of several passes. Each pass takes every pixel's ray (lens distortion undone) at one sub-pixel
offset and one instant of the exposure, turned by the camera's pose at the row's time, and looks up where the ray hits
the board: four offsets a pixel hold aliasing off, the instants make the motion blur.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from robot.simulation.calibration.board import Board
from robot.simulation.renderer import Float32Array, undistort
from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, inverse, transform

# Where in a pixel the passes look: a square turned so that neither rows nor columns fall together. Before and after the
# middle of the exposure they look at opposite places: else motion shifts all corners to one side.
OFFSETS_PX = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))
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
        self._rays = [rays_at(camera, offset) for offset in OFFSETS_PX]
        self._field = _light_field(camera, optics, rng)

    def expose(self, pose: PoseAt, t_s: float) -> bytes:
        """A JPEG; t_s is the middle of the first row's exposure."""
        camera, optics = self._camera, self._optics
        passes = self._passes(pose, t_s)
        instants = ((np.arange(passes) + 0.5) / passes - 0.5) * optics.exposure_s
        row_times = t_s + camera.line_delay_s * np.arange(camera.height)
        poses = pose((instants[:, None] + row_times).ravel()).reshape(passes, camera.height, 4, 4)
        level = pass_level(self._board, camera, poses[0, camera.height // 2])
        total = np.zeros((camera.height, camera.width), np.float32)
        for number in range(passes):
            rays = self._rays[number % len(self._rays)]
            x, y, _ = where_rays_meet(self._board, rays, poses[number, :, :3, :3], poses[number, :, :3, 3])
            cv2.accumulate(self._board.print.look(x, y, level), total)
        return self._develop(total / np.float32(passes))

    def _passes(self, pose: PoseAt, t_s: float) -> int:
        """As many as the motion blur needs, a multiple of the offsets; one where no part of the board is in view."""
        half = self._optics.exposure_s / 2
        first, last = inverse(pose(np.array([t_s - half, t_s + half])))
        size = np.array([self._board.width_m, self._board.height_m])
        corners = np.column_stack([np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size, np.zeros(4)])
        moved = [transform(T, corners) for T in (first, last)]
        if max(p[:, 2].max() for p in moved) <= 0.0:
            return 1  # behind the camera
        pixels = [self._camera.fx * p[:, :2] / np.maximum(p[:, 2:], 0.05) for p in moved]
        blur_px = float(np.linalg.norm(pixels[1] - pixels[0], axis=1).max())
        rounds = int(np.ceil(max(1.0, blur_px / PX_PER_PASS) / len(OFFSETS_PX)))
        return min(rounds * len(OFFSETS_PX), MAX_PASSES)

    def _develop(self, light: Float32Array) -> bytes:
        """Lens blur, lamps, noise, JPEG."""
        if self._optics.lens_blur_px > 0:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), self._optics.lens_blur_px))
        noise = self._optics.noise * self._rng.standard_normal(light.shape, dtype=np.float32)
        signal = light * self._field
        deviation = signal / np.float32(200.0)
        deviation += np.float32(0.5)
        noise *= np.sqrt(deviation, out=deviation)  # shot noise grows with the light, read noise does not
        signal += noise
        image = np.clip(np.rint(signal, out=signal), 0, 255, out=signal).astype(np.uint8)
        ok, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])
        assert ok
        return encoded.tobytes()


@lru_cache(maxsize=len(OFFSETS_PX) + 1)  # all of one camera: half a second of each recording of a board
def rays_at(camera: CameraCalibration, offset_px: tuple[float, float]) -> Float32Array:
    """Rays (H, 3, W) through the pixels' centres shifted by the offset, z = 1, lens distortion undone."""
    u, v = np.meshgrid(np.arange(camera.width) + offset_px[0], np.arange(camera.height) + offset_px[1])
    xy = undistort(camera, np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1))
    rays = np.ones((camera.height, 3, camera.width), np.float32)
    rays[:, 0], rays[:, 1] = xy[..., 0], xy[..., 1]
    rays.setflags(write=False)  # all who ask share it
    return rays


def pass_level(board: Board, camera: CameraCalibration, T_board_cam: FloatArray) -> int:
    """The level of the print for one of several passes, whose rays meet the board half a pixel apart."""
    distance = float(np.linalg.norm(T_board_cam[:3, 3] - board.centre))
    return board.print.level_for(0.5 * distance / camera.fx)


def where_rays_meet(
    board: Board, rays: Float32Array, R_board_cam: FloatArray, t_board_cam: FloatArray
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Where on the board's surface rays (h, 3, w) from cameras (h, 3, 3), (h, 3), one a row, arrive.

    Returns x and y in the board's frame and the depth along the optical axis, each (h, w) m; behind the camera the
    depth is negative. A ray along the board gets there nowhere: values that are not finite.
    """
    directions = np.matmul(R_board_cam.astype(np.float32), rays)
    origin = t_board_cam.astype(np.float32)[:, :, None]
    dx, dy, dz = directions[:, 0], directions[:, 1], directions[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = -origin[:, 2] / dz
        x = depth * dx
        x += origin[:, 0]
        if board.bend_m:
            for _ in range(BEND_ROUNDS):
                depth = _height(board, x)
                depth -= origin[:, 2]
                depth /= dz
                np.multiply(depth, dx, out=x)
                x += origin[:, 0]
        y = np.multiply(depth, dy, out=dy)
        y += origin[:, 1]
        return x, y, depth


def _height(board: Board, x: Float32Array) -> Float32Array:
    """How far a bent board stands out at x: an arc from edge to edge, straight on beyond them."""
    share = np.clip(x / (board.width_m / 2) - 1.0, -1.0, 1.0)
    return np.asarray(board.bend_m * (1.0 - share * share), dtype=np.float32)


def _light_field(camera: CameraCalibration, optics: Optics, rng: np.random.Generator) -> Float32Array:
    """What the printed grey is multiplied with at each pixel (H, W): a lamp from one side, corners darker."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    x, y = u / camera.width - 0.5, v / camera.height - 0.5
    angle = rng.uniform(0, 2 * np.pi)
    shade = 1.0 + optics.gradient * (np.cos(angle) * x + np.sin(angle) * y)
    return np.asarray(optics.light * shade * (1.0 - 0.3 * (x * x + y * y)), dtype=np.float32)
