"""Painters of walls, floors, rugs and ceilings: (generator, width px, height px, texels per m) to BGR pixels."""

from __future__ import annotations

import cv2
import numpy as np

from robot.simulation.texture_strokes import (
    ImageArray,
    draw_grain,
    draw_shapes,
    fill,
    muted_colour,
    scaled,
    scatter_marks,
    speckle,
)


def paint_plain_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Nearly featureless: white paint with the faintest roller structure."""
    tone = int(rng.integers(196, 216))
    image = fill(width, height, (tone - 6, tone - 2, tone))
    return speckle(image, rng, (0.6 * texels_per_m, 0.15 * texels_per_m), 0.008)


def paint_wallpaper(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Scattered motifs above, a skirting board below; the scatter never repeats."""
    base = muted_colour(rng, 170, 225)
    image = speckle(
        fill(width, height, base), rng, (0.5 * texels_per_m, 0.08 * texels_per_m, 0.02 * texels_per_m), 0.05
    )
    style = rng.integers(0, 4)
    ink = scaled(base, float(rng.uniform(0.35, 0.7)))
    if style == 0:  # uneven stripes
        x = 0.0
        while x < width:
            stripe = rng.uniform(0.02, 0.12) * texels_per_m
            if rng.random() < 0.5:
                cv2.rectangle(image, (int(x), 0), (int(x + stripe), height), muted_colour(rng, 140, 225), -1)
            x += stripe
    count = int(width * height / (0.06 * texels_per_m) ** 2 * rng.uniform(0.5, 0.9))
    for _ in range(count):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        size = texels_per_m * rng.uniform(0.006, 0.028)
        colour = ink if rng.random() < 0.6 else muted_colour(rng, 90, 200)
        if style in (0, 1):  # leaves
            axes = (max(1, int(size)), max(1, int(size * 0.4)))
            cv2.ellipse(image, (int(x), int(y)), axes, float(rng.uniform(0, 360)), 0, 360, colour, -1, cv2.LINE_AA)
        elif style == 2:  # crosses and squares
            r = max(1, int(size * 0.7))
            cv2.rectangle(image, (int(x) - r, int(y) - r), (int(x) + r, int(y) + r), colour, -1)
        else:  # twigs
            for _ in range(3):
                end = (int(x + rng.normal(0, size * 1.6)), int(y + rng.normal(0, size * 1.6)))
                cv2.line(image, (int(x), int(y)), end, colour, max(1, int(size * 0.25)), cv2.LINE_AA)
    scatter_marks(image, rng, texels_per_m, 260, (4, 14))
    image = speckle(image, rng, (2.0, 0.03 * texels_per_m), 0.05)
    return add_skirting(image, rng, texels_per_m)


def paint_plaster_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Painted wall with stains, scratches, sockets and marks."""
    base = muted_colour(rng, 175, 225)
    image = speckle(
        fill(width, height, base), rng, (0.9 * texels_per_m, 0.2 * texels_per_m, 0.04 * texels_per_m, 3.0), 0.07
    )
    scatter_marks(image, rng, texels_per_m, 420, (4, 16))
    for _ in range(int(width * height / texels_per_m**2 * 60)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0.2 * height, height))
        dark = tuple(int(c * rng.uniform(0.55, 0.9)) for c in base)
        if rng.random() < 0.5:
            size = max(1, int(texels_per_m * rng.uniform(0.003, 0.014)))
            cv2.ellipse(image, (x, y), (size, max(1, size // 2)), float(rng.uniform(0, 180)), 0, 360, dark, -1)
        else:
            end = (x + int(rng.normal(0, 0.04 * texels_per_m)), y + int(rng.normal(0, 0.03 * texels_per_m)))
            cv2.line(image, (x, y), end, dark, 1, cv2.LINE_AA)
    for _ in range(max(1, int(width / texels_per_m * 0.8))):  # sockets
        size = int(0.08 * texels_per_m)
        x, y = int(rng.uniform(0, max(1, width - size))), height - int(0.34 * texels_per_m)
        cv2.rectangle(image, (x, y), (x + size, y + size), (235, 238, 240), -1)
        cv2.rectangle(image, (x, y), (x + size, y + size), (120, 120, 120), 1)
        cv2.circle(image, (x + size // 2, y + size // 2), size // 3, (170, 172, 175), -1, cv2.LINE_AA)
        for dx in (-1, 1):
            cv2.circle(image, (x + size // 2 + dx * size // 7, y + size // 2), max(1, size // 16), (40, 40, 40), -1)
    return add_skirting(image, rng, texels_per_m)


def paint_brick_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Bricks of uneven tone and wear."""
    image = fill(width, height, (150, 155, 160))
    brick_h, brick_w = 0.075 * texels_per_m, 0.24 * texels_per_m
    hue = rng.integers(0, 3)
    for row in range(int(height / brick_h) + 1):
        x = -rng.uniform(0, brick_w)
        while x < width:
            length = brick_w * rng.uniform(0.8, 1.15)
            tone = float(rng.uniform(0.6, 1.15))
            base = [(70, 85, 150), (120, 140, 160), (165, 170, 175)][hue]
            colour = tuple(int(np.clip(c * tone, 0, 255)) for c in base)
            top_left = (int(x + 1), int(row * brick_h + 1))
            cv2.rectangle(image, top_left, (int(x + length - 3), int((row + 1) * brick_h - 3)), colour, -1)
            x += length
    scatter_marks(image, rng, texels_per_m, 420, (4, 14))
    return add_skirting(speckle(image, rng, (2.0, 6.0, 0.05 * texels_per_m), 0.10), rng, texels_per_m)


def paint_tiled_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Kitchen tiles of varying tone, some with a printed motif."""
    image = fill(width, height, (175, 178, 180))
    tile = 0.15 * texels_per_m
    base = muted_colour(rng, 185, 235)
    accent = muted_colour(rng, 80, 170)
    for j in range(int(height / tile) + 1):
        for i in range(int(width / tile) + 1):
            tone = float(rng.uniform(0.86, 1.08))
            colour = tuple(int(np.clip(c * tone, 0, 255)) for c in (accent if rng.random() < 0.12 else base))
            x, y = int(i * tile), int(j * tile)
            cv2.rectangle(image, (x + 1, y + 1), (int(x + tile - 2), int(y + tile - 2)), colour, -1)
            if rng.random() < 0.45:
                patch = image[y + 3 : int(y + tile - 3), x + 3 : int(x + tile - 3)]
                if patch.size:
                    draw_shapes(patch, rng, int(rng.integers(4, 9)), (0.006 * texels_per_m, 0.03 * texels_per_m))
    scatter_marks(image, rng, texels_per_m, 300, (3, 10))
    return add_skirting(speckle(image, rng, (2.0, 0.1 * texels_per_m), 0.04), rng, texels_per_m)


def add_skirting(image: ImageArray, rng: np.random.Generator, texels_per_m: float) -> ImageArray:
    """A skirting board along the foot of a wall, and the shade of floor and ceiling corners."""
    height, width = image.shape[:2]
    board = round(0.08 * texels_per_m)
    light = (225, 228, 230) if rng.random() < 0.5 else (70, 95, 125)
    strip = speckle(fill(width, board, light), rng, (2.0, 0.02 * texels_per_m), 0.08, aspect=12.0)
    image[height - board :] = strip
    image[height - board : height - board + 2] = (90, 92, 95)
    return image


def paint_planks(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Parquet: planks of different tone with grain and knots."""
    image = fill(width, height, (60, 80, 100))
    plank_h = rng.uniform(0.09, 0.16) * texels_per_m
    base = np.array([[70, 115, 165], [95, 140, 185], [60, 85, 120], [120, 150, 175]][rng.integers(0, 4)], dtype=float)
    for row in range(int(height / plank_h) + 1):
        x = -rng.uniform(0, 0.8) * texels_per_m
        while x < width:
            length = rng.uniform(0.4, 1.2) * texels_per_m
            colour = tuple(int(c) for c in np.clip(base * rng.uniform(0.72, 1.2), 0, 255))
            cv2.rectangle(image, (int(x), int(row * plank_h)), (int(x + length), int((row + 1) * plank_h)), colour, -1)
            cv2.line(image, (int(x), int(row * plank_h)), (int(x), int((row + 1) * plank_h)), (30, 40, 50), 1)
            x += length
        cv2.line(image, (0, int(row * plank_h)), (width, int(row * plank_h)), (30, 40, 50), 1)
    image = speckle(image, rng, (1.5, 0.012 * texels_per_m, 0.05 * texels_per_m), 0.10, aspect=9.0)
    draw_grain(image, rng, texels_per_m, 160)
    scatter_marks(image, rng, texels_per_m, 160, (5, 18))
    for _ in range(int(width * height / texels_per_m**2 * 14)):  # knots
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        size = max(1, int(texels_per_m * rng.uniform(0.004, 0.016)))
        dark = tuple(int(c) for c in base * rng.uniform(0.25, 0.6))
        cv2.ellipse(image, (x, y), (int(size * 1.7), size), 0, 0, 360, dark, -1, cv2.LINE_AA)
    return image


def paint_floor_tiles(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Stone tiles with veins."""
    image = fill(width, height, (90, 92, 95))
    tile = rng.uniform(0.28, 0.42) * texels_per_m
    base = np.array(muted_colour(rng, 130, 200), dtype=float)
    for j in range(int(height / tile) + 1):
        for i in range(int(width / tile) + 1):
            colour = tuple(int(c) for c in np.clip(base * rng.uniform(0.8, 1.15), 0, 255))
            x, y = int(i * tile), int(j * tile)
            cv2.rectangle(image, (x + 1, y + 1), (int(x + tile - 2), int(y + tile - 2)), colour, -1)
            for _ in range(int(rng.integers(2, 7))):
                points = np.cumsum(rng.normal(0, tile * 0.12, (6, 2)), axis=0) + rng.uniform(0, tile, 2) + [x, y]
                tone = tuple(int(c) for c in np.clip(base * rng.uniform(0.5, 1.3), 0, 255))
                cv2.polylines(image, [points.astype(np.int32)], False, tone, 1, cv2.LINE_AA)
    scatter_marks(image, rng, texels_per_m, 450, (5, 20))  # terrazzo
    return speckle(image, rng, (2.0, 0.02 * texels_per_m, 0.15 * texels_per_m), 0.08)


def paint_rug(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A woven pattern that repeats, inside a border that repeats too."""
    ground = muted_colour(rng, 60, 160)
    image = fill(width, height, ground)
    cell = max(6, int(rng.uniform(0.14, 0.3) * texels_per_m))
    motif = fill(cell, cell, ground)
    draw_shapes(motif, rng, 7, (0.1 * cell, 0.45 * cell))
    motif = np.maximum(motif, motif[:, ::-1]) if rng.random() < 0.5 else motif
    tiled = np.tile(motif, (height // cell + 1, width // cell + 1, 1))[:height, :width]
    image[:] = tiled
    border = max(3, int(0.09 * texels_per_m))
    for k, colour in enumerate((muted_colour(rng, 40, 120), muted_colour(rng, 150, 230), muted_colour(rng, 40, 120))):
        inset = k * border // 3
        cv2.rectangle(image, (inset, inset), (width - 1 - inset, height - 1 - inset), colour, max(1, border // 3))
    return speckle(image, rng, (1.2, 0.03 * texels_per_m), 0.12)


def paint_ceiling(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    image = fill(width, height, (205, 210, 212))
    return speckle(image, rng, (0.7 * texels_per_m, 0.1 * texels_per_m), 0.04)
