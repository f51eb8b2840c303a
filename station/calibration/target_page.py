"""A calibration target as a page to print: vectors, at the true scale, with a ruler to check the printer's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import cv2
import numpy as np

from shared.errors import ConfigError
from shared.geometry import FloatArray
from station.calibration.dictionaries import (
    APRIL_BITS,
    APRIL_BORDER_BITS,
    DEFAULT_CHARUCO_DICTIONARY,
    april_dictionary,
    charuco_board,
)
from station.calibration.target import Target, TargetKind
from station.vision.lens import BoolArray

if TYPE_CHECKING:  # a worker that draws imports it, not all that are forked
    from matplotlib.figure import Figure

PageSize = Literal["A4", "A3", "Letter"]
PAGE_SIZES: tuple[str, ...] = get_args(PageSize)
PAGE_MM: dict[PageSize, tuple[float, float]] = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "Letter": (215.9, 279.4)}
MARGIN_MM = 10.0  # what printers leave white
RULER_MM = 14.0  # room for the ruler, below the board
RULER_LENGTH_MM = 100
GAP = 0.3  # of a tag's side, as kalibr's own grids
MARKER = 0.7  # of a ChArUco's square
# Columns and rows that fill a page. Odd beside even, so that a turned chessboard cannot be mistaken for an upright one.
GRID: dict[TargetKind, tuple[int, int]] = {"aprilgrid": (5, 7), "charuco": (6, 9), "chessboard": (6, 9)}


def page_target(kind: TargetKind, size: PageSize, columns: int | None = None, rows: int | None = None) -> Target:
    """The target that fills a page, its squares a whole number of millimetres."""
    columns, rows = columns or GRID[kind][0], rows or GRID[kind][1]
    width_mm, height_mm = PAGE_MM[size]
    across, down = _squares(kind, columns), _squares(kind, rows)
    square_mm = int(min((width_mm - 2 * MARGIN_MM) / across, (height_mm - 2 * MARGIN_MM - RULER_MM) / down))
    if square_mm < 5:
        raise ConfigError(f"{columns} x {rows} leaves squares below 5 mm on {size}; take fewer or larger paper")
    square_m = square_mm / 1000.0
    if kind == "aprilgrid":
        return Target(kind, columns, rows, square_m, gap_m=GAP * square_m)
    if kind == "chessboard":
        return Target(kind, columns, rows, square_m)
    marker_m = round(MARKER * square_mm) / 1000.0
    return Target(kind, columns, rows, square_m, marker_m=marker_m, dictionary=DEFAULT_CHARUCO_DICTIONARY)


def printed_target(kind: TargetKind, size: PageSize, ruler_mm: float) -> Target:
    """The target that fills a page, as large as a printer made it whose ruler measures `ruler_mm`."""
    target, scale = page_target(kind, size), ruler_mm / RULER_LENGTH_MM
    lengths = {name: scale * getattr(target, name) for name in ("square_m", "gap_m", "marker_m")}
    return replace(target, **lengths)


def write_page(target: Target, size: PageSize, path: Path) -> None:
    """Write the target as a PDF of one page."""
    figure = draw_page(target, size)
    figure.savefig(path, format="pdf", metadata={"Title": "Calibration target", "CreationDate": None})


def draw_page(target: Target, size: PageSize) -> Figure:
    """The page as a figure, whose axes are millimetres from the lower left corner of the paper."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    width_mm, height_mm = PAGE_MM[size]
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, width_mm)
    axes.set_ylim(0.0, height_mm)
    pitch = 1e3 * (target.square_m + target.gap_m)
    board_mm = np.array([_squares(target.kind, n) for n in (target.columns, target.rows)]) * 1e3 * target.square_m
    if target.kind == "aprilgrid":
        board_mm = np.array([target.columns, target.rows]) * pitch + 1e3 * target.gap_m
    free = np.array([width_mm, height_mm - RULER_MM]) - board_mm
    if (free < 0).any():
        raise ConfigError(f"the target is {board_mm[0]:.0f} x {board_mm[1]:.0f} mm, larger than {size}")
    origin = free / 2 + (0.0, RULER_MM)
    for black, colour in _layers(target):
        squares = PolyCollection(list(1e3 * black + origin), facecolors=colour, edgecolors="none")
        axes.add_collection(squares)
    _draw_ruler(axes, target, float(origin[0]))
    return figure


def _squares(kind: TargetKind, count: int) -> float:
    """Length of a side of the board in squares, with what stands around it."""
    return count + (count + 1) * GAP if kind == "aprilgrid" else count + 1


def _layers(target: Target) -> Iterator[tuple[FloatArray, str]]:
    """Rectangles (n, 4, 2) m from the board's lower left corner, and their colour, in the order of painting."""
    if target.kind == "aprilgrid":
        yield from _aprilgrid_layers(target)
        return
    columns, rows = target.columns + 1, target.rows + 1
    row, column = np.mgrid[:rows, :columns]
    # The first inner corner is the upper left one, and the board's y axis points down.
    corner = np.stack([column, rows - 1 - row], axis=-1).astype(np.float64) * target.square_m
    if target.kind == "chessboard":
        yield _rectangles(corner[(row + column) % 2 == 0], target.square_m, target.square_m), "black"
        return
    board = charuco_board(target)
    has_marker = np.zeros((rows, columns), dtype=bool)
    for marker in np.asarray(board.getObjPoints()):
        centre = np.asarray(marker)[:, :2].mean(axis=0) / target.square_m
        has_marker[int(centre[1]), int(centre[0])] = True
    yield _rectangles(corner[~has_marker], target.square_m, target.square_m), "black"
    bits = int(board.getDictionary().markerSize)
    for marker_id, low in zip(np.asarray(board.getIds()).ravel(), corner[has_marker], strict=True):
        modules = _marker_modules(board.getDictionary(), int(marker_id), bits, 1)
        yield from _marker_layers(modules, low + (target.square_m - target.marker_m) / 2, target.marker_m)


def _aprilgrid_layers(target: Target) -> Iterator[tuple[FloatArray, str]]:
    """Tag 0 stands at the lower left; a small square fills each crossing of the gaps."""
    pitch, gap = target.square_m + target.gap_m, target.gap_m
    row, column = np.mgrid[: target.rows + 1, : target.columns + 1]
    yield _rectangles(np.stack([column.ravel(), row.ravel()], axis=1) * pitch, gap, gap), "black"
    dictionary = april_dictionary()
    for tag in range(target.columns * target.rows):
        at = np.array([tag % target.columns, tag // target.columns]) * pitch + gap
        # kalibr's tags stand upside down to OpenCV's.
        modules = _marker_modules(dictionary, tag, APRIL_BITS, APRIL_BORDER_BITS)[::-1, ::-1]
        yield from _marker_layers(modules, at, target.square_m)


def _marker_modules(dictionary: Any, marker: int, bits: int, border: int) -> BoolArray:
    """Which modules of a marker are white, (n, n), first row on top."""
    side = bits + 2 * border
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, marker, side, borderBits=border)) > 127


def _marker_layers(is_white: BoolArray, low: FloatArray, side: float) -> Iterator[tuple[FloatArray, str]]:
    """A black square with its white modules. White neighbours overlap, so that no hairline parts them on a screen."""
    yield _rectangles(low[None], side, side), "black"
    n = len(is_white)
    module = side / n
    white = is_white[::-1]  # from the bottom
    pieces = [_rectangles(_places(white, module, low), module, module)]
    pieces.append(_rectangles(_places(white[:, :-1] & white[:, 1:], module, low), 2 * module, module))
    pieces.append(_rectangles(_places(white[:-1] & white[1:], module, low), module, 2 * module))
    yield np.concatenate(pieces), "white"


def _places(chosen: BoolArray, module: float, low: FloatArray) -> FloatArray:
    row, column = np.nonzero(chosen)
    return np.asarray(low + np.stack([column, row], axis=1) * module)


def _rectangles(low: FloatArray, width: float, height: float) -> FloatArray:
    """Corners (n, 4, 2) of rectangles whose lower left corners are (n, 2)."""
    return np.asarray(low.reshape(-1, 1, 2) + np.array([[0, 0], [width, 0], [width, height], [0, height]]))


def _draw_ruler(axes: Any, target: Target, left_mm: float) -> None:
    left, y = max(left_mm, MARGIN_MM), MARGIN_MM
    axes.plot([left, left + RULER_LENGTH_MM], [y, y], color="black", linewidth=0.6, solid_capstyle="butt")
    for at in range(0, RULER_LENGTH_MM + 1, 10):
        axes.plot([left + at] * 2, [y, y + (3.0 if at % 50 == 0 else 1.8)], color="black", linewidth=0.4)
    square = "tag" if target.kind == "aprilgrid" else "square"
    axes.text(
        left + RULER_LENGTH_MM + 3,
        y,
        f"This ruler must be {RULER_LENGTH_MM} mm long: print at 100 %.\n"
        f"{target.kind}, {target.columns} x {target.rows}, {square} {1e3 * target.square_m:g} mm.\n"
        "Glue it to something flat.",
        fontsize=6,
        va="bottom",
    )
