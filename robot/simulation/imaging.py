"""From an ideal rendering to what a small camera delivers: blur, exposure, vignetting, noise, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from robot.simulation.body import PoseFunction
from robot.simulation.calibration.overlay import BoardOverlay, HungBoard
from robot.simulation.config import CameraImperfections, Faults
from robot.simulation.renderer import NO_SURFACE, Float32Array, Renderer, Rendering
from robot.simulation.texture_strokes import ImageArray
from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, transform

TARGET_MEAN = 112.0
NOISE_SHIFT_PX = 211  # each frame takes another part of one noise picture
SHUTTER_POSES = 3  # poses along the readout; in between by Lagrange
FLOW_GRID_PX = 32


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    jpeg: bytes
    image: ImageArray  # (H, W, 3) BGR before JPEG
    exposure_s: float
    inverse_depth: Float32Array  # (H, W) 1/m of what is seen; valid until the next one


class SimulatedCamera:
    """A camera on a body: renders at a time, with its own auto-exposure and noise."""

    def __init__(
        self, renderer: Renderer, calibration: CameraCalibration, imperfections: CameraImperfections, seed: int
    ) -> None:
        self._renderer, self._calibration, self._imperfections = renderer, calibration, imperfections
        self._rng = np.random.default_rng([seed, 13])
        self._T_body_cam = calibration.T_body_cam_matrix
        self._brightness = 1.0  # what auto-exposure multiplies the scene with
        self._exposure_s = imperfections.exposure_ms * 1e-3
        self._gain = 1.0
        shape = (calibration.height + NOISE_SHIFT_PX, calibration.width + NOISE_SHIFT_PX, 3)
        self._noise_bank = self._rng.standard_normal(shape, dtype=np.float32)
        self._light = [np.empty((calibration.height, calibration.width, 3), np.float32) for _ in range(2)]
        self._field = [np.empty((calibration.height, calibration.width), np.float32) for _ in range(2)]
        columns, rows = (np.arange(n, dtype=np.float32) for n in (calibration.width, calibration.height))
        self._pixels = np.meshgrid(columns, rows)  # x and y of each
        self._vignette = _vignette(calibration, imperfections.vignetting)
        self._person = _Person(seed)
        self._boards = BoardOverlay(calibration)

    def expose(
        self,
        pose: PoseFunction,
        t_s: float,
        faults: Faults,
        covered: float = 0.0,
        hung: HungBoard | None = None,
    ) -> Exposure:
        """Take one picture.

        Args:
            pose: T_world_body at a time of the body's clock, T_world_head of a camera on a pan-tilt head.
            t_s: mid-exposure of the first row, body's clock.
            covered: share of the lens behind a hand.
            hung: a board that hangs in the world.
        """
        i = self._imperfections
        T_body_cam = self._T_body_cam
        readout_s = self._calibration.line_delay_s * (self._calibration.height - 1) if i.rolling_shutter else 0.0
        times = t_s + readout_s * np.linspace(0.0, 1.0, SHUTTER_POSES if readout_s > 0 else 1)
        T_rows = np.stack([pose(float(t)) @ T_body_cam for t in times])
        rendering = self._renderer.render(T_rows, t_s)
        if hung is not None:
            self._boards.draw(hung, rendering, T_rows)
        image = rendering.image
        if faults.person:
            image = self._person.draw(image, t_s)
        if faults.covered_lens or covered > 0:
            image = _cover(image, 1.0 if faults.covered_lens else covered)
        if i.lens_blur_px > 0:
            image = np.asarray(cv2.GaussianBlur(image, (3, 3), i.lens_blur_px))
        if i.motion_blur:
            middle = t_s + readout_s / 2
            half = self._exposure_s / 2
            T_before, T_after = pose(middle - half) @ T_body_cam, pose(middle + half) @ T_body_cam
            image = self._blur(image, rendering, T_before, T_after)
        image = self._develop(image, rendering, faults)
        exposure_s = self._exposure_s
        self._adapt(image)
        ok, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, i.jpeg_quality])
        assert ok
        return Exposure(encoded.tobytes(), image, exposure_s, rendering.inverse_depth)

    def _blur(self, image: ImageArray, rendering: Rendering, T_before: FloatArray, T_after: FloatArray) -> ImageArray:
        """Smear along the flow during the exposure: one kernel where it is even, a few shifted copies where not."""
        flow = self._flow(rendering, T_before, T_after)  # (h, w, 2) px on a coarse grid
        mean = flow.reshape(-1, 2).mean(0)
        if np.abs(flow).max() < 0.5:
            return image
        if np.abs(flow - mean).max() < 1.0 + 0.2 * float(np.hypot(*mean)):
            return np.asarray(cv2.filter2D(image, -1, _line_kernel(mean)))
        height, width = image.shape[:2]
        smooth = cv2.GaussianBlur(flow, (3, 3), 0)
        along_x, along_y = cv2.split(cv2.resize(smooth, (width, height), interpolation=cv2.INTER_LINEAR))
        x, y = self._pixels
        taps = int(np.clip(np.ceil(np.abs(flow).max() / 1.5), 2, 7))
        total = np.zeros((height, width, 3), np.float32)
        for f in (np.arange(taps) + 0.5) / taps - 0.5:
            map_x = cv2.addWeighted(x, 1.0, along_x, float(f), 0.0)
            map_y = cv2.addWeighted(y, 1.0, along_y, float(f), 0.0)
            shifted = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            cv2.accumulate(shifted, total)
        return np.asarray(cv2.convertScaleAbs(total, alpha=1.0 / taps))

    def _flow(self, rendering: Rendering, T_before: FloatArray, T_after: FloatArray) -> FloatArray:
        """Image motion (h, w, 2) px between two poses on a coarse grid; lens distortion neglected (5 % of it)."""
        c = self._calibration
        v, u = np.mgrid[FLOW_GRID_PX // 2 : c.height : FLOW_GRID_PX, FLOW_GRID_PX // 2 : c.width : FLOW_GRID_PX]
        inverse_depth = np.maximum(rendering.inverse_depth[v, u], 0.02).astype(np.float64)
        p = np.stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones_like(inverse_depth)], -1) / inverse_depth[..., None]
        T = np.linalg.inv(T_after) @ T_before
        q = transform(T, p)
        z = np.maximum(q[..., 2], 0.02)
        flow = np.stack([c.fx * q[..., 0] / z + c.cx - u, c.fy * q[..., 1] / z + c.cy - v], -1)
        return np.clip(flow, -60.0, 60.0).astype(np.float32)

    def _develop(self, image: ImageArray, rendering: Rendering, faults: Faults) -> ImageArray:
        """Exposure, lamps, vignetting and noise."""
        i = self._imperfections
        gain = np.float32(self._brightness * faults.light)
        field, lamps = self._field
        if i.vignetting > 0:
            np.multiply(self._vignette, gain, out=field)
        else:
            field.fill(gain)
        light = self._renderer.world.room_light
        if light:
            rooms = np.ones((1, NO_SURFACE + 1), np.float32)
            rooms[0, : len(self._renderer.surfaces)] = [light[s.room] for s in self._renderer.surfaces]
            cv2.multiply(field, cv2.LUT(rendering.surface, rooms, dst=lamps), dst=field)
        if i.noise <= 0 and i.vignetting <= 0 and not light and gain == 1.0:
            return image
        signal, scratch = self._light
        cv2.multiply(image, cv2.cvtColor(field, cv2.COLOR_GRAY2BGR, dst=scratch), dst=signal, dtype=cv2.CV_32F)
        if i.noise > 0:
            self._noise(signal, scratch)
        else:
            scratch.fill(0.0)
        return np.asarray(cv2.add(signal, scratch, dtype=cv2.CV_8U), dtype=np.uint8)

    def _noise(self, signal: Float32Array, noise: Float32Array) -> None:
        """Read noise and shot noise into `noise`: variance = read^2 + signal / full-well, times the gain."""
        height, width = signal.shape[:2]
        y, x = (int(v) for v in self._rng.integers(0, NOISE_SHIFT_PX, 2))
        bank = self._noise_bank[y : y + height, x : x + width]
        read = self._imperfections.noise * self._gain
        shot = 0.035 * self._imperfections.noise * self._gain
        cv2.sqrt(cv2.addWeighted(signal, shot, signal, 0.0, read**2, dst=noise), dst=noise)
        cv2.multiply(noise, bank, dst=noise)

    def _adapt(self, image: ImageArray) -> None:
        """Auto-exposure: move towards the target mean, exposure time first, then gain."""
        i = self._imperfections
        if not i.auto_exposure:
            return
        mean = float(image[::8, ::8].mean()) + 1.0
        self._brightness *= float(np.clip((TARGET_MEAN / mean) ** 0.15, 0.85, 1.18))
        self._brightness = float(np.clip(self._brightness, 0.25, 6.0))
        nominal = i.exposure_ms * 1e-3
        self._exposure_s = float(np.clip(nominal * self._brightness, 0.002, i.max_exposure_ms * 1e-3))
        self._gain = max(1.0, nominal * self._brightness / self._exposure_s)


def _vignette(camera: CameraCalibration, strength: float) -> FloatArray:
    """Share of light (H, W) that reaches each pixel: 1 in the centre."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    r2 = ((u - camera.width / 2) ** 2 + (v - camera.height / 2) ** 2) / ((camera.width**2 + camera.height**2) / 4)
    return np.asarray(1.0 - strength * r2, dtype=np.float32)


def _line_kernel(flow_px: FloatArray) -> FloatArray:
    """A line of the flow's length and direction, anti-aliased, sum 1."""
    reach = int(np.ceil(np.abs(flow_px).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    steps = max(3, int(4 * np.hypot(*flow_px)))
    for f in (np.arange(steps) + 0.5) / steps - 0.5:
        x, y = reach + f * flow_px[0], reach + f * flow_px[1]
        x0, y0 = int(x), int(y)
        fx, fy = x - x0, y - y0
        for dy, wy in ((0, 1 - fy), (1, fy)):
            for dx, wx in ((0, 1 - fx), (1, fx)):
                if wx * wy > 0:
                    kernel[y0 + dy, x0 + dx] += wx * wy
    kernel[kernel < 1e-3 * kernel.max()] = 0.0
    rows, columns = np.nonzero(kernel.any(1))[0], np.nonzero(kernel.any(0))[0]
    half_r, half_c = max(reach - rows[0], rows[-1] - reach), max(reach - columns[0], columns[-1] - reach)
    kernel = kernel[reach - half_r : reach + half_r + 1, reach - half_c : reach + half_c + 1]
    return np.asarray(kernel / kernel.sum())


def _cover(image: ImageArray, share: float) -> ImageArray:
    """A hand before the lens: dark, warm, out of focus."""
    veil = np.full_like(image, (14, 16, 24))
    soft = cv2.GaussianBlur(cv2.resize(image, None, fx=0.1, fy=0.1), (9, 9), 0)
    soft = cv2.resize(soft, (image.shape[1], image.shape[0]))
    mixed = cv2.addWeighted(soft, 0.06, veil, 0.94, 0.0)
    return np.asarray(cv2.addWeighted(image, 1.0 - share, mixed, share, 0.0))


class _Person:
    """Somebody who walks through the picture again and again: legs in trousers, swinging."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 14])
        self._speed = float(rng.uniform(0.25, 0.45))  # picture widths per second
        self._colour = tuple(int(c) for c in rng.integers(30, 120, 3))
        self._cloth = rng.integers(-25, 25, (480, 160, 1)).astype(np.int16)

    def draw(self, image: ImageArray, t_s: float) -> ImageArray:
        out = image.copy()
        height, width = image.shape[:2]
        centre = ((t_s * self._speed) % 1.6 - 0.3) * width
        for phase in (0.0, np.pi):
            swing = 0.07 * width * np.sin(6.0 * t_s + phase)
            leg = np.array(
                [
                    [centre - 0.07 * width, 0],
                    [centre + 0.07 * width, 0],
                    [centre + swing + 0.04 * width, height],
                    [centre + swing - 0.05 * width, height],
                ]
            ).astype(np.int32)
            mask = np.zeros((height, width), np.uint8)
            cv2.fillPoly(mask, [leg], 255)
            x0 = int(np.clip(centre, 0, width - 1))
            cloth = np.roll(np.resize(self._cloth, (height, width, 1)), x0, axis=1) + np.array(self._colour)
            cv2.copyTo(np.clip(cloth, 0, 255).astype(np.uint8), mask, out)
        return out
