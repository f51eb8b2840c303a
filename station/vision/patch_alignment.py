"""Where in an image a small patch lies, to a part of a pixel, and how surely.

Source: Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56(3), 2004: the inverse compositional step.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray

Float32Array = npt.NDArray[np.float32]
MAX_STEPS, SETTLED_PX = 5, 0.01
MIN_GAIN = 0.3  # of the image's contrast over the patch's
MAX_SHIFT_PX = 1.0


def find_patch(
    image: Float32Array, patch: Float32Array, uv: FloatArray, ellipse: FloatArray, max_reach: int, least: float
) -> FloatArray | None:
    """Where in an ellipse the patch (n, n) is (2,), to a part of a pixel; None where it is not.

    Args:
        uv: (2,) px, the ellipse's middle, where off @ inv(ellipse) @ off < 1.
        max_reach: half a side of the searched rectangle, px, at most.
        least: correlation that counts.
    """
    half = patch.shape[0] // 2
    reach = np.minimum(np.ceil(np.sqrt(np.diag(ellipse))), max_reach)
    end = np.array(image.shape[::-1]) - 1 - half
    low = np.maximum(np.rint(uv) - reach, half).astype(int)
    high = np.minimum(np.rint(uv) + reach, end).astype(int)
    if (low > high).any():
        return None
    region = image[low[1] - half : high[1] + half + 1, low[0] - half : high[0] + half + 1]
    score = np.asarray(cv2.matchTemplate(region, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float64)
    off = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1) - uv
    inside = np.where(((off @ np.linalg.inv(ellipse)) * off).sum(axis=-1) < 1.0, score, -1.0)
    row, column = divmod(int(np.argmax(inside)), score.shape[1])
    return None if inside[row, column] < least else align(image, patch, low + np.array([column, row], np.float64))


def align(image: Float32Array, patch: Float32Array, place: FloatArray) -> FloatArray | None:
    """The place (2,) px near this one where the patch's (n, n) middle fits best; None where none is within a pixel.

    Least squares over the patch's pixels: image = gain (patch - gradient shift) + a plane. The plane takes what stands
    still while the camera turns: a lens gives less light towards its corners, and on a bare wall its slope exceeds the
    shades that are followed.
    """
    A = _basis(patch)
    solve, found = np.linalg.solve(A.T @ A, A.T)[:3], place
    for _ in range(MAX_STEPS):
        around = cv2.getRectSubPix(image, patch.shape, found.tolist())
        u, v, gain = solve @ np.asarray(around, dtype=np.float64).ravel()
        step = -np.array([u, v]) / max(gain, MIN_GAIN)
        found = found + step
        if np.abs(found - place).max() > MAX_SHIFT_PX:
            return None
        if np.abs(step).max() < SETTLED_PX:
            break
    return found


def noise_of(patch: Float32Array, grey_noise: float) -> FloatArray:
    """(2, 2): covariance of the place where the patch is found, beside that of one with strong gradients all around.

    What an image differs by from its patch grows with the gradients, so their directions count: along an edge a patch
    slides. Where they are weak, the image's own noise adds to it (grey_noise: grey levels for each pixel of error).
    """
    A = _basis(patch)
    return np.asarray(np.linalg.inv(A.T @ A)[:2, :2] * ((A[:, :2] ** 2).sum() / 2.0 + grey_noise**2))


def _basis(patch: Float32Array) -> FloatArray:
    """What an image of the patch (n, n) is made of, (n * n, 6): its derivatives by u and v, itself, and a plane."""
    by_v, by_u = np.gradient(patch.astype(np.float64))
    v, u = np.indices(patch.shape) - patch.shape[0] // 2
    return np.stack([by_u, by_v, patch, np.ones(patch.shape), u, v], axis=-1).reshape(-1, 6)


def to_shrunk(uv_px: FloatArray, shrunk: int) -> FloatArray:
    """Pixels of the image so many times smaller; the middle of the first pixel is at 0 in both."""
    return (uv_px + 0.5) / shrunk - 0.5


def from_shrunk(uv_px: FloatArray, shrunk: int) -> FloatArray:
    return (uv_px + 0.5) * shrunk - 0.5
