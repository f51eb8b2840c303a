"""Active search: a feature's patch, warped as the predicted view shows it, is looked for in its ellipse only.

Source: Davison et al., MonoSLAM, IEEE TPAMI 29(6), 2007, section 3.4; the patch is taken for a small plane that faced
the camera when it was first seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous, inverse, transform
from station.model.frames import ImageArray
from station.slam.mono.config import MonoConfig
from station.slam.mono.state import Expected, State
from station.vision.klt import detect_corners
from station.vision.lens import BoolArray, Lens

CORNER = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # steps of one pixel right and down
NEAREST, FARTHEST = 0.05, 1e3  # units; of a patch's plane, for its warp only


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """What a feature looked like when it was first seen, and from where."""

    grey: ImageArray  # (side, side), the feature in its middle
    shrunk: int  # 1, or so many times smaller than the image
    rays: FloatArray  # (3, 3) through the middle, and one pixel of grey right and down of it; z = 1, camera axes
    T_world_cam: FloatArray  # (4, 4)


class PatchFinder:
    """The patches of all features, and the image in which they are looked for."""

    def __init__(self, lens: Lens, config: MonoConfig) -> None:
        self._lens = lens
        self._config = config
        self._half = config.patch_px // 2
        self._reach = self._half + config.margin_px
        self._patches: dict[int, Patch] = {}

    def look_at(self, grey: ImageArray) -> None:
        """What follows is about this image (H, W)."""
        coarse, (height, width) = self._config.coarse, grey.shape
        size = width // coarse, height // coarse
        small: ImageArray = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        self._images = {1: grey, coarse: small}

    def keep(self, ids: IntArray) -> None:
        """Forget all other features."""
        self._patches = {number: self._patches[number] for number in ids.tolist()}

    def new_features(
        self, state: State, uv_px: FloatArray, in_view: BoolArray, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Shi-Tomasi corners where there are no features yet, at the middle of a whole pixel each; sharp ones first."""
        config, reach, known = self._config, self._reach, int(in_view.sum())
        px, noise = uv_px[in_view], state.noise[in_view]
        kinds = (1, 1.0, config.min_response), (config.coarse, config.coarse_noise, config.min_coarse_response)
        for shrunk, own_noise, least in kinds:
            image, wanted = self._images[shrunk], config.num_measured - int((noise <= own_noise).sum())
            corners = detect_corners(image, to_shrunk(px, shrunk), wanted, config.cell_px // shrunk, least, reach + 2)
            uv = from_shrunk(np.rint(corners), shrunk)
            inside = self._lens.is_inside(uv, (reach + 1.0) * shrunk)
            uv = uv[inside & self._lens.is_invertible(uv, self._lens.unproject(uv))]
            uv = uv[: max(known + len(ids) - len(px), 0)]
            rays = homogeneous(self._lens.unproject(uv[:, None] + shrunk * CORNER))
            places = np.rint(to_shrunk(uv, shrunk)).astype(int).tolist()
            for number, (column, row), three in zip(ids[len(px) - known :].tolist(), places, rays, strict=False):
                grey = image[row - reach : row + reach + 1, column - reach : column + reach + 1].copy()
                self._patches[number] = Patch(grey, shrunk, three, state.T_world_cam)
            px, noise = np.concatenate([px, uv]), np.append(noise, np.full(len(uv), own_noise))
        return px[known:], noise[known:]

    def find(self, state: State, expected: Expected) -> tuple[FloatArray, BoolArray]:
        uv, found = expected.uv_px.copy(), np.zeros(len(expected.rows), dtype=bool)
        points, origins, ellipses = state.points()[0], state.features()[:, :3], expected.ellipses()
        for i, row in enumerate(expected.rows.tolist()):
            patch = self._patches[int(state.ids[row])]
            if state.is_inverse[row]:  # x_i of C.2: where it was seen from, as is known by now
                patch.T_world_cam[:3, 3] = origins[row]
            warp = self._warp(patch, points[row], state)
            if not 1.0 < self._config.max_stretch * np.linalg.det(warp) < self._config.max_stretch**2:
                continue
            template = self._warped(patch.grey, warp)
            middle = to_shrunk(uv[i], patch.shrunk)
            place = self._search(self._images[patch.shrunk], template, middle, ellipses[i] / patch.shrunk**2)
            if place is not None:
                uv[i], found[i] = from_shrunk(place, patch.shrunk), True
        return uv, found

    def _warp(self, patch: Patch, point: FloatArray, state: State) -> FloatArray:
        """(2, 2): what becomes of a step in the patch, in pixels of this image, shrunk likewise."""
        depth = transform(inverse(patch.T_world_cam), point)[2]
        depth = min(depth, FARTHEST) if depth > NEAREST else FARTHEST  # behind: beyond infinity
        seen = transform(inverse(state.T_world_cam) @ patch.T_world_cam, depth * patch.rays)
        uv = self._lens.project(seen[:, :2] / np.maximum(seen[:, 2:], NEAREST))
        return (uv[1:] - uv[0]).T / patch.shrunk

    def _warped(self, grey: ImageArray, warp: FloatArray) -> ImageArray:
        """The template (patch_px, patch_px) as this image should show it."""
        back = np.linalg.inv(warp)  # from a step in this image to one in the patch
        M = np.column_stack([back, self._reach - back @ np.full(2, float(self._half))])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        side = (self._config.patch_px, self._config.patch_px)
        return np.asarray(cv2.warpAffine(grey, M, side, flags=flags, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)

    def _search(self, grey: ImageArray, template: ImageArray, uv: FloatArray, S: FloatArray) -> FloatArray | None:
        """Where in its ellipse (eq. 2.6) the template is (2,), to a part of a pixel; None where it is not."""
        half, gate = self._half, self._config.gate_sigmas
        reach = np.minimum(np.ceil(gate * np.sqrt(np.diag(S))), self._config.max_reach_px)
        end = np.array(grey.shape[::-1]) - 1 - half
        low = np.maximum(np.rint(uv) - reach, half).astype(int)
        high = np.minimum(np.rint(uv) + reach, end).astype(int)
        if (low > high).any():
            return None
        region = grey[low[1] - half : high[1] + half + 1, low[0] - half : high[0] + half + 1]
        score = np.asarray(cv2.matchTemplate(region, template, cv2.TM_CCOEFF_NORMED), dtype=np.float64)
        off = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1) - uv
        in_ellipse = np.where(((off @ np.linalg.inv(S)) * off).sum(axis=-1) < gate**2, score, -1.0)
        row, column = divmod(int(np.argmax(in_ellipse)), score.shape[1])
        if in_ellipse[row, column] < self._config.min_correlation:
            return None
        return low + np.array([column + _peak(score[row], column), row + _peak(score[:, column], row)])


def to_shrunk(uv_px: FloatArray, shrunk: int) -> FloatArray:
    """Pixels of the image so many times smaller; the middle of the first pixel is at 0 in both."""
    return (uv_px + 0.5) / shrunk - 0.5


def from_shrunk(uv_px: FloatArray, shrunk: int) -> FloatArray:
    return (uv_px + 0.5) * shrunk - 0.5


def _peak(line: FloatArray, at: int) -> float:
    """Where between its neighbours a largest value lies, -0.5 to 0.5: top of the parabola through the three."""
    if not 0 < at < len(line) - 1:
        return 0.0
    before, middle, after = (float(x) for x in line[at - 1 : at + 2])
    bend = before - 2.0 * middle + after
    return 0.0 if bend >= 0.0 else min(max(0.5 * (before - after) / bend, -0.5), 0.5)
