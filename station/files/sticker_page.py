"""Stickers with the names of rooms as pages to print: vectors, at the true size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from shared.errors import ConfigError
from shared.room_sticker import CODE_SIDE_M, sticker_modules

StickerPage = Literal["A4", "Letter"]
PAGE_MM: dict[StickerPage, tuple[float, float]] = {"A4": (210.0, 297.0), "Letter": (215.9, 279.4)}
MM_PER_POINT = 25.4 / 72
NAME_POINTS = 60.0  # read by a person from across the room; long names are smaller
NAME_WEIGHT = "bold"
LETTER_WIDTH = 0.62  # of the size of a bold sans-serif type, on average
ADVICE = (
    f"Print at 100 %: the code must be {1000 * CODE_SIDE_M:.0f} mm wide. Hang it inside the room, upright and flat, "
    "where the robot drives towards it, 10 to 40 cm above the floor."
)


def write_stickers(names: Sequence[str], size: StickerPage, path: Path) -> None:
    """Write a PDF with a page for each name.

    Raises:
        ConfigError: before anything is written: a name is too long, or the font lacks a letter of it.
    """
    pages = [draw_sticker(name, size) for name in names]
    with PdfPages(path, metadata={"Title": "Names of rooms", "CreationDate": None}) as file:
        for page in pages:
            file.savefig(page)


def draw_sticker(name: str, size: StickerPage) -> Figure:
    """One page as a figure, whose axes are millimetres from the lower left corner of the paper.

    Raises ConfigError, as write_stickers.
    """
    _require_letters(name)
    width_mm, height_mm = PAGE_MM[size]
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, width_mm)
    axes.set_ylim(0.0, height_mm)
    side_mm = 1000 * CODE_SIDE_M
    rim_mm = (width_mm - side_mm) / 2
    _draw_code(axes, name, np.array([rim_mm, height_mm - rim_mm]), side_mm)
    points = min(NAME_POINTS, side_mm / MM_PER_POINT / (LETTER_WIDTH * len(name)))
    middle_mm = (height_mm - rim_mm - side_mm) / 2 + 8
    axes.text(
        width_mm / 2, middle_mm, name, fontsize=points, ha="center", va="center", weight=NAME_WEIGHT, parse_math=False
    )
    axes.text(width_mm / 2, 12, ADVICE, fontsize=6, ha="center", va="bottom")
    return figure


def _require_letters(name: str) -> None:
    """Raises ConfigError: the font has no picture of a letter, and would print a box."""
    font = get_font(findfont(FontProperties(weight=NAME_WEIGHT)))
    missing = [letter for letter in dict.fromkeys(name) if not font.get_char_index(ord(letter))]
    if missing:
        raise ConfigError(
            f'the name "{name}" cannot be printed: the font {font.family_name} has no "{"".join(missing)}"; '
            "give a name in Latin, Greek or Cyrillic letters"
        )


def _draw_code(axes: Any, name: str, top_left_mm: np.ndarray, side_mm: float) -> None:
    """Black modules of a row that touch are one rectangle, so that no hairline parts them; rows overlap a little."""
    modules = sticker_modules(name)
    module = side_mm / len(modules)
    rectangles = []
    for row, line in enumerate(modules):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2):
            below = 0.02 if row + 1 < len(modules) and modules[row + 1, begin:end].all() else 0.0
            corners = np.array([[begin, row], [end, row], [end, row + 1 + below], [begin, row + 1 + below]])
            rectangles.append(top_left_mm + module * corners * (1, -1))
    axes.add_collection(PolyCollection(rectangles, facecolors="black", edgecolors="none"))
