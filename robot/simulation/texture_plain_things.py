"""Painters of the things people keep in plain homes: books, bottles, cushions, baskets, clocks, plugs and cables."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from robot.simulation.texture_strokes import Canvas, Colour, scaled
from shared.geometry import FloatArray


def paint_spines(canvas: Canvas) -> None:
    """Books side by side, most of them of one height, a title on each back."""
    height = canvas.size_px[1]
    canvas.fill((58, 62, 66))
    for x, thickness in _along(canvas, 0.018, 0.05):
        top = int(canvas.rng.uniform(0.0, 0.22) * height)
        book = canvas.part(x, top, thickness, height - top)
        colour = canvas.muted_colour(60, 225)
        book.fill(colour)
        _title(book, scaled(colour, float(canvas.rng.choice([0.45, 1.6]))))
        book.edge(scaled(colour, 0.6), 1)


def _along(canvas: Canvas, low_m: float, high_m: float) -> list[tuple[int, int]]:
    """Left end and width, texels, of things that stand side by side over the whole width."""
    width, x, found = canvas.size_px[0], 0, []
    while x < width - 2:
        step = min(max(3, canvas.length_px(low_m, high_m)), width - x)
        found.append((x, step))
        x += step
    return found


def _title(canvas: Canvas, colour: Colour) -> None:
    """Strokes as of letters seen from afar, and a band."""
    width, height = canvas.size_px
    y, end = int(0.15 * height), int(canvas.rng.uniform(0.4, 0.75) * height)
    while y < end:
        stroke = max(2, canvas.length_px(0.006, 0.018))
        cv2.rectangle(canvas.image, (int(0.3 * width), y), (int(0.7 * width), y + stroke), colour, -1)
        y += stroke + max(2, canvas.length_px(0.004, 0.01))
    band = int(canvas.rng.uniform(0.8, 0.9) * height)
    cv2.rectangle(canvas.image, (0, band), (width, band + max(1, int(0.03 * height))), colour, -1)


def paint_bottle(canvas: Canvas) -> None:
    """A bottle or a jar: a cap, a pale label with a mark and lines of print."""
    width, height = canvas.size_px
    glass = canvas.muted_colour(50, 170)
    canvas.fill(glass)
    canvas.image[: max(1, int(0.12 * height))] = canvas.muted_colour(40, 230)
    top, bottom = int(canvas.rng.uniform(0.3, 0.45) * height), int(canvas.rng.uniform(0.75, 0.9) * height)
    canvas.image[top:bottom] = scaled((215, 222, 226), float(canvas.rng.uniform(0.8, 1.1)))
    ink = canvas.muted_colour(40, 130)
    middle = (width // 2, top + (bottom - top) // 3)
    cv2.circle(canvas.image, middle, max(1, min(width, bottom - top) // 5), ink, -1, cv2.LINE_AA)
    for row in (0.7, 0.85):
        y = int(top + row * (bottom - top))
        cv2.line(canvas.image, (int(0.2 * width), y), (int(0.8 * width), y), ink, max(1, height // 50))


def paint_bowl(canvas: Canvas) -> None:
    """Glazed earthenware: rings of another colour, a row of dots."""
    width, height = canvas.size_px
    base, second = canvas.muted_colour(130, 225), canvas.muted_colour(40, 130)
    canvas.fill(base)
    for row in (0.15, 0.8):
        cv2.rectangle(canvas.image, (0, int(row * height)), (width, int((row + 0.08) * height)), second, -1)
    for x in np.arange(0.02, width / canvas.texels_per_m, 0.04) * canvas.texels_per_m:
        cv2.circle(canvas.image, (int(x), int(0.5 * height)), max(1, int(0.1 * height)), second, -1, cv2.LINE_AA)


def paint_labelled_box(canvas: Canvas) -> None:
    """A storage box in one colour with a handle's hole and a label with three lines."""
    width, height = canvas.size_px
    base = canvas.muted_colour(110, 210)
    canvas.fill(base)
    hole = (int(0.4 * width), int(0.16 * height)), (int(0.6 * width), int(0.26 * height))
    cv2.rectangle(canvas.image, *hole, scaled(base, 0.35), -1)
    x, y, w, h = int(0.3 * width), int(0.45 * height), int(0.4 * width), int(0.35 * height)
    cv2.rectangle(canvas.image, (x, y), (x + w, y + h), (228, 232, 233), -1)
    for row in (0.25, 0.5, 0.75):
        end = int(x + w * canvas.rng.uniform(0.5, 0.9))
        at = int(y + row * h)
        cv2.line(canvas.image, (x + w // 10, at), (end, at), (70, 66, 62), max(1, h // 14))
    canvas.edge(scaled(base, 0.7), 1)


def paint_toy_box(canvas: Canvas) -> None:
    """Painted stars and discs in rows on a bright box."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    canvas.fill(canvas.muted_colour(170, 235))
    colours = [canvas.muted_colour(60, 200) for _ in range(3)]
    step = max(4, int(0.085 * m))
    for row, y in enumerate(range(step // 2, height, step)):
        for x in range(step // 2 + (row % 2) * step // 2, width, step):
            colour, reach = colours[int(rng.integers(0, 3))], 0.38 * step
            if rng.random() < 0.4:
                cv2.circle(canvas.image, (x, y), int(0.8 * reach), colour, -1, cv2.LINE_AA)
            else:
                _star(canvas, (x, y), reach, colour)


def _star(canvas: Canvas, at: tuple[int, int], reach_px: float, colour: Colour) -> None:
    angles = np.arange(10) * np.pi / 5 + canvas.rng.uniform(0, np.pi)
    reaches = np.where(np.arange(10) % 2 == 0, reach_px, 0.45 * reach_px)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * reaches[:, None] + at
    cv2.fillPoly(canvas.image, [np.round(points).astype(np.int32)], colour, cv2.LINE_AA)


def paint_patterned_cloth(canvas: Canvas) -> None:
    """A cover or a cushion with a printed pattern that repeats: stripes, checks, dots or leaves."""
    base = canvas.muted_colour(120, 220)
    canvas.fill(base)
    draw_pattern(canvas, scaled(base, float(canvas.rng.choice([0.6, 0.75]))), canvas.length_px(0.06, 0.11))
    canvas.image[:] = cv2.GaussianBlur(canvas.image, (0, 0), 0.002 * canvas.texels_per_m + 0.4)
    canvas.edge(scaled(base, 0.75), max(1, int(0.004 * canvas.texels_per_m)))


def draw_pattern(canvas: Canvas, colour: Colour, step_px: int) -> None:
    """Print one of the patterns over the whole canvas; step_px is the distance at which it repeats."""
    step = max(6, step_px)
    draw: Callable[[Canvas, Colour, int], None] = _PATTERNS[int(canvas.rng.integers(0, len(_PATTERNS)))]
    draw(canvas, colour, step)


def _stripes(canvas: Canvas, colour: Colour, step: int) -> None:
    width, height = canvas.size_px
    for x in range(0, width, step):
        cv2.rectangle(canvas.image, (x, 0), (x + step // 3, height), colour, -1)
        for y in range(step // 2, height, step):  # what is woven in between
            cv2.line(canvas.image, (x + step // 2, y), (x + step - 2, y), colour, max(1, step // 12))


def _checks(canvas: Canvas, colour: Colour, step: int) -> None:
    width, height = canvas.size_px
    for x in range(0, width, step):
        for y in range((x // step % 2) * step, height, 2 * step):
            cv2.rectangle(canvas.image, (x, y), (x + step - 1, y + step - 1), colour, -1)


def _dots(canvas: Canvas, colour: Colour, step: int) -> None:
    width, height = canvas.size_px
    for row, y in enumerate(range(step // 2, height, step)):
        for x in range(step // 2 + (row % 2) * step // 2, width, step):
            cv2.circle(canvas.image, (x, y), step // 4, colour, -1, cv2.LINE_AA)


def _sprigs(canvas: Canvas, colour: Colour, step: int) -> None:
    width, height = canvas.size_px
    for row, y in enumerate(range(step // 2, height, step)):
        for x in range(step // 2 + (row % 2) * step // 2, width, step):
            for turn in (20, 90, 160):
                rise = np.radians(turn)
                at = (int(x + 0.25 * step * np.cos(rise)), int(y - 0.25 * step * np.sin(rise)))
                cv2.ellipse(canvas.image, at, (step // 5, step // 11 + 1), -turn, 0, 360, colour, -1, cv2.LINE_AA)


_PATTERNS = (_stripes, _checks, _dots, _sprigs)


def paint_wicker(canvas: Canvas) -> None:
    """Woven willow: short strands, over and under by turns, each a little lighter or darker."""
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    base = scaled((96, 142, 176), float(rng.uniform(0.75, 1.15)))
    canvas.fill(scaled(base, 0.86))
    long, thick = max(4, int(0.06 * m)), max(3, int(0.022 * m))
    for row, y in enumerate(range(0, height, thick)):
        for x in range(-(row % 2) * long // 2, width, long):
            tone = scaled(base, float(rng.uniform(0.85, 1.1)))
            cv2.rectangle(canvas.image, (x + 1, y + 1), (x + long - 2, y + thick - 1), tone, -1)


def paint_shoe(canvas: Canvas) -> None:
    """Seen from any side: a pale sole below, laces or a stripe above."""
    width, height = canvas.size_px
    base = canvas.muted_colour(40, 190)
    canvas.fill(base)
    canvas.image[int(0.75 * height) :] = (205, 210, 212)
    trim = scaled(base, 0.5 if sum(base) > 350 else 2.2)
    for k in range(1, 5):
        x = int(k * width / 5)
        cv2.line(canvas.image, (x, int(0.2 * height)), (x - width // 12, int(0.6 * height)), trim, max(1, width // 25))


def paint_power_strip(canvas: Canvas) -> None:
    """Sockets in a row, some with a dark plug, a red switch at the end."""
    width, height = canvas.size_px
    canvas.fill((232, 235, 236))
    for k in range(4):
        at, is_used = (int((k + 0.6) * width / 5), height // 2), canvas.rng.random() < 0.6
        colour: Colour = (38, 38, 40) if is_used else (178, 182, 184)
        cv2.circle(canvas.image, at, int(0.36 * height), colour, -1, cv2.LINE_AA)
    left, right = int(0.9 * width), int(0.96 * width)
    cv2.rectangle(canvas.image, (left, int(0.25 * height)), (right, int(0.75 * height)), (50, 50, 190), -1)
    canvas.edge((140, 142, 145), 1)


def paint_switch(canvas: Canvas) -> None:
    """A light switch: one rocker in a frame."""
    width, height = canvas.size_px
    canvas.fill((230, 234, 235))
    inner = (int(0.2 * width), int(0.2 * height)), (int(0.8 * width), int(0.8 * height))
    cv2.rectangle(canvas.image, *inner, (168, 172, 174), max(1, width // 20))
    canvas.edge((165, 169, 171), 1)


def paint_clock(canvas: Canvas) -> None:
    """A white square clock: twelve ticks and two hands."""
    width, height = canvas.size_px
    canvas.fill((236, 238, 238))
    middle, reach = np.array([width, height]) / 2, 0.42 * min(width, height)
    ink: Colour = (46, 44, 42)
    for hour in range(12):
        way = np.array([np.cos(hour * np.pi / 6), np.sin(hour * np.pi / 6)])
        _stroke(canvas, middle + 0.8 * reach * way, middle + reach * way, ink, max(1, width // 40))
    for length in (0.5, 0.75):
        turn = float(canvas.rng.uniform(0, 2 * np.pi))
        way = np.array([np.cos(turn), np.sin(turn)])
        _stroke(canvas, middle, middle + length * reach * way, ink, max(1, width // 30))
    canvas.edge(ink, max(1, width // 30))


def _stroke(canvas: Canvas, start: FloatArray, end: FloatArray, colour: Colour, width_px: int) -> None:
    ends = [(int(x), int(y)) for x, y in (start, end)]
    cv2.line(canvas.image, ends[0], ends[1], colour, width_px, cv2.LINE_AA)


def paint_note_board(canvas: Canvas) -> None:
    """Slips of paper, a calendar and cards on a pale board."""
    canvas.fill((190, 205, 212))
    for _ in range(2 + int(25 * canvas.area_m2)):
        x, y = canvas.spot()
        w, h = canvas.length_px(0.05, 0.13), canvas.length_px(0.05, 0.13)
        paper = canvas.muted_colour(190, 240)
        cv2.rectangle(canvas.image, (x, y), (x + w, y + h), paper, -1)
        for row in range(1, 4):
            at = y + row * h // 4
            cv2.line(canvas.image, (x + w // 8, at), (x + 6 * w // 8, at), scaled(paper, 0.5), max(1, h // 20))
        cv2.circle(canvas.image, (x + w // 2, y + h // 12), max(2, h // 12), canvas.muted_colour(50, 180), -1)
    canvas.edge((120, 140, 150), max(1, int(0.01 * canvas.texels_per_m)))


def draw_wood_grain(canvas: Canvas, colour: Colour) -> None:
    """The long dark lines of sawn wood along the board, bent around a few knots."""
    if canvas.size_px[1] > canvas.size_px[0]:
        lying = Canvas(canvas.image.transpose(1, 0, 2).copy(), canvas.rng, canvas.texels_per_m)
        _draw_lying_grain(lying, colour)
        canvas.image[:] = lying.image.transpose(1, 0, 2)
    else:
        _draw_lying_grain(canvas, colour)


def _draw_lying_grain(canvas: Canvas, colour: Colour) -> None:
    rng, (width, height), m = canvas.rng, canvas.size_px, canvas.texels_per_m
    x = np.arange(0, width + 8, 8)
    knots = [(*canvas.spot(), canvas.length_px(0.012, 0.03)) for _ in range(int(canvas.area_m2 * 5))]
    for y in np.arange(rng.uniform(0, 0.03), height / m, 0.028) * m:
        line = y + rng.normal(0, 0.003) * m + 0.004 * m * np.sin(x / m * rng.uniform(3, 8) + rng.uniform(0, 6))
        for kx, ky, reach in knots:
            away = y - ky
            line += np.sign(away) * reach * np.exp(-(((x - kx) / (2.5 * reach)) ** 2) - (away / (2 * reach)) ** 2)
        points = np.round(np.stack([x, line], axis=1)).astype(np.int32)
        tone = scaled(colour, float(rng.uniform(0.68, 0.92)))
        cv2.polylines(canvas.image, [points], False, tone, max(1, int(0.003 * m)), cv2.LINE_AA)
    for kx, ky, reach in knots:
        cv2.ellipse(canvas.image, (kx, ky), (reach, reach // 2 + 1), 0, 0, 360, scaled(colour, 0.6), -1, cv2.LINE_AA)


def paint_wall_tiles(canvas: Canvas) -> None:
    """Small white tiles behind a worktop, grey joints, now and then a tile with a flower."""
    width, height = canvas.size_px
    canvas.fill((222, 226, 228))
    side = max(4, int(0.1 * canvas.texels_per_m))
    for x in range(0, width, side):
        for y in range(0, height, side):
            cv2.rectangle(canvas.image, (x, y), (x + side, y + side), (160, 164, 166), max(1, side // 25))
            if canvas.rng.random() < 0.06:
                _star(canvas, (x + side // 2, y + side // 2), 0.3 * side, (150, 110, 80))
