"""A whole image in 512 numbers: how much of each edge direction and size there is in each of 16 parts of it.

For comparison only: the product recognises images by local features.
Source: Oliva and Torralba, "Modeling the Shape of the Scene", IJCV 42(3), 2001.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.model.frames import ImageArray

SIZE = 128  # px: images are made square
PADDING = 32  # px, mirrored: else the borders would be edges
SCALES, DIRECTIONS, PARTS = 4, 8, 4
CONTRAST_CYCLES = 4.0  # per image: slower changes of brightness are light, not structure


class GistDescriptor:
    """Holds the filters, so that they are made once."""

    def __init__(self) -> None:
        self._whitening = _whitening()
        self._filters = _filters()

    def describe(self, grey: ImageArray) -> npt.NDArray[np.float32]:
        """(512,) of unit length, of an image (H, W); all zero for one without structure."""
        image = cv2.resize(grey, (SIZE, SIZE), interpolation=cv2.INTER_AREA).astype(np.float64)
        spectrum = np.fft.fft2(self._normalise(np.log1p(image)))
        parts = [_means(np.abs(np.fft.ifft2(spectrum * band))) for band in self._filters]
        gist = np.concatenate(parts).astype(np.float32)
        length = float(np.linalg.norm(gist))
        return gist / np.float32(length) if length > 1e-9 else gist

    def _normalise(self, image: FloatArray) -> FloatArray:
        """Padded, without the light's slow changes, with equal contrast everywhere."""
        padded = np.pad(image, PADDING, mode="symmetric")
        detail = padded - np.fft.ifft2(np.fft.fft2(padded) * self._whitening).real
        local = np.sqrt(np.abs(np.fft.ifft2(np.fft.fft2(detail**2) * self._whitening).real))
        return detail / (0.2 + local)


def _frequencies() -> tuple[FloatArray, FloatArray]:
    """(N, N) each: cycles over the padded image, and their direction in radians."""
    f = np.fft.fftfreq(SIZE + 2 * PADDING) * (SIZE + 2 * PADDING)
    fx, fy = np.meshgrid(f, f)
    return np.hypot(fx, fy), np.arctan2(fy, fx)


def _whitening() -> FloatArray:
    radius, _ = _frequencies()
    return np.exp(-((radius / CONTRAST_CYCLES) ** 2) * np.log(2))


def _filters() -> list[FloatArray]:
    """Gabor filters in the Fourier domain: an octave and 22.5 degrees from one to the next."""
    radius, angle = _frequencies()
    filters = []
    for scale in range(SCALES):
        centre = 0.3 * (SIZE + 2 * PADDING) / 2**scale
        for direction in range(DIRECTIONS):
            off = angle - np.pi * direction / DIRECTIONS
            off = (off + np.pi) % (2 * np.pi) - np.pi
            radial = np.exp(-10 * 0.35 * (radius / centre - 1) ** 2)
            filters.append(radial * np.exp(-2 * np.pi * 0.25 * DIRECTIONS**2 / 8 * off**2))
    return filters


def _means(magnitude: FloatArray) -> FloatArray:
    """(16,) mean over each of 4 x 4 parts of the image without its padding."""
    inside = magnitude[PADDING:-PADDING, PADDING:-PADDING]
    side = SIZE // PARTS
    return inside.reshape(PARTS, side, PARTS, side).mean(axis=(1, 3)).ravel()
