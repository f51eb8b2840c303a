"""Painters of furniture, books, pictures and clothes."""

from __future__ import annotations

import cv2
import numpy as np

from robot.simulation.texture_strokes import Canvas, scaled


def paint_wood(canvas: Canvas) -> None:
    """Veneer: grain along u."""
    rng, m = canvas.rng, canvas.texels_per_m
    base = [(70, 115, 165), (45, 65, 95), (120, 160, 195), (200, 205, 208), (60, 60, 62)][rng.integers(0, 5)]
    canvas.fill(base)
    canvas.speckle((1.5, 0.012 * m, 0.06 * m), 0.10, aspect=10.0)
    canvas.grain(420)
    canvas.marks(180, 3, 10)
    for _ in range(int(canvas.area_m2 * 25)):
        at, size = canvas.spot(), max(1, canvas.length_px(0.003, 0.012))
        dark = tuple(int(c * rng.uniform(0.3, 0.7)) for c in base)
        cv2.ellipse(canvas.image, at, (2 * size, size), 0, 0, 360, dark, -1, cv2.LINE_AA)
    canvas.edge(scaled(base, 0.7), int(0.006 * m))


def paint_drawers(canvas: Canvas) -> None:
    """Front of a cabinet: doors and drawers with handles, now and then a sticker."""
    paint_wood(canvas)
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    columns = max(1, round(width / m / rng.uniform(0.35, 0.6)))
    for c in range(columns):
        x0, x1 = c * width // columns, (c + 1) * width // columns
        rows = max(1, round(height / m / rng.uniform(0.2, 0.7)))
        for r in range(rows):
            y0, y1 = r * height // rows, (r + 1) * height // rows
            cv2.rectangle(image, (x0 + 2, y0 + 2), (x1 - 3, y1 - 3), (35, 40, 45), max(1, int(0.004 * m)))
            handle = (int((x0 + x1) / 2), int(y0 + 0.25 * (y1 - y0)))
            if rng.random() < 0.5:
                cv2.circle(image, handle, max(2, int(0.015 * m)), (190, 195, 200), -1, cv2.LINE_AA)
            else:
                half = int(0.06 * m)
                cv2.line(image, (handle[0] - half, handle[1]), (handle[0] + half, handle[1]), (200, 205, 205), 3)
            if rng.random() < 0.55:
                size = canvas.length_px(0.05, 0.16)
                sx, sy = int(rng.uniform(x0, max(x0 + 1, x1 - size))), int(rng.uniform(y0, max(y0 + 1, y1 - size)))
                sticker = canvas.part(sx, sy, size, size)
                if min(sticker.size_px) > 4:
                    sticker.fill(canvas.random_colour(120, 250))
                    sticker.shapes(5, 0.1 * size, 0.4 * size)


def paint_books(canvas: Canvas) -> None:
    """Open shelves full of books, boxes and knick-knacks: every spine differs."""
    paint_wood(canvas)
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    b, g, r = canvas.image[0, 0].tolist()
    canvas.image[:] = (canvas.image * 0.35).astype(np.uint8)
    shelf_h = rng.uniform(0.28, 0.38) * m
    board = max(2, int(0.02 * m))
    rows = max(1, round(height / shelf_h))
    shelf_h = height / rows
    for row in range(rows):
        floor_y = int((row + 1) * shelf_h) - board
        x = float(board)
        while x < width - board:
            if rng.random() < 0.07:
                x += rng.uniform(0.03, 0.12) * m
                continue
            book_w = rng.uniform(0.018, 0.055) * m
            book_h = rng.uniform(0.5, 0.92) * (shelf_h - board)
            if rng.random() < 0.08:  # a box or a toy
                book_w, book_h = rng.uniform(0.09, 0.2) * m, rng.uniform(0.3, 0.8) * (shelf_h - board)
            x1, y0 = int(min(x + book_w, width - board)), int(floor_y - book_h)
            spine = canvas.part(int(x), y0, x1 - int(x), floor_y - y0)
            if spine.size_px[1] > 2 and spine.size_px[0] > 1:
                paint_spine(spine)
            x = x1 + 1
        cv2.rectangle(canvas.image, (0, floor_y), (width, floor_y + board), (b, g, r), -1)
    canvas.edge((b, g, r), board // 2)
    canvas.speckle((1.5,), 0.05)


def paint_spine(spine: Canvas) -> None:
    """One book's back: colour, bands and a title."""
    rng, (width, height) = spine.rng, spine.size_px
    spine.fill(spine.random_colour(15, 245))
    for _ in range(int(rng.integers(1, 5))):
        y, band = int(rng.uniform(0, height)), max(1, int(rng.uniform(0.01, 0.12) * height))
        spine.image[y : y + band] = spine.random_colour(10, 250)
    upright = np.ascontiguousarray(np.rot90(spine.image))
    box = (int(0.15 * height), int(0.25 * width), int(0.6 * height), max(4, int(0.5 * width)))
    Canvas(upright, rng, spine.texels_per_m).letters(box, spine.random_colour(0, 255))
    spine.image[:] = np.rot90(upright, -1)
    spine.image[:, :1] = (spine.image[:, :1] * 0.5).astype(np.uint8)


def paint_fabric(canvas: Canvas) -> None:
    """Sofa, bed or curtain cloth: print, weave and creases."""
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    base = canvas.muted_colour(70, 210)
    canvas.fill(base)
    style = rng.integers(0, 4)
    if style == 0:  # check
        for stripes in (image, image.transpose(1, 0, 2)):
            position = 0.0
            while position < stripes.shape[1]:
                band = rng.uniform(0.01, 0.06) * m
                if rng.random() < 0.55:
                    stripe = stripes[:, int(position) : int(position + band)]
                    stripe[:] = (0.5 * stripe + 0.5 * np.array(canvas.muted_colour(40, 230))).astype(np.uint8)
                position += band
    elif style == 1:  # big print
        canvas.shapes(max(4, int(width * height / (0.13 * m) ** 2)), 0.02 * m, 0.1 * m)
    elif style == 2:  # small flowers
        for _ in range(int(width * height / (0.05 * m) ** 2)):
            at, size = canvas.spot(), max(1, canvas.length_px(0.004, 0.012))
            cv2.circle(image, at, size, canvas.random_colour(60, 250), -1, cv2.LINE_AA)
    else:
        canvas.speckle((0.1 * m, 0.03 * m), 0.16)
    dark = tuple(int(c * 0.55) for c in base)
    for _ in range(int(width / m * 6) + 3):  # creases
        x, y = canvas.spot()
        end = (int(x + rng.normal(0, 0.08 * m)), int(y + rng.normal(0, 0.08 * m)))
        cv2.line(image, (x, y), end, dark, max(1, int(0.003 * m)), cv2.LINE_AA)
    canvas.marks(650, 4, 15)
    canvas.speckle((1.3, 0.012 * m, 0.2 * m), 0.07)


def paint_box_print(canvas: Canvas) -> None:
    """Printed cardboard: cereal boxes, toy boxes, moving boxes."""
    rng, (width, height) = canvas.rng, canvas.size_px
    plain = rng.random() < 0.35
    base = (105, 150, 190) if plain else canvas.random_colour(40, 235)
    canvas.fill(base)
    if not plain:
        canvas.shapes(int(rng.integers(8, 18)), 0.06 * min(width, height), 0.5 * min(width, height))
    for _ in range(int(rng.integers(2, 6))):
        w, h = int(rng.uniform(0.25, 0.8) * width), int(rng.uniform(0.06, 0.2) * height)
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - h)))
        canvas.letters((x, y, w, h), canvas.random_colour(0, 255))
    for _ in range(3):
        canvas.paragraph()
    canvas.marks(250, 3, 10)
    x, y, bar = int(0.7 * width), int(0.8 * height), max(1, width // 60)
    for k in range(9):  # a bar code
        if rng.random() < 0.6:
            bottom_right = (x + (k + 1) * bar - 1, int(0.93 * height))
            cv2.rectangle(canvas.image, (x + k * bar, y), bottom_right, (20, 20, 20), -1)
    canvas.edge(scaled(base, 0.6), 1)
    canvas.speckle((1.5, 0.05 * canvas.texels_per_m), 0.05)


def paint_poster(canvas: Canvas) -> None:
    """A framed picture: landscape, abstract or printed poster; no two alike."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    style = rng.integers(0, 3)
    sky, ground = np.array(canvas.random_colour(60, 250), float), np.array(canvas.random_colour(20, 200), float)
    ramp = np.linspace(0, 1, height)[:, None, None]
    canvas.image[:] = (sky * (1 - ramp) + ground * ramp).astype(np.uint8)
    if style == 0:  # hills, sun, houses
        for layer in range(4):
            tone = tuple(int(c) for c in np.clip(ground * rng.uniform(0.4, 1.4), 0, 255))
            xs = np.linspace(0, width, 12)
            ys = height * (0.35 + 0.15 * layer) + rng.normal(0, 0.06 * height, 12)
            outline = np.concatenate([np.stack([xs, ys], 1), [[width, height], [0, height]]]).astype(np.int32)
            cv2.fillPoly(canvas.image, [outline], tone, cv2.LINE_AA)
        canvas.shapes(60, 0.01 * width, 0.1 * width)
    elif style == 1:
        canvas.shapes(30, 0.05 * width, 0.3 * width)
        canvas.shapes(70, 0.01 * width, 0.07 * width)
    else:
        canvas.shapes(9, 0.05 * width, 0.35 * width)
        canvas.shapes(40, 0.01 * width, 0.06 * width)
        for _ in range(3):
            canvas.paragraph()
        for k in range(int(rng.integers(3, 8))):
            box = (int(0.08 * width), int((0.05 + 0.12 * k) * height), int(0.8 * width), int(0.08 * height))
            canvas.letters(box, canvas.random_colour(0, 255))
    canvas.speckle((2.0, 0.03 * m), 0.08)
    canvas.edge([(30, 30, 32), (210, 215, 218), (50, 80, 115)][rng.integers(0, 3)], int(0.012 * m))


def paint_appliance(canvas: Canvas) -> None:
    """Fridge or washing machine: smooth front with magnets, notes and a dial."""
    image, rng, (width, height), m = canvas.image, canvas.rng, canvas.size_px, canvas.texels_per_m
    tone = int(rng.integers(185, 225))
    canvas.fill((tone, tone, tone))
    canvas.speckle((0.4 * m,), 0.03)
    cv2.rectangle(image, (3, 3), (width - 4, int(0.3 * height)), (110, 112, 115), max(1, int(0.004 * m)))
    if width > 0.7 * height:  # a drum
        centre, radius = (width // 2, int(0.6 * height)), int(0.28 * min(width, height))
        for r, colour in ((radius, (120, 120, 122)), (int(radius * 0.85), (45, 45, 48)), (radius // 2, (75, 70, 66))):
            cv2.circle(image, centre, r, colour, -1, cv2.LINE_AA)
    for _ in range(int(rng.integers(28, 45))):
        w, h = (int(v * m) for v in rng.uniform(0.025, 0.12, 2))
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - h)))
        note = canvas.part(x, y, w, h)
        if min(note.size_px) > 4:
            note.fill(canvas.random_colour(130, 250))
            note.shapes(5, 0.06 * w, 0.3 * w)
            note.letters((1, 1, w - 2, h // 3), (20, 20, 20))
    canvas.marks(60, 3, 9)
    canvas.edge((90, 90, 92), 2)


def paint_screen(canvas: Canvas) -> None:
    """A television that shows one picture."""
    paint_poster(canvas)
    canvas.edge((25, 25, 25), int(0.025 * canvas.texels_per_m))


def paint_clothes(canvas: Canvas) -> None:
    """Cloth with a print, as a person wears it."""
    paint_fabric(canvas)
    width, height = canvas.size_px
    box = (int(0.25 * width), int(0.35 * height), int(0.5 * width), int(0.15 * height))
    canvas.letters(box, canvas.random_colour(0, 255))


def paint_skin(canvas: Canvas) -> None:
    """A simple face and hair."""
    image, (width, height) = canvas.image, canvas.size_px
    canvas.fill((130, 165, 205))
    canvas.speckle((0.03 * canvas.texels_per_m,), 0.06)
    image[: height // 4] = canvas.random_colour(20, 90)
    for x in (0.32, 0.68):
        cv2.circle(image, (int(x * width), int(0.48 * height)), max(1, width // 14), (40, 40, 40), -1, cv2.LINE_AA)
    cv2.ellipse(image, (width // 2, int(0.75 * height)), (width // 5, height // 16), 0, 0, 180, (70, 70, 150), 2)


def paint_leaves(canvas: Canvas) -> None:
    """A dense pot plant."""
    rng, (width, height) = canvas.rng, canvas.size_px
    canvas.fill((25, 50, 30))
    for _ in range(int(width * height / (0.03 * canvas.texels_per_m) ** 2)):
        at, size = canvas.spot(), max(2, canvas.length_px(0.015, 0.05))
        green = (int(rng.integers(20, 90)), int(rng.integers(80, 200)), int(rng.integers(20, 120)))
        axes = (size, max(1, size // 3))
        cv2.ellipse(canvas.image, at, axes, float(rng.uniform(0, 180)), 0, 360, green, -1, cv2.LINE_AA)


def paint_checker(canvas: Canvas) -> None:
    """Squares of 0.1 m with known corners: for geometry tests."""
    i, j = ((np.arange(n) // (0.1 * canvas.texels_per_m)).astype(int) for n in canvas.size_px)
    canvas.image[:] = np.where((i[None, :] + j[:, None]) % 2 == 0, 40, 215)[:, :, None]
