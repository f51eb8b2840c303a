"""Active search: a feature's patch, warped as the predicted view shows it, is looked for in its ellipse only.

Source: Davison et al., MonoSLAM, IEEE TPAMI 29(6), 2007, section 3.4; the patch is taken for a small plane that faced
the camera when it was first seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous
from station.model.frames import ImageArray
from station.slam.mono.config import SearchConfig
from station.slam.mono.filter import Wanted
from station.slam.mono.motion import POSITION
from station.slam.mono.state import State
from station.vision.klt import detect_corners
from station.vision.lens import BoolArray, Lens

NEAREST, FARTHEST = 0.05, 1e3  # units; of a patch's plane, for its warp only


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """What a feature looked like when it was first seen, and from where."""

    grey: ImageArray  # (side, side), the feature in its middle
    rays: FloatArray  # (3, 3) through the middle, and one step right and down of it; z = 1, camera axes
    r: FloatArray  # (3,) as far as was known while the feature had six numbers
    R: FloatArray  # (3, 3)


class PatchFinder:
    """The patches of all features, and the image in which they are looked for."""

    def __init__(self, lens: Lens, config: SearchConfig) -> None:
        self._lens = lens
        self._config = config
        self._half = config.patch_px // 2
        self._reach = self._half + config.margin_px
        self._grey: ImageArray = np.zeros((1, 1), dtype=np.uint8)
        self._patches: dict[int, Patch] = {}

    def look_at(self, grey: ImageArray) -> None:
        """What follows is about this image (H, W)."""
        self._grey = grey

    def keep(self, ids: IntArray) -> None:
        """Forget all other features."""
        self._patches = {number: self._patches[number] for number in ids.tolist()}

    def new_features(self, existing_px: FloatArray, count: int) -> FloatArray:
        """Shi-Tomasi corners where there are no features yet, at the middle of a whole pixel each."""
        config = self._config
        uv = detect_corners(self._grey, existing_px, count, config.cell_px, config.min_response, self._reach + 2)
        uv = np.rint(uv)
        inside = self._lens.is_inside(uv, self._reach + 1.0)
        return uv[inside & self._lens.is_invertible(uv, self._lens.unproject(uv))]

    def remember(self, ids: IntArray, uv_px: FloatArray, state: State) -> None:
        steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        rays = homogeneous(self._lens.unproject(uv_px[:, None] + steps))
        for number, (u, v), three in zip(ids.tolist(), uv_px.astype(int).tolist(), rays, strict=True):
            side = slice(v - self._reach, v + self._reach + 1), slice(u - self._reach, u + self._reach + 1)
            self._patches[number] = Patch(self._grey[side].copy(), three, state.x[POSITION], state.R)

    def find(self, wanted: Wanted) -> tuple[FloatArray, BoolArray, BoolArray]:
        count = len(wanted.rows)
        uv, tried, found = wanted.uv_px.copy(), np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        if not count:
            return uv, tried, found
        patches = self._seen_from_origins(wanted)
        warps = self._warps(wanted, patches)
        stretch = np.linalg.svd(warps, compute_uv=False)
        limit = self._config.max_stretch
        tried = (stretch[:, 0] < limit) & (stretch[:, 1] > 1.0 / limit)
        inverse_S = np.linalg.inv(wanted.S)
        half_sides = np.ceil(wanted.gate_sigmas * np.sqrt(wanted.S[:, range(2), range(2)]))
        half_sides = np.minimum(half_sides, self._config.max_reach_px).astype(int)
        for i in np.flatnonzero(tried).tolist():
            template = self._warped(patches[i].grey, warps[i])
            place = self._search(template, wanted.uv_px[i], half_sides[i], inverse_S[i], wanted.gate_sigmas)
            if place is not None:
                uv[i], found[i] = place, True
        return uv, tried, found

    def _seen_from_origins(self, wanted: Wanted) -> list[Patch]:
        """The wanted patches; where they were seen from is what the filter thinks of that by now (x_i of C.2)."""
        numbers = wanted.state.ids[wanted.rows].tolist()
        y, is_inverse = wanted.state.features()[wanted.rows], wanted.state.is_inverse[wanted.rows]
        for i in np.flatnonzero(is_inverse).tolist():
            self._patches[numbers[i]] = replace(self._patches[numbers[i]], r=y[i, :3])
        return [self._patches[number] for number in numbers]

    def _warps(self, wanted: Wanted, patches: list[Patch]) -> FloatArray:
        """(M, 2, 2): what becomes of a step in the patch, in pixels of this image."""
        state = wanted.state
        rays, r, R = (np.stack(each) for each in zip(*((p.rays, p.r, p.R) for p in patches), strict=True))
        depth = np.einsum("mi,mi->m", state.points()[0][wanted.rows] - r, R[:, :, 2])
        depth = np.where(depth > NEAREST, np.minimum(depth, FARTHEST), FARTHEST)  # behind: beyond infinity
        corners = rays * depth[:, None, None] @ np.swapaxes(R, 1, 2) + r[:, None]
        seen = (corners - state.x[POSITION]) @ state.R
        uv = self._lens.project(seen[..., :2] / np.maximum(seen[..., 2:], NEAREST))
        return np.swapaxes(uv[:, 1:] - uv[:, :1], 1, 2)

    def _warped(self, grey: ImageArray, warp: FloatArray) -> ImageArray:
        """The template (patch_px, patch_px) as this image should show it."""
        back = np.linalg.inv(warp)  # from a step in this image to one in the patch
        middle = np.full(2, float(self._half))
        M = np.column_stack([back, self._reach - back @ middle])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        side = (self._config.patch_px, self._config.patch_px)
        return np.asarray(cv2.warpAffine(grey, M, side, flags=flags, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)

    def _search(
        self, template: ImageArray, uv: FloatArray, half_sides: IntArray, inverse_S: FloatArray, gate: float
    ) -> FloatArray | None:
        """Where in its ellipse (eq. 2.6) the template is (2,), to a part of a pixel; None where it is not."""
        height, width = self._grey.shape
        u, v = np.rint(uv).astype(int).tolist()
        left, right = max(u - half_sides[0], self._half), min(u + half_sides[0], width - 1 - self._half)
        top, bottom = max(v - half_sides[1], self._half), min(v + half_sides[1], height - 1 - self._half)
        if left > right or top > bottom:
            return None
        region = self._grey[top - self._half : bottom + self._half + 1, left - self._half : right + self._half + 1]
        score = np.asarray(cv2.matchTemplate(region, template, cv2.TM_CCOEFF_NORMED), dtype=np.float64)
        du = np.arange(left, right + 1) - uv[0]
        dv = np.arange(top, bottom + 1)[:, None] - uv[1]
        chi2 = inverse_S[0, 0] * du * du + 2.0 * inverse_S[0, 1] * du * dv + inverse_S[1, 1] * dv * dv
        in_ellipse = np.where(chi2 < gate * gate, score, -1.0)
        row, column = divmod(int(np.argmax(in_ellipse)), score.shape[1])
        if in_ellipse[row, column] < self._config.min_correlation:
            return None
        return np.array([left + column + _peak(score[row], column), top + row + _peak(score[:, column], row)])


def _peak(line: FloatArray, at: int) -> float:
    """Where between its neighbours a largest value lies, -0.5 to 0.5: top of the parabola through the three."""
    if not 0 < at < len(line) - 1:
        return 0.0
    before, middle, after = (float(x) for x in line[at - 1 : at + 2])
    bend = before - 2.0 * middle + after
    return 0.0 if bend >= 0.0 else min(max(0.5 * (before - after) / bend, -0.5), 0.5)
