"""Active search: a feature's patch, warped as the predicted view shows it, is looked for in its ellipse only.

Source: Davison et al., IEEE TPAMI 29(6), 2007, 3.4; a patch is a small plane that faced the camera when first seen.
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
from station.vision.patch_alignment import Float32Array, find_patch, from_shrunk, noise_of, to_shrunk

CORNER = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # steps of one pixel right and down
NEAREST, FARTHEST = 0.05, 1e3  # units; of a patch's plane, for its warp only


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """What a feature looked like when it was first seen, and from where."""

    grey: Float32Array  # (side, side), the feature in its middle
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
        fine = grey.astype(np.float32)
        small = cv2.resize(fine, (width // coarse, height // coarse), interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), self._config.coarse_blur)
        self._images: dict[int, Float32Array] = {1: fine, coarse: np.asarray(small, dtype=np.float32)}

    def keep(self, ids: IntArray) -> None:
        """Forget all other features."""
        self._patches = {number: self._patches[number] for number in ids.tolist()}

    def new_features(self, state: State, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """Shi-Tomasi corners where there are no features yet, at the middle of a whole pixel each; sharp ones first."""
        config, reach = self._config, self._reach
        in_view, px = state.in_view(self._lens)
        kinds = np.array([self._patches[number].shrunk for number in state.ids[in_view].tolist()])
        noise: list[FloatArray] = []
        for shrunk, least in (1, config.min_response), (config.coarse, config.min_coarse_response):
            image, wanted = self._images[shrunk], config.num_measured - int((kinds <= shrunk).sum()) - len(noise)
            known_px, cell = to_shrunk(px, shrunk), config.cell_px // shrunk
            corners = np.rint(detect_corners(image / 255.0, known_px, wanted, cell, least, reach + 2, self._half))
            uv = from_shrunk(corners, shrunk)
            keep = np.flatnonzero(self._lens.is_invertible(uv, self._lens.unproject(uv)))[: len(ids) - len(noise)]
            rays = homogeneous(self._lens.unproject(uv[keep, None] + shrunk * CORNER))
            for (column, row), three in zip(corners[keep].astype(int).tolist(), rays, strict=True):
                grey = image[row - reach : row + reach + 1, column - reach : column + reach + 1].copy()
                self._patches[int(ids[len(noise)])] = Patch(grey, shrunk, three, state.T_world_cam)
                middle = grey[config.margin_px : -config.margin_px, config.margin_px : -config.margin_px]
                noise.append(shrunk**2 * noise_of(middle, config.grey_noise / shrunk / config.min_sigma_px))
            px = np.concatenate([px, uv[keep]])
        return px[len(in_view) :], np.array(noise).reshape(-1, 2, 2)

    def find(self, state: State, expected: Expected) -> tuple[FloatArray, BoolArray]:
        config, uv, found = self._config, expected.uv_px.copy(), np.zeros(len(expected.rows), dtype=bool)
        points, origins, ellipses = state.points(), state.features()[:, :3], expected.ellipses()
        for i, row in enumerate(expected.rows.tolist()):
            patch = self._patches[int(state.ids[row])]
            if state.is_inverse[row]:  # x_i of C.2: where it was seen from, as is known by now
                patch.T_world_cam[:3, 3] = origins[row]
            template, S = self._template(patch, points[row], state), ellipses[i] / patch.shrunk**2  # eq. 2.6
            if template is None:
                continue
            image, middle, gate = self._images[patch.shrunk], to_shrunk(uv[i], patch.shrunk), config.gate_sigmas**2
            place = find_patch(image, template, middle, gate * S, config.max_reach_px, config.min_correlation)
            if place is not None:
                uv[i], found[i] = from_shrunk(place, patch.shrunk), True
        return uv, found

    def _template(self, patch: Patch, point: FloatArray, state: State) -> Float32Array | None:
        """The patch's middle as this image should show it; None where it is stretched too much to be compared."""
        depth = transform(inverse(patch.T_world_cam), point)[2]
        depth = min(depth, FARTHEST) if depth > NEAREST else FARTHEST  # behind: beyond infinity
        seen = transform(inverse(state.T_world_cam) @ patch.T_world_cam, depth * patch.rays)
        uv = self._lens.project(seen[:, :2] / np.maximum(seen[:, 2:], NEAREST))
        warp = (uv[1:] - uv[0]).T / patch.shrunk  # of a step in the patch to one in this image, shrunk likewise
        if not 1.0 < self._config.max_stretch * np.linalg.det(warp) < self._config.max_stretch**2:
            return None
        back, side = np.linalg.inv(warp), (self._config.patch_px,) * 2
        M = np.column_stack([back, self._reach - back @ np.full(2, float(self._half))])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpAffine(patch.grey, M, side, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(warped, dtype=np.float32)
