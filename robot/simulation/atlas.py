"""All textures of a world with their half-size copies in one picture, so that one lookup draws a whole frame."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from robot.simulation.texture_strokes import ImageArray
from robot.simulation.textures import TextureSpec, paint

NUM_LEVELS = 8  # level l is the texture at 2^-l of its size
ATLAS_WIDTH_PX = 8192
MAX_ATLAS_HEIGHT_PX = 32000  # cv2.remap counts source pixels in 16 bits
GUTTER_PX = 2  # replicated edge, so that interpolation never sees a neighbour
CACHE_LIMIT_BYTES = 3 * 1024**3


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """Baked textures. Texture i at level l covers pixels from origin_px[i, l] with texels_per_m[i, l]."""

    image: ImageArray  # (H, W, 3) BGR
    origin_px: npt.NDArray[np.float32]  # (N, NUM_LEVELS, 2) x, y of the first texel's centre minus half a texel
    texels_per_m: npt.NDArray[np.float32]  # (N, NUM_LEVELS)
    index: dict[TextureSpec, int]


def default_cache_dir() -> Path:
    """Where baked textures are kept for the next start."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sentinel" / "atlas"


def bake_atlas(specs: list[TextureSpec], cache_dir: Path | None) -> Atlas:
    """Paint all textures, or take the pixels from the cache; a broken or unwritable cache only costs time."""
    # Of a set, those that differ in their light alone would lie in the order of this process's hashes, and where a
    # texture lies decides the last bit of what is looked up in it.
    unique = sorted(dict.fromkeys(specs), key=lambda s: (-s.size_px[1], s.size_px[0], s.kind, s.seed))
    layout = _layout(unique)
    image = _read_cached(cache_dir, unique, layout.height_px) if cache_dir else None
    if image is None:
        image = _paint_all(unique, layout)
        if cache_dir:
            _write_cached(cache_dir, unique, image)
    # Texel k of level 0 covers [k, k+1) / density; its centre sits at pixel k: hence the half.
    origin_px = (layout.corner - 0.5).astype(np.float32)
    return Atlas(image, origin_px, layout.texels_per_m, {spec: i for i, spec in enumerate(unique)})


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    texels_per_m: npt.NDArray[np.float32]
    corner: npt.NDArray[np.int64]  # (N, NUM_LEVELS, 2) first pixel of the picture itself
    size: npt.NDArray[np.int64]  # (N, NUM_LEVELS, 2)
    height_px: int


def _layout(specs: list[TextureSpec]) -> _Layout:
    """Shelf packing, tallest first within each level."""
    n = len(specs)
    corner, size = np.zeros((n, NUM_LEVELS, 2), np.int64), np.zeros((n, NUM_LEVELS, 2), np.int64)
    density = np.zeros((n, NUM_LEVELS), np.float32)
    x = y = shelf = 0
    for level in range(NUM_LEVELS):
        for i, spec in enumerate(specs):
            w, h = (max(1, -(-s >> level)) if level else s for s in spec.size_px)
            if x + w + 2 * GUTTER_PX > ATLAS_WIDTH_PX:
                x, y, shelf = 0, y + shelf, 0
            corner[i, level], size[i, level] = (x + GUTTER_PX, y + GUTTER_PX), (w, h)
            density[i, level] = spec.texels_per_m / 2**level
            x, shelf = x + w + 2 * GUTTER_PX, max(shelf, h + 2 * GUTTER_PX)
    height = y + shelf
    if height > MAX_ATLAS_HEIGHT_PX:
        raise ValueError(f"the world's textures need {height} rows, the limit is {MAX_ATLAS_HEIGHT_PX}")
    return _Layout(density, corner, size, height)


def _paint_all(specs: list[TextureSpec], layout: _Layout) -> ImageArray:
    image = np.zeros((layout.height_px, ATLAS_WIDTH_PX, 3), np.uint8)
    for i, spec in enumerate(specs):
        level_image = paint(spec)
        for level in range(NUM_LEVELS):
            w, h = layout.size[i, level]
            if level:
                level_image = _halve(level_image, int(w), int(h))
            x, y = layout.corner[i, level] - GUTTER_PX
            padded = cv2.copyMakeBorder(level_image, GUTTER_PX, GUTTER_PX, GUTTER_PX, GUTTER_PX, cv2.BORDER_REPLICATE)
            image[y : y + padded.shape[0], x : x + padded.shape[1]] = padded
    return image


def _halve(image: ImageArray, width: int, height: int) -> ImageArray:
    """Average of 2x2 texels; an odd last row or column is repeated."""
    pad_h, pad_w = 2 * height - image.shape[0], 2 * width - image.shape[1]
    if pad_h > 0 or pad_w > 0:
        image = np.asarray(cv2.copyMakeBorder(image, 0, max(pad_h, 0), 0, max(pad_w, 0), cv2.BORDER_REPLICATE))
    return np.asarray(cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))


def _cache_path(cache_dir: Path, specs: list[TextureSpec]) -> Path:
    painters = hashlib.sha256()
    here = Path(__file__)
    for source in sorted([here, *here.parent.glob("texture*.py")]):
        painters.update(source.read_bytes())
    painters.update(repr(specs).encode())
    return cache_dir / f"{painters.hexdigest()[:24]}.npy"


def _read_cached(cache_dir: Path, specs: list[TextureSpec], height_px: int) -> ImageArray | None:
    path = _cache_path(cache_dir, specs)
    try:
        image = np.asarray(np.load(path, mmap_mode="r"))
        os.utime(path)
    except (OSError, ValueError, EOFError):
        return None
    return image if image.shape == (height_px, ATLAS_WIDTH_PX, 3) and image.dtype == np.uint8 else None


def _write_cached(cache_dir: Path, specs: list[TextureSpec], image: ImageArray) -> None:
    """Write beside and rename, so that a crash leaves no half file; drop the oldest beyond the limit."""
    with contextlib.suppress(OSError):
        cache_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=cache_dir, suffix=".tmp", delete=False) as file:
            np.save(file, image)
        Path(file.name).replace(_cache_path(cache_dir, specs))
        kept = 0
        for path in sorted(cache_dir.iterdir(), key=lambda p: -p.stat().st_mtime):
            kept += path.stat().st_size
            if kept > CACHE_LIMIT_BYTES:
                path.unlink(missing_ok=True)
