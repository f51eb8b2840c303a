"""Where the patches of one picture lie in later ones, bent as a plane is that is seen from elsewhere.

A corner that is followed from picture to picture drifts, since each small error stays; one that is compared with the
picture that saw it first does not.
Source: Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56(3), 2004: inverse compositional, affine; brightness and
contrast are projected out as in part 3 of the same (CMU-RI-TR-03-35).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.model.frames import ImageArray
from station.vision.lens import BoolArray

SmoothArray = npt.NDArray[np.float32]  # (H, W) grey levels

HALF_PX = 8  # a patch is 17 pixels wide, as the window of the optical flow
SMOOTHING_PX = 1.0  # sigma: interpolation between pixels errs where the picture is sharp
ROUNDS = 8
SETTLED_PX = 0.03  # the last round moved it by less
LIKENESS = 0.85  # correlation with the first picture, below which it is another thing, or partly hidden
ASTRAY_PX = 2.0  # farther from where it was followed to
WORST_BEND = 2.0  # times wider or narrower than first seen, a patch has too few pixels in one of the pictures

_SIDE = np.arange(-HALF_PX, HALF_PX + 1, dtype=np.float64)
_OFFSETS = np.stack(np.meshgrid(_SIDE, _SIDE), axis=-1).reshape(-1, 2)  # (P, 2) u, v


def smoothed(grey: ImageArray) -> SmoothArray:
    return np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTHING_PX), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """N patches as they were first seen, and how they were bent when they were last seen."""

    ids: IntArray  # (N,)
    picture: FloatArray  # (N, P) zero mean, unit length
    by_pixel: FloatArray  # (N, 6, P) step of the warp for a picture that differs: bend (4), shift (2)
    bend: FloatArray  # (N, 2, 2) from the first picture's pixels to the last one's

    @classmethod
    def cut(cls, smooth: SmoothArray, ids: IntArray, uv_px: FloatArray) -> Patches:
        bend = np.broadcast_to(np.eye(2), (len(ids), 2, 2)).copy()
        seen = _sampled(smooth, uv_px, bend)
        low, high = (_sampled(smooth, uv_px, bend, (-0.5, 0.0)), _sampled(smooth, uv_px, bend, (0.5, 0.0)))
        by_u = high - low
        low, high = (_sampled(smooth, uv_px, bend, (0.0, -0.5)), _sampled(smooth, uv_px, bend, (0.0, 0.5)))
        by_v = high - low
        picture, length = _normalised(seen)
        u, v = _OFFSETS.T
        steepest = np.stack([by_u * u, by_u * v, by_v * u, by_v * v, by_u, by_v], axis=1)
        steepest -= steepest.mean(axis=2, keepdims=True)
        steepest /= length[:, None, None]
        steepest -= (steepest @ picture[..., None]) * picture[:, None]
        normal = steepest @ np.swapaxes(steepest, 1, 2)
        normal[:, range(6), range(6)] *= 1.0 + 1e-6
        normal[:, range(6), range(6)] += 1e-12
        by_pixel = np.asarray(np.linalg.solve(normal, steepest), dtype=np.float64)
        return cls(ids, picture, by_pixel, bend)

    def found(self, smooth: SmoothArray, start_px: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Where they lie (N, 2) near a start, how they are bent (N, 2, 2), and which of them are found again."""
        uv, bend = start_px.copy(), self.bend.copy()
        shift = np.zeros_like(uv)
        for _ in range(ROUNDS):
            seen, _ = _normalised(_sampled(smooth, uv, bend))
            likeness = (seen * self.picture).sum(axis=1)
            step = (self.by_pixel @ seen[..., None])[..., 0] / np.maximum(likeness, 0.3)[:, None]
            step = np.clip(step, -1.0, 1.0)
            bend = bend @ _inverse(np.eye(2) + step[:, :4].reshape(-1, 2, 2))
            shift = (bend @ step[:, 4:, None])[..., 0]
            uv = uv - shift
        width = np.linalg.norm(bend, axis=1)
        good = (likeness > LIKENESS) & (np.abs(shift).max(axis=1) < SETTLED_PX)
        good &= np.linalg.norm(uv - start_px, axis=1) < ASTRAY_PX
        good &= (width.max(axis=1) < WORST_BEND) & (width.min(axis=1) > 1.0 / WORST_BEND)
        return uv, bend, good


def _sampled(
    smooth: SmoothArray, uv_px: FloatArray, bend: FloatArray, off: tuple[float, float] = (0.0, 0.0)
) -> FloatArray:
    """(N, P)."""
    if not len(uv_px):
        return np.zeros((0, len(_OFFSETS)))
    at = uv_px[:, None] + (_OFFSETS + off) @ np.swapaxes(bend, 1, 2)
    u, v = np.ascontiguousarray(at.transpose(2, 0, 1), dtype=np.float32)
    return np.asarray(cv2.remap(smooth, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64)


def _normalised(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows of zero mean and unit length; their lengths."""
    centred = values - values.mean(axis=1, keepdims=True)
    length = np.maximum(np.linalg.norm(centred, axis=1), 1e-6)
    return centred / length[:, None], length


def _inverse(A: FloatArray) -> FloatArray:
    """(N, 2, 2); of a step that turns inside out, none."""
    det = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    adjugate = np.stack([A[:, 1, 1], -A[:, 0, 1], -A[:, 1, 0], A[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    usable, det = (np.abs(det) > 0.1)[:, None, None], det[:, None, None]
    return np.where(usable, adjugate / np.where(usable, det, 1.0), np.eye(2))


class Anchors:
    """Corners that go on being compared with the picture that saw them first. Each has a number of its own."""

    def __init__(self) -> None:
        self._ids = np.zeros(0, dtype=np.int64)  # of the tracks
        self._patches = Patches.cut(np.zeros((1, 1), dtype=np.float32), self._ids, np.zeros((0, 2)))
        self._next = 0

    def seen(self, smooth: SmoothArray, ids: IntArray, uv_px: FloatArray) -> tuple[IntArray, FloatArray]:
        """Numbers (n,) and places (n, 2) of corners in one more picture, by the tracks that were followed into it.

        What looks otherwise than at first begins anew, under another number.
        """
        patches = self._patches
        _, mine, theirs = np.intersect1d(self._ids, ids, return_indices=True)
        known = Patches(patches.ids[mine], patches.picture[mine], patches.by_pixel[mine], patches.bend[mine])
        at, bend, good = known.found(smooth, uv_px[theirs])
        fresh = np.ones(len(ids), dtype=bool)
        fresh[theirs[good]] = False
        numbers = self._next + np.arange(int(fresh.sum()), dtype=np.int64)
        self._next += len(numbers)
        new = Patches.cut(smooth, numbers, uv_px[fresh])
        self._ids = np.concatenate([ids[theirs[good]], ids[fresh]])
        self._patches = Patches(
            np.concatenate([known.ids[good], new.ids]),
            np.concatenate([known.picture[good], new.picture]),
            np.concatenate([known.by_pixel[good], new.by_pixel]),
            np.concatenate([bend[good], new.bend]),
        )
        return self._patches.ids, np.concatenate([at[good], uv_px[fresh]])
