"""Lost landmarks found again: each one's patch, warped as the new view should show it, near where it is predicted.

A descriptor would have to be detected again at the same place; a patch is looked for where the landmark must be, and
found to a tenth of a pixel. Source: Klein and Murray, ISMAR 2007 (PTAM), section 5; Baker and Matthews, IJCV
56(3), 2004 (inverse compositional alignment).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray, homogeneous
from station.model.frames import ImageArray
from station.slam.smoothing.config import RecallConfig
from station.vision.lens import BoolArray, Lens

ALIGN_STEPS = 8
MAX_ALIGN_PX = 1.5  # from the best whole pixel
PEAK_PX = 2  # places nearer than this to the best one are the same peak
MIN_DEPTH = 0.05
MAX_XY = 3.0  # beyond that no lens model holds


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """How n landmarks looked in one view each."""

    grey: npt.NDArray[np.uint8]  # (n, side, side), the landmark at the middle
    offset: FloatArray  # (n, 2) px, of the landmark from the middle of the middle pixel
    uv_px: FloatArray  # (n, 2)
    T_world_cam: FloatArray  # (n, 4, 4) of that view

    def take(self, rows: IntArray) -> Patches:
        return Patches(self.grey[rows], self.offset[rows], self.uv_px[rows], self.T_world_cam[rows])


def cut_patches(grey: ImageArray, uv_px: FloatArray, T_world_cam: FloatArray, side: int) -> tuple[Patches, BoolArray]:
    """Patches at pixels (n, 2), and which of them lie wholly in the image (n,); only those are returned."""
    half = side // 2
    middle = np.rint(uv_px).astype(int)
    height, width = grey.shape
    inside = (middle >= half).all(axis=1) & (middle[:, 0] < width - half) & (middle[:, 1] < height - half)
    middle, uv = middle[inside], uv_px[inside]
    windows = np.lib.stride_tricks.sliding_window_view(grey, (side, side))
    cut = windows[middle[:, 1] - half, middle[:, 0] - half].copy()
    return Patches(cut, uv - middle, uv, np.repeat(T_world_cam[None], len(uv), axis=0)), inside


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    rows: IntArray  # (k,) of those asked for
    uv_px: FloatArray  # (k, 2)


def find_again(
    grey: ImageArray,
    lens: Lens,
    T_world_cam: FloatArray,
    p_world: FloatArray,
    patches: Patches,
    reach_px: FloatArray,
    config: RecallConfig,
) -> Found:
    """Look for n landmarks in an image.

    Args:
        grey: (H, W); T_world_cam: its predicted pose.
        p_world: (n, 3) landmarks; reach_px: (n,) how far from its prediction each may be.
    """
    uv, warp, is_visible = predict_views(lens, T_world_cam, p_world, patches, config)
    rows = np.flatnonzero(is_visible)
    if not len(rows):
        return Found(rows, np.zeros((0, 2)))
    templates = warped(patches.take(rows), np.asarray(np.linalg.inv(warp[rows])), config.patch_px + 2)
    at, is_found = _search(grey, templates[:, 1:-1, 1:-1], uv[rows], reach_px[rows], config)
    rows, templates, at = rows[is_found], templates[is_found], at[is_found]
    if not len(rows):
        return Found(rows, at)
    refined, correlation = align(grey, templates, at)
    good = (np.abs(refined - at).max(axis=1) < MAX_ALIGN_PX) & (correlation > config.min_correlation)
    return Found(rows[good], refined[good])


def are_in_view(
    lens: Lens, T_world_cam: FloatArray, p_world: FloatArray, c_ref: FloatArray, config: RecallConfig
) -> BoolArray:
    """Which of n points lie in the image, looked at from about where their patches were cut: centres c_ref (n, 3).

    Cheap enough for all landmarks of a drive; `predict_views`, which asks for more, is not.
    """
    ray, ray_ref = p_world - T_world_cam[:3, 3], p_world - c_ref
    cosine = (ray * ray_ref).sum(axis=1)
    cosine /= np.linalg.norm(ray, axis=1) * np.linalg.norm(ray_ref, axis=1) + 1e-12
    p_cam = ray @ T_world_cam[:3, :3]
    xy = p_cam[:, :2] / np.maximum(p_cam[:, 2:], MIN_DEPTH)
    visible = (cosine > np.cos(np.radians(config.max_view_angle_deg))) & (p_cam[:, 2] > MIN_DEPTH)
    visible &= (np.abs(xy) < MAX_XY).all(axis=1)
    rows = np.flatnonzero(visible)
    visible[rows] = lens.is_inside(lens.project(xy[rows]), config.patch_px)
    return visible


def predict_views(
    lens: Lens, T_world_cam: FloatArray, p_world: FloatArray, patches: Patches, config: RecallConfig
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where each landmark should be (n, 2) px; how a step in its patch appears (n, 2, 2); whether it can be seen (n,).

    Its surroundings are taken for a plane that faced the camera of its patch.
    """
    R, c = T_world_cam[:3, :3], T_world_cam[:3, 3]
    R_ref, c_ref = patches.T_world_cam[:, :3, :3], patches.T_world_cam[:, :3, 3]
    p_ref = ((p_world - c_ref)[:, None] @ R_ref)[:, 0]
    visible = are_in_view(lens, T_world_cam, p_world, c_ref, config) & (p_ref[:, 2] > MIN_DEPTH)
    depth = np.where(visible, p_ref[:, 2], 1.0)
    steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = homogeneous(lens.unproject(patches.uv_px[:, None] + steps))
    moved = (rays - rays[:, :1]) * depth[:, None, None]  # from the landmark, on its plane
    corners = (p_world[:, None] + moved @ np.swapaxes(R_ref, 1, 2) - c) @ R
    z = np.where(visible[:, None], corners[..., 2], 1.0)
    visible &= (z > MIN_DEPTH).all(axis=1)
    xy = corners[..., :2] / np.maximum(z, MIN_DEPTH)[..., None]
    visible &= (np.abs(xy) < MAX_XY).all(axis=(1, 2))
    seen = lens.project(np.where(visible[:, None, None], xy, 0.0))
    uv, warp = seen[:, 0], np.swapaxes(seen[:, 1:] - seen[:, :1], 1, 2)
    stretch = np.linalg.svd(warp, compute_uv=False)
    visible &= (stretch[:, 0] < config.max_stretch) & (stretch[:, 1] > 1.0 / config.max_stretch)
    return uv, np.where(visible[:, None, None], warp, np.eye(2)), visible


def warped(patches: Patches, back: FloatArray, side: int) -> npt.NDArray[np.float32]:
    """(n, side, side) the patches as seen after warps whose inverses are `back` (n, 2, 2)."""
    n, stored = len(patches.grey), patches.grey.shape[1]
    half = side // 2
    grid = np.stack(np.meshgrid(np.arange(-half, half + 1), np.arange(-half, half + 1)), axis=-1).astype(np.float64)
    at = np.einsum("nij,vuj->nvui", back, grid) + (patches.offset + stored // 2)[:, None, None]
    at = np.clip(at, 0.0, stored - 1.0)
    at[..., 1] += stored * np.arange(n)[:, None, None]
    stack = patches.grey.reshape(n * stored, stored)
    maps = at.astype(np.float32).reshape(n * side, side, 2)
    return np.asarray(cv2.remap(stack, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR), dtype=np.float32).reshape(
        n, side, side
    )


def _search(
    grey: ImageArray,
    templates: npt.NDArray[np.float32],
    uv: FloatArray,
    reach_px: FloatArray,
    config: RecallConfig,
) -> tuple[FloatArray, BoolArray]:
    """The whole pixel (n, 2) around which each template fits best, and whether it does so clearly (n,)."""
    half, (height, width) = config.patch_px // 2, grey.shape
    at, found = np.rint(uv), np.zeros(len(uv), dtype=bool)
    for i, (template, reach) in enumerate(zip(templates, np.ceil(reach_px).astype(int).tolist(), strict=True)):
        u, v = (int(x) for x in at[i])
        left, top = max(u - reach - half, 0), max(v - reach - half, 0)
        window = grey[top : min(v + reach + half + 1, height), left : min(u + reach + half + 1, width)]
        if min(window.shape) < config.patch_px or float(template.std()) < 4.0:
            continue
        score = cv2.matchTemplate(window, np.rint(template).astype(np.uint8), cv2.TM_CCOEFF_NORMED)
        _, best, _, (column, row) = cv2.minMaxLoc(score)
        if best < config.min_correlation - 0.1:
            continue
        score[max(row - PEAK_PX, 0) : row + PEAK_PX + 1, max(column - PEAK_PX, 0) : column + PEAK_PX + 1] = -1.0
        second = float(score.max())
        found[i] = second < config.max_ratio * best
        at[i] = left + column + half, top + row + half
    return at, found


def align(grey: ImageArray, templates: npt.NDArray[np.float32], at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) where templates (n, side + 2, side + 2) fit best, from a pixel's error; correlations (n,) there."""
    T = templates[:, 1:-1, 1:-1].astype(np.float64)
    gu = 0.5 * (templates[:, 1:-1, 2:] - templates[:, 1:-1, :-2]).astype(np.float64)
    gv = 0.5 * (templates[:, 2:, 1:-1] - templates[:, :-2, 1:-1]).astype(np.float64)
    n, side, _ = T.shape
    T = T - T.mean(axis=(1, 2), keepdims=True)
    J = np.stack([(g - g.mean(axis=(1, 2), keepdims=True)).reshape(n, -1) for g in (gu, gv)], axis=1)
    H = J @ np.swapaxes(J, 1, 2) + 1e-3 * np.eye(2)
    size = np.linalg.norm(T.reshape(n, -1), axis=1)
    half = side // 2
    grid = np.stack(np.meshgrid(np.arange(-half, half + 1), np.arange(-half, half + 1)), axis=-1)
    place, correlation = at.astype(np.float64).copy(), np.zeros(n)
    for step in range(ALIGN_STEPS + 1):
        maps = (place[:, None, None] + grid).astype(np.float32).reshape(n * side, side, 2)
        seen = cv2.remap(grey, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        seen = np.asarray(seen, dtype=np.float64).reshape(n, -1)
        seen -= seen.mean(axis=1, keepdims=True)
        gain = np.linalg.norm(seen, axis=1)
        correlation = (seen * T.reshape(n, -1)).sum(axis=1) / np.maximum(gain * size, 1e-9)
        if step == ALIGN_STEPS:
            break
        off = seen * (size / np.maximum(gain, 1e-9))[:, None] - T.reshape(n, -1)
        move = np.linalg.solve(H, (J @ off[..., None]))[..., 0]
        place = place - np.clip(move, -1.0, 1.0)
        if float(np.abs(move).max()) < 0.01:
            break
    return place, correlation
