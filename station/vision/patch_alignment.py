"""Where in an image small patches lie, to a part of a pixel, and how surely. Many in one call.

Source: Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56(3), 2004: the inverse compositional step.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.vision.lens import BoolArray

Float32Array = npt.NDArray[np.float32]
MAX_STEPS, SETTLED_PX = 5, 0.01
MIN_GAIN = 0.3  # of the image's contrast over the patch's
MAX_SHIFT_PX = 1.0


def warped(patches: list[Float32Array], warps: FloatArray, side: int) -> Float32Array:
    """The middles (M, side, side) of square patches as an image shows them; warps (M, 2, 2): their steps in it."""
    flags, out = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, np.empty((len(patches), side, side), dtype=np.float32)
    back = np.linalg.inv(warps)  # of the image's steps to the patch's
    from_corner = (side // 2) * back.sum(axis=2, keepdims=True)
    for patch, step, corner, view in zip(patches, back, from_corner, out, strict=True):
        M = np.hstack([step, len(patch) // 2 - corner])
        cv2.warpAffine(patch, M, (side, side), dst=view, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return out


def find_patches(
    image: Float32Array, patches: Float32Array, uv: FloatArray, ellipses: FloatArray, max_reach: int, least: float
) -> tuple[FloatArray, BoolArray]:
    """Where in ellipses the patches (M, n, n) are (M, 2), to a part of a pixel; and whether they are there (M,).

    Args:
        uv: (M, 2) px, each ellipse's middle, where off @ inv(ellipse) @ off < 1.
        max_reach: half a side of the searched rectangle, px, at most.
        least: correlation that counts.
    """
    half = patches.shape[1] // 2
    reach = np.minimum(np.ceil(np.sqrt(ellipses[:, [0, 1], [0, 1]])), max_reach)
    end = np.array(image.shape[::-1]) - 1 - half
    low = np.maximum(np.rint(uv) - reach, half).astype(int)
    high = np.minimum(np.rint(uv) + reach, end).astype(int)
    inverse, places, found = np.linalg.inv(ellipses), low.astype(np.float64), (low <= high).all(axis=1)
    for i in np.flatnonzero(found).tolist():
        (left, top), (right, bottom) = low[i].tolist(), high[i].tolist()
        region = image[top - half : bottom + half + 1, left - half : right + half + 1]
        score = np.asarray(cv2.matchTemplate(region, patches[i], cv2.TM_CCOEFF_NORMED))
        u, v = np.arange(left, right + 1) - uv[i, 0], (np.arange(top, bottom + 1) - uv[i, 1])[:, None]
        (a, b), (_, c) = inverse[i].tolist()
        inside = np.where((a * u + 2.0 * b * v) * u + c * v * v < 1.0, score, -1.0)
        row, column = divmod(int(np.argmax(inside)), score.shape[1])
        places[i] += column, row
        found[i] = inside[row, column] >= least
    places[found], is_near = align(image, patches[found], places[found])
    found[found] = is_near
    return places, found


def align(image: Float32Array, patches: Float32Array, places: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Places (M, 2) px near these where the patches' (M, n, n) middles fit best; and whether within a pixel (M,).

    Least squares over a patch's pixels: image = gain (patch - gradient shift) + a plane. The plane takes what stands
    still while the camera turns: a lens gives less light towards its corners, and on a bare wall its slope exceeds the
    shades that are followed.
    """
    A = _basis(patches)
    A_t = np.swapaxes(A, 1, 2)
    solve, found, size = np.linalg.solve(A_t @ A, A_t)[:, :3], places.copy(), patches.shape[1:]
    near, going = np.ones(len(places), dtype=bool), np.arange(len(places))
    for _ in range(MAX_STEPS):
        around = np.array(
            [cv2.getRectSubPix(image, size, middle) for middle in found[going].tolist()], dtype=np.float64
        )
        fit = (solve[going] @ around.reshape(len(going), A.shape[1], 1))[:, :, 0]
        step = -fit[:, :2] / np.maximum(fit[:, 2:], MIN_GAIN)
        found[going] += step
        near[going] = np.abs(found[going] - places[going]).max(axis=1) <= MAX_SHIFT_PX
        going = going[near[going] & (np.abs(step).max(axis=1) >= SETTLED_PX)]
        if not len(going):
            break
    return found, near


def noise_of(patch: Float32Array, grey_noise: float) -> FloatArray:
    """(2, 2): covariance of the place where the patch is found, beside that of one with strong gradients all around.

    What an image differs by from its patch grows with the gradients, so their directions count: along an edge a patch
    slides. Where they are weak, the image's own noise adds to it (grey_noise: grey levels for each pixel of error).
    """
    A = _basis(patch)
    return np.asarray(np.linalg.inv(A.T @ A)[:2, :2] * ((A[:, :2] ** 2).sum() / 2.0 + grey_noise**2))


def _basis(patches: Float32Array) -> FloatArray:
    """What an image of patches (..., n, n) is made of, (..., n * n, 6): derivatives by u and v, itself, and a plane."""
    A = np.empty((*patches.shape, 6))
    A[..., 1], A[..., 0] = np.gradient(patches.astype(np.float64), axis=(-2, -1))
    v, u = np.indices(patches.shape[-2:]) - patches.shape[-1] // 2
    A[..., 2], A[..., 3], A[..., 4], A[..., 5] = patches, 1.0, u, v
    return A.reshape(*patches.shape[:-2], u.size, 6)


def to_shrunk(uv_px: FloatArray, shrunk: int) -> FloatArray:
    """Pixels of the image so many times smaller; the middle of the first pixel is at 0 in both."""
    return (uv_px + 0.5) / shrunk - 0.5


def from_shrunk(uv_px: FloatArray, shrunk: int) -> FloatArray:
    return (uv_px + 0.5) * shrunk - 0.5
