"""Painters of plain homes: walls and large pieces are faint, what people keep in them has print, weave and grain."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from robot.simulation.texture_plain_things import draw_pattern, draw_wood_grain, paint_bottle, paint_bowl, paint_spines
from robot.simulation.texture_strokes import Canvas, Colour, scaled

WHITE: Colour = (226, 230, 231)


def _tone(canvas: Canvas, low: int, high: int, warmth: int = 8) -> Colour:
    """A grey with a hint of warmth."""
    grey = int(canvas.rng.integers(low, high))
    tint = int(canvas.rng.integers(0, warmth + 1))
    return grey - tint, grey - tint // 3, grey


def _soft_patches(canvas: Canvas, cell_m: float, strength: float) -> None:
    """Brightness that changes slowly, as paint, cloth and wear have it."""
    canvas.speckle((cell_m * canvas.texels_per_m,), strength)


def _specks(canvas: Canvas, per_m2: float, smallest_mm: float, largest_mm: float, tone: float) -> None:
    """A few small marks of use, darker by the given factor."""
    image = canvas.image
    for _ in range(int(per_m2 * canvas.area_m2)):
        x, y = canvas.spot()
        b, g, r = (int(c) for c in image[y, x])
        size = max(1, canvas.length_px(smallest_mm * 5e-4, largest_mm * 5e-4))
        turn = float(canvas.rng.uniform(0, 180))
        cv2.ellipse(image, (x, y), (2 * size, size), turn, 0, 360, scaled((b, g, r), tone), -1, cv2.LINE_AA)


def paint_white_paint(canvas: Canvas) -> None:
    """A painted wall above a low skirting board, now and then a scuff or a nail's hole."""
    base = [(222, 228, 230), (208, 222, 228), (205, 214, 214), (196, 208, 222)][int(canvas.rng.integers(0, 4))]
    canvas.fill(base)
    _soft_patches(canvas, 1.1, 0.012)
    _, height = canvas.size_px
    for _ in range(int(canvas.area_m2 * 0.25)):
        x, y = canvas.spot()
        reach = max(2, canvas.length_px(0.01, 0.04))
        cv2.ellipse(canvas.image, (x, y), (2 * reach, reach), 0, 0, 360, scaled(base, 0.96), -1, cv2.LINE_AA)
    _specks(canvas, 2.5, 4, 12, 0.62)
    board = max(2, int(0.06 * canvas.texels_per_m))
    canvas.image[height - board :] = scaled(base, 1.04)
    canvas.image[height - board - 1 : height - board + 1] = scaled(base, 0.82)


def paint_white_ceiling(canvas: Canvas) -> None:
    canvas.fill((226, 230, 230))
    _soft_patches(canvas, 1.5, 0.01)


def paint_laminate(canvas: Canvas) -> None:
    """Wide boards of nearly one tone with faint joints."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    base = [(128, 158, 182), (150, 166, 176), (92, 122, 152)][int(rng.integers(0, 3))]
    canvas.fill(base)
    board = 0.19 * m
    for row in range(int(height / board) + 1):
        x, top, bottom = -float(rng.uniform(0, 1.2)) * m, int(row * board), int((row + 1) * board)
        while x < width:
            length = 1.2 * m
            colour = scaled(base, float(rng.uniform(0.88, 1.1)))
            cv2.rectangle(canvas.image, (int(x), top), (int(x + length), bottom), colour, -1)
            cv2.line(canvas.image, (int(x), top), (int(x), bottom), scaled(base, 0.72), 2)
            x += length
        cv2.line(canvas.image, (0, top), (width, top), scaled(base, 0.76), 2)
    canvas.speckle((0.02 * m, 0.008 * m), 0.2, aspect=10.0)
    _specks(canvas, 12, 5, 14, 0.55)


def paint_carpet(canvas: Canvas) -> None:
    """One colour, trodden a little darker here and there."""
    canvas.fill(canvas.muted_colour(120, 180))
    _soft_patches(canvas, 0.6, 0.05)
    canvas.speckle((0.015 * canvas.texels_per_m,), 0.2)
    _specks(canvas, 12, 6, 20, 0.6)


def paint_lino(canvas: Canvas) -> None:
    """Linoleum or poured floor: a faint marbling."""
    canvas.fill(_tone(canvas, 135, 185))
    _soft_patches(canvas, 0.5, 0.04)
    canvas.speckle((0.09 * canvas.texels_per_m, 0.02 * canvas.texels_per_m), 0.2)
    _specks(canvas, 12, 6, 20, 0.6)


def paint_large_tiles(canvas: Canvas) -> None:
    """Large tiles with thin joints in nearly their own colour."""
    width, height = canvas.size_px
    base = _tone(canvas, 160, 205)
    canvas.fill(base)
    side = int(0.6 * canvas.texels_per_m)
    for x in range(side, width, side):
        cv2.line(canvas.image, (x, 0), (x, height), scaled(base, 0.6), 2)
    for y in range(side, height, side):
        cv2.line(canvas.image, (0, y), (width, y), scaled(base, 0.6), 2)
    canvas.speckle((0.1 * canvas.texels_per_m, 0.025 * canvas.texels_per_m), 0.18)
    _specks(canvas, 12, 6, 16, 0.6)


def paint_plain_rug(canvas: Canvas) -> None:
    """Woven in two tones of one colour: a pattern inside a border, fringes at two ends."""
    base, m = canvas.muted_colour(80, 190), canvas.texels_per_m
    width, height = canvas.size_px
    canvas.fill(base)
    draw_pattern(canvas, scaled(base, 0.66), canvas.length_px(0.1, 0.2))
    _soft_patches(canvas, 0.25, 0.05)
    inset = int(0.1 * m)
    cv2.rectangle(canvas.image, (inset, inset), (width - inset, height - inset), scaled(base, 0.75), max(2, inset // 3))
    for y in range(0, height, max(4, int(0.05 * m))):
        for x in (0, width - int(0.05 * m)):
            canvas.image[y : y + max(1, int(0.012 * m)), x : x + int(0.05 * m)] = scaled(base, 1.25)


def paint_lacquer(canvas: Canvas) -> None:
    """A smooth board of white, grey or wood."""
    tone = int(canvas.rng.integers(0, 4))
    base = [(224, 228, 229), (176, 180, 182), (150, 182, 204), (84, 100, 118)][tone]
    canvas.fill(base)
    if tone >= 2:
        draw_wood_grain(canvas, base)
    canvas.speckle((0.03 * canvas.texels_per_m,), 0.12, aspect=6.0)
    _specks(canvas, 8, 4, 10, 0.6)
    canvas.edge(scaled(base, 0.85), 1)


def paint_fronts(canvas: Canvas) -> None:
    """Equal fronts side by side, white or of wood, thin gaps between them, a small handle each; drawers if low."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    tone = int(rng.integers(0, 4))
    base = [WHITE, (205, 214, 218), (172, 178, 180), (150, 180, 200)][tone]
    canvas.fill(base)
    if tone >= 2:
        draw_wood_grain(canvas, base)
    _soft_patches(canvas, 0.6, 0.012)
    _specks(canvas, 4, 4, 10, 0.6)
    is_low = height < 1.2 * m
    columns, rows = max(1, round(width / m / 0.55)), max(1, round(height / m / 0.28)) if is_low else 1
    for c in range(columns):
        for r in range(rows):
            x0, y0 = c * width // columns, r * height // rows
            front = canvas.part(x0, y0, (c + 1) * width // columns - x0, (r + 1) * height // rows - y0)
            _draw_front(front, base, is_low)


def _draw_front(canvas: Canvas, base: Colour, is_drawer: bool) -> None:
    """The gap around one front, its sunk panel, its handle: lying on a drawer, upright on a door."""
    (width, height), m = canvas.size_px, canvas.texels_per_m
    canvas.edge(scaled(base, 0.45), 2)
    frame = int(0.045 * m)
    cv2.rectangle(canvas.image, (frame, frame), (width - 1 - frame, height - 1 - frame), scaled(base, 0.7), 2)
    half, at = int(0.05 * m), (width // 2, height // 3) if is_drawer else (width - int(0.05 * m), height // 2)
    reach = (half, 0) if is_drawer else (0, half)
    ends = (at[0] - reach[0], at[1] - reach[1]), (at[0] + reach[0], at[1] + reach[1])
    cv2.line(canvas.image, *ends, scaled(base, 0.35), max(2, int(0.013 * m)), cv2.LINE_AA)


def paint_soft_cloth(canvas: Canvas) -> None:
    """Upholstery and bed linen of one colour, some with broad stripes; seams and a few shallow creases."""
    base = canvas.muted_colour(105, 215)
    canvas.fill(base)
    if canvas.rng.random() < 0.4:
        stripe = max(2, int(0.07 * canvas.texels_per_m))
        for x in range(0, canvas.size_px[0], 2 * stripe):
            canvas.image[:, x : x + stripe] = scaled(base, 0.78)
    _soft_patches(canvas, 0.35, 0.06)
    canvas.speckle((0.02 * canvas.texels_per_m,), 0.24)
    for _ in range(2 + int(1.5 * canvas.area_m2)):
        x, y = canvas.spot()
        end = (int(x + canvas.rng.normal(0, 0.15 * canvas.texels_per_m)), y + canvas.length_px(-0.05, 0.05))
        cv2.line(canvas.image, (x, y), end, scaled(base, 0.9), max(2, canvas.length_px(0.006, 0.014)), cv2.LINE_AA)
    canvas.image[:] = cv2.GaussianBlur(canvas.image, (0, 0), 0.006 * canvas.texels_per_m + 0.5)
    canvas.edge(scaled(base, 0.86), max(1, int(0.004 * canvas.texels_per_m)))


def paint_curtain(canvas: Canvas) -> None:
    """A printed pattern that repeats; folds from top to bottom, unevenly spaced."""
    width, _ = canvas.size_px
    base = canvas.muted_colour(160, 225)
    canvas.fill(base)
    draw_pattern(canvas, scaled(base, 0.72), canvas.length_px(0.1, 0.18))
    x = np.arange(width) / canvas.texels_per_m
    wave = np.zeros(width)
    for period in (0.11, 0.17, 0.29):
        phase, stretch = canvas.rng.uniform(0, 2 * np.pi), canvas.rng.uniform(0.9, 1.1)
        wave += np.sin(2 * np.pi * x / (period * stretch) + phase)
    canvas.image[:] = np.clip(canvas.image * (1 + 0.05 * wave[:, None]), 0, 255).astype(np.uint8)


def paint_door_leaf(canvas: Canvas) -> None:
    """A smooth white door in its frame: every door of a home is this one."""
    width, height = canvas.size_px
    m, base = canvas.texels_per_m, WHITE
    canvas.fill(base)
    _soft_patches(canvas, 0.8, 0.01)
    frame = int(0.07 * m)
    cv2.rectangle(canvas.image, (0, -2), (width - 1, height + 2), scaled(base, 0.85), 2)
    cv2.rectangle(canvas.image, (frame, frame), (width - 1 - frame, height + 2), scaled(base, 0.66), 2)
    for low_m, high_m in ((0.15, 0.85), (1.1, 1.85)):  # two sunk panels
        ends = (2 * frame, height - int(high_m * m)), (width - 1 - 2 * frame, height - int(low_m * m))
        cv2.rectangle(canvas.image, *ends, scaled(base, 0.66), 3)
    at = (width - frame - int(0.09 * m), height - int(1.03 * m))
    cv2.circle(canvas.image, at, int(0.02 * m), (150, 154, 156), -1, cv2.LINE_AA)
    cv2.line(canvas.image, at, (at[0] - int(0.11 * m), at[1]), (140, 144, 146), max(2, int(0.016 * m)), cv2.LINE_AA)
    cv2.circle(canvas.image, (at[0], at[1] + int(0.08 * m)), max(2, int(0.008 * m)), (90, 92, 94), -1, cv2.LINE_AA)


def paint_radiator(canvas: Canvas) -> None:
    """A panel radiator: shallow ribs, the same at every few centimetres."""
    width, height = canvas.size_px
    canvas.fill(WHITE)
    top, bottom, step = int(0.12 * height), int(0.88 * height), 0.05 * canvas.texels_per_m
    for k in range(1, int(width / step)):
        x = int(k * step)
        cv2.line(canvas.image, (x, top), (x, bottom), scaled(WHITE, 0.8), max(1, int(0.2 * step)))
    canvas.image[:] = cv2.GaussianBlur(canvas.image, (0, 0), 0.003 * canvas.texels_per_m)
    canvas.edge(scaled(WHITE, 0.7), 1)


def paint_window_day(canvas: Canvas) -> None:
    """Panes almost burnt out by the sky, what is outside pale and out of focus; a white frame."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.image[:] = np.linspace(255, 238, height)[:, None, None].astype(np.uint8)
    for _ in range(5):  # trees and houses
        x, w = int(rng.uniform(-0.2, 1) * width), int(rng.uniform(0.2, 0.6) * width)
        y, colour = int(rng.uniform(0.45, 0.9) * height), scaled((205, 215, 205), float(rng.uniform(0.9, 1.1)))
        if rng.random() < 0.5:
            cv2.ellipse(canvas.image, (x, height), (w // 2, height - y), 0, 0, 360, colour, -1)
        else:
            cv2.rectangle(canvas.image, (x, y), (x + w, height), colour, -1)
    canvas.image[:] = cv2.GaussianBlur(canvas.image, (0, 0), 0.03 * m)
    _window_frame(canvas, (236, 240, 240))


def paint_window_night(canvas: Canvas) -> None:
    """Dark panes with a few far lights and the faint mirror of the room."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill((26, 20, 18))
    for _ in range(int(rng.integers(1, 6))):
        cv2.circle(canvas.image, canvas.spot(), max(1, canvas.length_px(0.004, 0.01)), (110, 170, 200), -1, cv2.LINE_AA)
    x, y = int(rng.uniform(0.2, 0.6) * width), int(rng.uniform(0.3, 0.7) * height)
    cv2.ellipse(canvas.image, (x, y), (int(0.15 * width), int(0.1 * height)), 0, 0, 360, (44, 52, 58), -1)
    canvas.image[:] = cv2.GaussianBlur(canvas.image, (0, 0), 0.012 * m)
    _window_frame(canvas, (88, 92, 94))  # lit by the lamps of the room only


def _window_frame(canvas: Canvas, colour: Colour) -> None:
    width, height = canvas.size_px
    bar = max(2, int(0.06 * canvas.texels_per_m))
    for x in (0, width // 2 - bar // 2, width - bar):
        cv2.rectangle(canvas.image, (x, 0), (x + bar, height), colour, -1)
        cv2.line(canvas.image, (x + bar, 0), (x + bar, height), scaled(colour, 0.8), 1)
    for y in (0, height - bar):
        cv2.rectangle(canvas.image, (0, y), (width, y + bar), colour, -1)
    canvas.edge(scaled(colour, 0.75), 1)


def paint_print(canvas: Canvas) -> None:
    """A framed print: large pale shapes and a few small dark ones inside a white mount."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill(WHITE)
    mount = int(0.18 * min(width, height))
    inner = canvas.part(mount, mount, width - 2 * mount, height - 2 * mount)
    inner.fill(inner.muted_colour(150, 225))
    for count, low_m, high_m, low, high in ((int(rng.integers(3, 6)), 0.04, 0.14, 90, 220), (14, 0.008, 0.03, 40, 160)):
        for _ in range(count):
            size = (inner.length_px(low_m, high_m), inner.length_px(low_m, high_m))
            turn, colour = float(rng.uniform(0, 180)), inner.muted_colour(low, high)
            cv2.ellipse(inner.image, inner.spot(), size, turn, 0, 360, colour, -1, cv2.LINE_AA)
    canvas.edge([(40, 42, 44), (160, 190, 205), (215, 220, 222)][int(rng.integers(0, 3))], int(0.012 * m))


def paint_socket(canvas: Canvas) -> None:
    """A pair of wall sockets: the same everywhere."""
    width, height = canvas.size_px
    canvas.fill((236, 239, 240))
    for middle in (width // 4, 3 * width // 4):
        cv2.circle(canvas.image, (middle, height // 2), int(0.36 * height), (196, 199, 201), -1, cv2.LINE_AA)
        for x in (middle - height // 8, middle + height // 8):
            cv2.circle(canvas.image, (x, height // 2), max(1, height // 20), (60, 60, 62), -1, cv2.LINE_AA)
    canvas.edge((170, 173, 175), 1)


def paint_dark_glass(canvas: Canvas) -> None:
    """A television that is off, an oven's door."""
    canvas.fill((30, 29, 28))
    _soft_patches(canvas, 0.4, 0.2)
    canvas.edge((14, 14, 14), max(1, int(0.01 * canvas.texels_per_m)))


def paint_lamp_shade(canvas: Canvas) -> None:
    """A lit shade: brightest in its middle."""
    width, height = canvas.size_px
    x, y = np.linspace(-1, 1, width)[None, :], np.linspace(-1, 1, height)[:, None]
    glow = 1.0 - 0.25 * (x**2 + y**2) / 2
    canvas.image[:] = np.clip(glow[:, :, None] * (228, 246, 255), 0, 255).astype(np.uint8)


def paint_open_shelf(canvas: Canvas) -> None:
    """A white shelf, half empty: books, a bottle, a bowl or a plain box on each board."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill(scaled(WHITE, 0.8))
    rows = max(1, round(height / m / 0.38))
    board = max(2, int(0.02 * m))
    for row in range(rows):
        floor_y, top_y = int((row + 1) * height / rows), int(row * height / rows)
        canvas.image[top_y : top_y + int(0.05 * m)] = scaled(WHITE, 0.7)  # the board's shade
        x = board + canvas.length_px(0.0, 0.15)
        while x < width - board:
            paint_thing, (low_m, high_m), share = SHELVED[int(rng.integers(0, len(SHELVED)))]
            w, h = min(canvas.length_px(low_m, high_m), width - board - x), int(share * (floor_y - top_y))
            if w > 4:
                paint_thing(canvas.part(x, floor_y - h, w, h))
            x += w + canvas.length_px(0.03, 0.3)
        cv2.rectangle(canvas.image, (0, floor_y - board), (width, floor_y), WHITE, -1)
    canvas.image[:] = cv2.GaussianBlur(canvas.image, (0, 0), 0.002 * m)
    canvas.edge(WHITE, board // 2)


# What may stand on a shelf: its painter, its width in m and its share of the height between the boards.
SHELVED: tuple[tuple[Callable[[Canvas], None], tuple[float, float], float], ...] = (
    (paint_spines, (0.12, 0.35), 0.7),
    (paint_bottle, (0.06, 0.1), 0.65),
    (paint_bowl, (0.15, 0.25), 0.28),
    (paint_lacquer, (0.1, 0.3), 0.5),
)


def paint_garment(canvas: Canvas) -> None:
    """What a walking person wears: one colour, a stripe or a patch, hanging folds."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    base = canvas.muted_colour(45, 190)
    canvas.fill(base)
    second = canvas.muted_colour(60, 220)
    for _ in range(int(rng.integers(1, 4))):
        y = int(rng.uniform(0, height))
        cv2.rectangle(canvas.image, (0, y), (width, y + canvas.length_px(0.02, 0.07)), second, -1)
    for _ in range(10):
        x, y = canvas.spot()
        end = (x + canvas.length_px(-0.03, 0.03), y + canvas.length_px(0.05, 0.2))
        cv2.line(canvas.image, (x, y), end, scaled(base, 0.7), max(1, int(0.006 * m)), cv2.LINE_AA)
    canvas.speckle((0.03 * m, 0.008 * m), 0.1)


def paint_house_plant(canvas: Canvas) -> None:
    """Large leaves one over the other."""
    canvas.fill((44, 62, 48))
    for _ in range(6 + int(60 * canvas.area_m2)):
        size, turn = canvas.length_px(0.05, 0.11), float(canvas.rng.uniform(20, 160))
        green = (int(canvas.rng.integers(50, 90)), int(canvas.rng.integers(95, 150)), int(canvas.rng.integers(60, 100)))
        cv2.ellipse(canvas.image, canvas.spot(), (size, size // 3), turn, 0, 360, green, -1, cv2.LINE_AA)


def paint_head(canvas: Canvas) -> None:
    """Hair above, face below."""
    _, height = canvas.size_px
    canvas.fill((140, 170, 205))
    canvas.image[: int(0.45 * height)] = _tone(canvas, 30, 110, 20)
    canvas.speckle((0.02 * canvas.texels_per_m,), 0.12)
