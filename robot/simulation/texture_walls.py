"""Painters of walls, floors, rugs and ceilings."""

from __future__ import annotations

import cv2
import numpy as np

from robot.simulation.texture_strokes import Canvas, scaled


def paint_plain_wall(canvas: Canvas) -> None:
    """Nearly featureless: white paint with the faintest roller structure."""
    tone = int(canvas.rng.integers(196, 216))
    canvas.fill((tone - 6, tone - 2, tone))
    canvas.speckle((0.6 * canvas.texels_per_m, 0.15 * canvas.texels_per_m), 0.008)


def paint_wallpaper(canvas: Canvas) -> None:
    """Scattered motifs above, a skirting board below; the scatter never repeats."""
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    base = canvas.muted_colour(170, 225)
    canvas.fill(base)
    canvas.speckle((0.5 * m, 0.08 * m, 0.02 * m), 0.05)
    style = rng.integers(0, 4)
    ink = scaled(base, float(rng.uniform(0.35, 0.7)))
    if style == 0:  # uneven stripes
        x = 0.0
        while x < width:
            stripe = rng.uniform(0.02, 0.12) * m
            if rng.random() < 0.5:
                cv2.rectangle(image, (int(x), 0), (int(x + stripe), height), canvas.muted_colour(140, 225), -1)
            x += stripe
    count = int(width * height / (0.06 * m) ** 2 * rng.uniform(0.5, 0.9))
    for _ in range(count):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        size = m * rng.uniform(0.006, 0.028)
        colour = ink if rng.random() < 0.6 else canvas.muted_colour(90, 200)
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
    canvas.marks(260, 4, 14)
    canvas.speckle((2.0, 0.03 * m), 0.05)
    add_skirting(canvas)


def paint_plaster_wall(canvas: Canvas) -> None:
    """Painted wall with stains, scratches, sockets and marks."""
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    base = canvas.muted_colour(175, 225)
    canvas.fill(base)
    canvas.speckle((0.9 * m, 0.2 * m, 0.04 * m, 3.0), 0.07)
    canvas.marks(420, 4, 16)
    for _ in range(int(canvas.area_m2 * 60)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0.2 * height, height))
        dark = tuple(int(c * rng.uniform(0.55, 0.9)) for c in base)
        if rng.random() < 0.5:
            size = max(1, canvas.length_px(0.003, 0.014))
            cv2.ellipse(image, (x, y), (size, max(1, size // 2)), float(rng.uniform(0, 180)), 0, 360, dark, -1)
        else:
            end = (x + int(rng.normal(0, 0.04 * m)), y + int(rng.normal(0, 0.03 * m)))
            cv2.line(image, (x, y), end, dark, 1, cv2.LINE_AA)
    for _ in range(max(1, int(width / m * 0.8))):  # sockets
        size = int(0.08 * m)
        x, y = int(rng.uniform(0, max(1, width - size))), height - int(0.34 * m)
        cv2.rectangle(image, (x, y), (x + size, y + size), (235, 238, 240), -1)
        cv2.rectangle(image, (x, y), (x + size, y + size), (120, 120, 120), 1)
        cv2.circle(image, (x + size // 2, y + size // 2), size // 3, (170, 172, 175), -1, cv2.LINE_AA)
        for dx in (-1, 1):
            cv2.circle(image, (x + size // 2 + dx * size // 7, y + size // 2), max(1, size // 16), (40, 40, 40), -1)
    add_skirting(canvas)


def paint_brick_wall(canvas: Canvas) -> None:
    """Bricks of uneven tone and wear."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill((150, 155, 160))
    brick_h, brick_w = 0.075 * m, 0.24 * m
    base = [(70, 85, 150), (120, 140, 160), (165, 170, 175)][rng.integers(0, 3)]
    for row in range(int(height / brick_h) + 1):
        x = -rng.uniform(0, brick_w)
        while x < width:
            length = brick_w * rng.uniform(0.8, 1.15)
            colour = scaled(base, float(rng.uniform(0.6, 1.15)))
            top_left = (int(x + 1), int(row * brick_h + 1))
            cv2.rectangle(canvas.image, top_left, (int(x + length - 3), int((row + 1) * brick_h - 3)), colour, -1)
            x += length
    canvas.marks(420, 4, 14)
    canvas.speckle((2.0, 6.0, 0.05 * m), 0.10)
    add_skirting(canvas)


def paint_tiled_wall(canvas: Canvas) -> None:
    """Kitchen tiles of varying tone, some with a printed motif."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill((175, 178, 180))
    tile = 0.15 * m
    base = canvas.muted_colour(185, 235)
    accent = canvas.muted_colour(80, 170)
    for j in range(int(height / tile) + 1):
        for i in range(int(width / tile) + 1):
            tone = float(rng.uniform(0.86, 1.08))
            colour = scaled(accent if rng.random() < 0.12 else base, tone)
            x, y = int(i * tile), int(j * tile)
            right, bottom = int(x + tile - 2), int(y + tile - 2)
            cv2.rectangle(canvas.image, (x + 1, y + 1), (right, bottom), colour, -1)
            if rng.random() < 0.45:
                patch = canvas.part(x + 3, y + 3, right - x - 4, bottom - y - 4)
                if patch.image.size:
                    patch.shapes(int(rng.integers(4, 9)), 0.006 * m, 0.03 * m)
    canvas.marks(300, 3, 10)
    canvas.speckle((2.0, 0.1 * m), 0.04)
    add_skirting(canvas)


def add_skirting(canvas: Canvas) -> None:
    """A skirting board along the foot of a wall, and the shade of floor and ceiling corners."""
    width, height = canvas.size_px
    board = round(0.08 * canvas.texels_per_m)
    strip = canvas.part(0, height - board, width, board)
    strip.fill((225, 228, 230) if canvas.rng.random() < 0.5 else (70, 95, 125))
    strip.speckle((2.0, 0.02 * canvas.texels_per_m), 0.08, aspect=12.0)
    strip.image[:2] = (90, 92, 95)


def paint_planks(canvas: Canvas) -> None:
    """Parquet: planks of different tone with grain and knots."""
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill((60, 80, 100))
    plank_h = rng.uniform(0.09, 0.16) * m
    base = np.array([[70, 115, 165], [95, 140, 185], [60, 85, 120], [120, 150, 175]][rng.integers(0, 4)], dtype=float)
    for row in range(int(height / plank_h) + 1):
        x = -rng.uniform(0, 0.8) * m
        top, bottom = int(row * plank_h), int((row + 1) * plank_h)
        while x < width:
            length = rng.uniform(0.4, 1.2) * m
            colour = tuple(int(c) for c in np.clip(base * rng.uniform(0.72, 1.2), 0, 255))
            cv2.rectangle(image, (int(x), top), (int(x + length), bottom), colour, -1)
            cv2.line(image, (int(x), top), (int(x), bottom), (30, 40, 50), 1)
            x += length
        cv2.line(image, (0, top), (width, top), (30, 40, 50), 1)
    canvas.speckle((1.5, 0.012 * m, 0.05 * m), 0.10, aspect=9.0)
    canvas.grain(160)
    canvas.marks(160, 5, 18)
    for _ in range(int(canvas.area_m2 * 14)):  # knots
        at, size = canvas.spot(), max(1, canvas.length_px(0.004, 0.016))
        dark = tuple(int(c) for c in base * rng.uniform(0.25, 0.6))
        cv2.ellipse(image, at, (int(size * 1.7), size), 0, 0, 360, dark, -1, cv2.LINE_AA)


def paint_floor_tiles(canvas: Canvas) -> None:
    """Stone tiles with veins."""
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill((90, 92, 95))
    tile = rng.uniform(0.28, 0.42) * m
    base = np.array(canvas.muted_colour(130, 200), dtype=float)
    for j in range(int(height / tile) + 1):
        for i in range(int(width / tile) + 1):
            colour = tuple(int(c) for c in np.clip(base * rng.uniform(0.8, 1.15), 0, 255))
            x, y = int(i * tile), int(j * tile)
            cv2.rectangle(image, (x + 1, y + 1), (int(x + tile - 2), int(y + tile - 2)), colour, -1)
            for _ in range(int(rng.integers(2, 7))):
                points = np.cumsum(rng.normal(0, tile * 0.12, (6, 2)), axis=0) + rng.uniform(0, tile, 2) + [x, y]
                tone = tuple(int(c) for c in np.clip(base * rng.uniform(0.5, 1.3), 0, 255))
                cv2.polylines(image, [points.astype(np.int32)], False, tone, 1, cv2.LINE_AA)
    canvas.marks(450, 5, 20)  # terrazzo
    canvas.speckle((2.0, 0.02 * m, 0.15 * m), 0.08)


def paint_rug(canvas: Canvas) -> None:
    """A woven pattern that repeats, inside a border that repeats too."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    ground = canvas.muted_colour(60, 160)
    cell = max(6, canvas.length_px(0.14, 0.3))
    motif = np.full((cell, cell, 3), ground, np.uint8)
    Canvas(motif, rng, m).shapes(7, 0.1 * cell, 0.45 * cell)
    motif = np.maximum(motif, motif[:, ::-1]) if rng.random() < 0.5 else motif
    canvas.image[:] = np.tile(motif, (height // cell + 1, width // cell + 1, 1))[:height, :width]
    border = max(3, int(0.09 * m))
    for k, colour in enumerate(
        (canvas.muted_colour(40, 120), canvas.muted_colour(150, 230), canvas.muted_colour(40, 120))
    ):
        inset = k * border // 3
        corner = (width - 1 - inset, height - 1 - inset)
        cv2.rectangle(canvas.image, (inset, inset), corner, colour, max(1, border // 3))
    canvas.speckle((1.2, 0.03 * m), 0.12)


def paint_ceiling(canvas: Canvas) -> None:
    canvas.fill((205, 210, 212))
    canvas.speckle((0.7 * canvas.texels_per_m, 0.1 * canvas.texels_per_m), 0.04)
