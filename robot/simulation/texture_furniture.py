"""Painters of furniture, books, pictures and clothes: (generator, width px, height px, texels per m) to BGR pixels."""

from __future__ import annotations

import cv2
import numpy as np

from robot.simulation.texture_strokes import (
    ImageArray,
    draw_grain,
    draw_letters,
    draw_paragraph,
    draw_shapes,
    fill,
    frame_edge,
    muted_colour,
    random_colour,
    scaled,
    scatter_marks,
    speckle,
)


def paint_wood(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Veneer: grain along u."""
    base = [(70, 115, 165), (45, 65, 95), (120, 160, 195), (200, 205, 208), (60, 60, 62)][rng.integers(0, 5)]
    image = speckle(fill(width, height, base), rng, (1.5, 0.012 * texels_per_m, 0.06 * texels_per_m), 0.10, aspect=10.0)
    draw_grain(image, rng, texels_per_m, 420)
    scatter_marks(image, rng, texels_per_m, 180, (3, 10))
    for _ in range(int(width * height / texels_per_m**2 * 25)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        size = max(1, int(texels_per_m * rng.uniform(0.003, 0.012)))
        dark = tuple(int(c * rng.uniform(0.3, 0.7)) for c in base)
        cv2.ellipse(image, (x, y), (2 * size, size), 0, 0, 360, dark, -1, cv2.LINE_AA)
    frame_edge(image, scaled(base, 0.7), int(0.006 * texels_per_m))
    return image


def paint_drawers(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Front of a cabinet: doors and drawers with handles, now and then a sticker."""
    image = paint_wood(rng, width, height, texels_per_m)
    columns = max(1, round(width / texels_per_m / rng.uniform(0.35, 0.6)))
    for c in range(columns):
        x0, x1 = c * width // columns, (c + 1) * width // columns
        rows = max(1, round(height / texels_per_m / rng.uniform(0.2, 0.7)))
        for r in range(rows):
            y0, y1 = r * height // rows, (r + 1) * height // rows
            cv2.rectangle(image, (x0 + 2, y0 + 2), (x1 - 3, y1 - 3), (35, 40, 45), max(1, int(0.004 * texels_per_m)))
            handle = (int((x0 + x1) / 2), int(y0 + 0.25 * (y1 - y0)))
            if rng.random() < 0.5:
                cv2.circle(image, handle, max(2, int(0.015 * texels_per_m)), (190, 195, 200), -1, cv2.LINE_AA)
            else:
                half = int(0.06 * texels_per_m)
                cv2.line(image, (handle[0] - half, handle[1]), (handle[0] + half, handle[1]), (200, 205, 205), 3)
            if rng.random() < 0.55:
                size = int(rng.uniform(0.05, 0.16) * texels_per_m)
                sx, sy = int(rng.uniform(x0, max(x0 + 1, x1 - size))), int(rng.uniform(y0, max(y0 + 1, y1 - size)))
                sticker = image[sy : sy + size, sx : sx + size]
                if min(sticker.shape[:2]) > 4:
                    sticker[:] = random_colour(rng, 120, 250)
                    draw_shapes(sticker, rng, 5, (0.1 * size, 0.4 * size))
    return image


def paint_books(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Open shelves full of books, boxes and knick-knacks: every spine differs."""
    wood = paint_wood(rng, width, height, texels_per_m)
    image = (wood * 0.35).astype(np.uint8)
    shelf_h = rng.uniform(0.28, 0.38) * texels_per_m
    board = max(2, int(0.02 * texels_per_m))
    rows = max(1, round(height / shelf_h))
    shelf_h = height / rows
    for r in range(rows):
        floor_y = int((r + 1) * shelf_h) - board
        x = float(board)
        while x < width - board:
            if rng.random() < 0.07:
                x += rng.uniform(0.03, 0.12) * texels_per_m
                continue
            book_w = rng.uniform(0.018, 0.055) * texels_per_m
            book_h = rng.uniform(0.5, 0.92) * (shelf_h - board)
            if rng.random() < 0.08:  # a box or a toy
                book_w, book_h = rng.uniform(0.09, 0.2) * texels_per_m, rng.uniform(0.3, 0.8) * (shelf_h - board)
            x1, y0 = int(min(x + book_w, width - board)), int(floor_y - book_h)
            spine = image[y0:floor_y, int(x) : x1]
            if spine.shape[0] > 2 and spine.shape[1] > 1:
                paint_spine(spine, rng)
            x = x1 + 1
        cv2.rectangle(image, (0, floor_y), (width, floor_y + board), tuple(int(c) for c in wood[0, 0]), -1)
    frame_edge(image, (int(wood[0, 0, 0]), int(wood[0, 0, 1]), int(wood[0, 0, 2])), board // 2)
    return speckle(image, rng, (1.5,), 0.05)


def paint_spine(spine: ImageArray, rng: np.random.Generator) -> None:
    """One book's back: colour, bands and a title."""
    height, width = spine.shape[:2]
    spine[:] = random_colour(rng, 15, 245)
    for _ in range(int(rng.integers(1, 5))):
        y, band = int(rng.uniform(0, height)), max(1, int(rng.uniform(0.01, 0.12) * height))
        spine[y : y + band] = random_colour(rng, 10, 250)
    upright = np.ascontiguousarray(np.rot90(spine))
    box = (int(0.15 * height), int(0.25 * width), int(0.6 * height), max(4, int(0.5 * width)))
    draw_letters(upright, rng, box, random_colour(rng, 0, 255))
    spine[:] = np.rot90(upright, -1)
    spine[:, :1] = (spine[:, :1] * 0.5).astype(np.uint8)


def paint_fabric(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Sofa, bed or curtain cloth: print, weave and creases."""
    base = muted_colour(rng, 70, 210)
    image = fill(width, height, base)
    style = rng.integers(0, 4)
    if style == 0:  # check
        for axis in (0, 1):
            position = 0.0
            while position < (width, height)[axis]:
                band = rng.uniform(0.01, 0.06) * texels_per_m
                if rng.random() < 0.55:
                    stripes = image if axis == 0 else image.transpose(1, 0, 2)
                    stripe = stripes[:, int(position) : int(position + band)]
                    stripe[:] = (0.5 * stripe + 0.5 * np.array(muted_colour(rng, 40, 230))).astype(np.uint8)
                position += band
    elif style == 1:  # big print
        count = max(4, int(width * height / (0.13 * texels_per_m) ** 2))
        draw_shapes(image, rng, count, (0.02 * texels_per_m, 0.1 * texels_per_m))
    elif style == 2:  # small flowers
        for _ in range(int(width * height / (0.05 * texels_per_m) ** 2)):
            x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
            size = max(1, int(rng.uniform(0.004, 0.012) * texels_per_m))
            cv2.circle(image, (x, y), size, random_colour(rng, 60, 250), -1, cv2.LINE_AA)
    else:
        image = speckle(image, rng, (0.1 * texels_per_m, 0.03 * texels_per_m), 0.16)
    for _ in range(int(width / texels_per_m * 6) + 3):  # creases
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        end = (int(x + rng.normal(0, 0.08 * texels_per_m)), int(y + rng.normal(0, 0.08 * texels_per_m)))
        dark = tuple(int(c * 0.55) for c in base)
        cv2.line(image, (x, y), end, dark, max(1, int(0.003 * texels_per_m)), cv2.LINE_AA)
    scatter_marks(image, rng, texels_per_m, 650, (4, 15))
    return speckle(image, rng, (1.3, 0.012 * texels_per_m, 0.2 * texels_per_m), 0.07)


def paint_box_print(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Printed cardboard: cereal boxes, toy boxes, moving boxes."""
    plain = rng.random() < 0.35
    base = (105, 150, 190) if plain else random_colour(rng, 40, 235)
    image = fill(width, height, base)
    if not plain:
        draw_shapes(image, rng, int(rng.integers(8, 18)), (0.06 * min(width, height), 0.5 * min(width, height)))
    for _ in range(int(rng.integers(2, 6))):
        w, h = int(rng.uniform(0.25, 0.8) * width), int(rng.uniform(0.06, 0.2) * height)
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - h)))
        draw_letters(image, rng, (x, y, w, h), random_colour(rng, 0, 255))
    for _ in range(3):
        draw_paragraph(image, rng, texels_per_m)
    scatter_marks(image, rng, texels_per_m, 250, (3, 10))
    x, y, bar = int(0.7 * width), int(0.8 * height), max(1, width // 60)
    for k in range(9):  # a bar code
        if rng.random() < 0.6:
            cv2.rectangle(image, (x + k * bar, y), (x + (k + 1) * bar - 1, int(0.93 * height)), (20, 20, 20), -1)
    frame_edge(image, scaled(base, 0.6), 1)
    return speckle(image, rng, (1.5, 0.05 * texels_per_m), 0.05)


def paint_poster(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A framed picture: landscape, abstract or printed poster; no two alike."""
    style = rng.integers(0, 3)
    sky, ground = np.array(random_colour(rng, 60, 250), float), np.array(random_colour(rng, 20, 200), float)
    ramp = np.linspace(0, 1, height)[:, None, None]
    image = np.broadcast_to(sky * (1 - ramp) + ground * ramp, (height, width, 3)).astype(np.uint8).copy()
    if style == 0:  # hills, sun, houses
        for layer in range(4):
            tone = tuple(int(c) for c in np.clip(ground * rng.uniform(0.4, 1.4), 0, 255))
            xs = np.linspace(0, width, 12)
            ys = height * (0.35 + 0.15 * layer) + rng.normal(0, 0.06 * height, 12)
            outline = np.concatenate([np.stack([xs, ys], 1), [[width, height], [0, height]]]).astype(np.int32)
            cv2.fillPoly(image, [outline], tone, cv2.LINE_AA)
        draw_shapes(image, rng, 60, (0.01 * width, 0.1 * width))
    elif style == 1:
        draw_shapes(image, rng, 30, (0.05 * width, 0.3 * width))
        draw_shapes(image, rng, 70, (0.01 * width, 0.07 * width))
    else:
        draw_shapes(image, rng, 9, (0.05 * width, 0.35 * width))
        draw_shapes(image, rng, 40, (0.01 * width, 0.06 * width))
        for _ in range(3):
            draw_paragraph(image, rng, texels_per_m)
        for k in range(int(rng.integers(3, 8))):
            box = (int(0.08 * width), int((0.05 + 0.12 * k) * height), int(0.8 * width), int(0.08 * height))
            draw_letters(image, rng, box, random_colour(rng, 0, 255))
    image = speckle(image, rng, (2.0, 0.03 * texels_per_m), 0.08)
    frame_edge(image, [(30, 30, 32), (210, 215, 218), (50, 80, 115)][rng.integers(0, 3)], int(0.012 * texels_per_m))
    return image


def paint_appliance(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Fridge or washing machine: smooth front with magnets, notes and a dial."""
    tone = int(rng.integers(185, 225))
    image = speckle(fill(width, height, (tone, tone, tone)), rng, (0.4 * texels_per_m,), 0.03)
    cv2.rectangle(image, (3, 3), (width - 4, int(0.3 * height)), (110, 112, 115), max(1, int(0.004 * texels_per_m)))
    if width > 0.7 * height:  # a drum
        centre, radius = (width // 2, int(0.6 * height)), int(0.28 * min(width, height))
        for r, colour in ((radius, (120, 120, 122)), (int(radius * 0.85), (45, 45, 48)), (radius // 2, (75, 70, 66))):
            cv2.circle(image, centre, r, colour, -1, cv2.LINE_AA)
    for _ in range(int(rng.integers(28, 45))):
        w, h = (int(v * texels_per_m) for v in rng.uniform(0.025, 0.12, 2))
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - h)))
        note = image[y : y + h, x : x + w]
        if min(note.shape[:2]) > 4:
            note[:] = random_colour(rng, 130, 250)
            draw_shapes(note, rng, 5, (0.06 * w, 0.3 * w))
            draw_letters(note, rng, (1, 1, w - 2, h // 3), (20, 20, 20))
    scatter_marks(image, rng, texels_per_m, 60, (3, 9))
    frame_edge(image, (90, 90, 92), 2)
    return image


def paint_screen(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A television that shows one picture."""
    image = paint_poster(rng, width, height, texels_per_m)
    frame_edge(image, (25, 25, 25), int(0.025 * texels_per_m))
    return image


def paint_clothes(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Cloth with a print, as a person wears it."""
    image = paint_fabric(rng, width, height, texels_per_m)
    w, h = int(0.5 * width), int(0.15 * height)
    draw_letters(image, rng, (int(0.25 * width), int(0.35 * height), w, h), random_colour(rng, 0, 255))
    return image


def paint_skin(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A simple face and hair."""
    image = speckle(fill(width, height, (130, 165, 205)), rng, (0.03 * texels_per_m,), 0.06)
    image[: height // 4] = random_colour(rng, 20, 90)
    for x in (0.32, 0.68):
        cv2.circle(image, (int(x * width), int(0.48 * height)), max(1, width // 14), (40, 40, 40), -1, cv2.LINE_AA)
    cv2.ellipse(image, (width // 2, int(0.75 * height)), (width // 5, height // 16), 0, 0, 180, (70, 70, 150), 2)
    return image


def paint_leaves(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A dense pot plant."""
    image = fill(width, height, (25, 50, 30))
    for _ in range(int(width * height / (0.03 * texels_per_m) ** 2)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        size = max(2, int(rng.uniform(0.015, 0.05) * texels_per_m))
        green = (int(rng.integers(20, 90)), int(rng.integers(80, 200)), int(rng.integers(20, 120)))
        axes = (size, max(1, size // 3))
        cv2.ellipse(image, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, green, -1, cv2.LINE_AA)
    return image


def paint_checker(_rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Squares of 0.1 m with known corners: for geometry tests."""
    cell = 0.1 * texels_per_m
    i = (np.arange(width) // cell).astype(int)
    j = (np.arange(height) // cell).astype(int)
    grey = np.where((i[None, :] + j[:, None]) % 2 == 0, 40, 215).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
