"""Active search: a feature's patch, warped as the predicted view shows it, is looked for in its ellipse only.

Source: Davison et al., IEEE TPAMI 29(6), 2007, 3.4; a patch is a small plane that faced the camera when first seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous, inverse
from station.model.frames import ImageArray
from station.slam.mono.config import MonoConfig
from station.slam.mono.state import Expected, State
from station.vision.klt import detect_corners
from station.vision.lens import BoolArray, Lens
from station.vision.patch_alignment import Float32Array, find_patches, from_shrunk, noise_of, to_shrunk, warped

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
        patches, gates = [self._patches[i] for i in state.ids[expected.rows].tolist()], expected.ellipses()  # eq. 2.6
        for patch, row in zip(patches, state.rows()[expected.rows], strict=True):
            if row[5]:  # x_i of C.2: where it was seen from, as is known by now
                patch.T_world_cam[:3, 3] = state.x[row[:3]]
        warps, kinds = self._warps(patches, state.points()[expected.rows], state), [patch.shrunk for patch in patches]
        area = np.linalg.det(warps)
        is_alike = (config.max_stretch * area > 1.0) & (config.max_stretch * area < config.max_stretch**2)
        for shrunk, image in self._images.items():
            some = np.flatnonzero(is_alike & (np.array(kinds) == shrunk))
            gate = gates[some] * (config.gate_sigmas / shrunk) ** 2
            templates = warped([patches[i].grey for i in some.tolist()], warps[some], config.patch_px)
            middle, reach = to_shrunk(uv[some], shrunk), config.max_reach_px
            places, is_there = find_patches(image, templates, middle, gate, reach, config.min_correlation)
            some = some[is_there]
            uv[some], found[some] = from_shrunk(places[is_there], shrunk), True
        return uv, found

    def _warps(self, patches: list[Patch], points: FloatArray, state: State) -> FloatArray:
        """Of a step in each patch, the feature at points (M, 3), to one in this image, shrunk likewise (M, 2, 2)."""
        T = np.array([patch.T_world_cam for patch in patches]).reshape(-1, 4, 4)
        rays = np.array([patch.rays for patch in patches]).reshape(-1, 3, 3)
        depth = ((points - T[:, :3, 3]) * T[:, :3, 2]).sum(axis=1)
        depth = np.where(depth > NEAREST, np.minimum(depth, FARTHEST), FARTHEST)  # behind: beyond infinity
        T = inverse(state.T_world_cam) @ T
        seen = (depth[:, None, None] * rays) @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
        uv = self._lens.project(seen[..., :2] / np.maximum(seen[..., 2:], NEAREST))
        shrunk = np.array([patch.shrunk for patch in patches])
        return np.swapaxes(uv[:, 1:] - uv[:, :1], 1, 2) / shrunk[:, None, None]
