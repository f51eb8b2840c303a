"""`target.yaml`: a calibration target in kalibr's format, and in keys of our own for a ChArUco board.

Source: kalibr's wiki, "Calibration targets".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from shared.bounded import shown
from shared.errors import ConfigError, DataError
from shared.sensor_yaml import number, numbers, read_yaml
from station.calibration.dictionaries import CHARUCO_DICTIONARIES, DEFAULT_CHARUCO_DICTIONARY
from station.calibration.target import Target

KALIBR_KINDS = ("aprilgrid", "checkerboard", "charuco")


def read_target(path: Path) -> Target:
    """The target that a file describes. Raises DataError naming file, key and remedy."""
    content = read_yaml(path)
    kind = content.get("target_type")
    try:
        if kind == "aprilgrid":
            return _read_aprilgrid(content, path)
        if kind == "checkerboard":
            return _read_chessboard(content, path)
        if kind == "charuco":
            return _read_charuco(content, path)
    except ConfigError as exc:
        raise DataError(f"{path}: {exc}; measure the board and correct the file") from exc
    raise DataError(f"{path}: target_type is {shown(kind)}; write one of {', '.join(KALIBR_KINDS)}")


def target_yaml(target: Target) -> str:
    """The text of a target's file."""
    if target.kind == "aprilgrid":
        return (
            "target_type: aprilgrid\n"
            f"tagCols: {target.columns}\n"
            f"tagRows: {target.rows}\n"
            f"tagSize: {target.square_m!r}    # m, outer edge of the black square\n"
            f"tagSpacing: {target.gap_m / target.square_m!r}    # gap between tags / tagSize\n"
        )
    if target.kind == "chessboard":
        return (
            "target_type: checkerboard\n"
            f"targetCols: {target.columns}    # inner corners\n"
            f"targetRows: {target.rows}\n"
            f"rowSpacingMeters: {target.square_m!r}    # side of a square\n"
            f"colSpacingMeters: {target.square_m!r}\n"
        )
    return (
        "target_type: charuco\n"
        f"targetCols: {target.columns}    # inner corners\n"
        f"targetRows: {target.rows}\n"
        f"squareSize: {target.square_m!r}    # m\n"
        f"markerSize: {target.marker_m!r}    # m, outer edge of the black square\n"
        f"dictionary: {target.dictionary or DEFAULT_CHARUCO_DICTIONARY}\n"
    )


def _read_aprilgrid(content: dict[str, Any], path: Path) -> Target:
    tag_m = _one(content, "tagSize", path)
    spacing = _one(content, "tagSpacing", path)
    if not 0.0 < spacing <= 2.0:
        raise DataError(f"{path}: tagSpacing is {spacing:g}, the gap over the tag's size; must be over 0 and up to 2")
    return Target(
        "aprilgrid", _count(content, "tagCols", path), _count(content, "tagRows", path), tag_m, gap_m=spacing * tag_m
    )


def _read_chessboard(content: dict[str, Any], path: Path) -> Target:
    row_m, column_m = _one(content, "rowSpacingMeters", path), _one(content, "colSpacingMeters", path)
    if abs(row_m - column_m) > 1e-6 * abs(row_m):
        raise DataError(f"{path}: rowSpacingMeters and colSpacingMeters differ; only boards of squares are used")
    return Target("chessboard", _count(content, "targetCols", path), _count(content, "targetRows", path), row_m)


def _read_charuco(content: dict[str, Any], path: Path) -> Target:
    square_m, marker_m = _one(content, "squareSize", path), _one(content, "markerSize", path)
    if not 0.0 < marker_m < square_m:
        raise DataError(f"{path}: markerSize is {marker_m:g}, must be over 0 and below squareSize")
    dictionary = content.get("dictionary", DEFAULT_CHARUCO_DICTIONARY)
    if dictionary not in CHARUCO_DICTIONARIES:
        raise DataError(f"{path}: dictionary is {shown(dictionary)}; write one of {', '.join(CHARUCO_DICTIONARIES)}")
    columns, rows = _count(content, "targetCols", path), _count(content, "targetRows", path)
    return Target("charuco", columns, rows, square_m, marker_m=marker_m, dictionary=dictionary)


def _one(content: dict[str, Any], key: str, path: Path) -> float:
    if content.get(key) is None:
        raise DataError(f"{path} has no {key}; add it")
    return number(content, key, 0.0, path)


def _count(content: dict[str, Any], key: str, path: Path) -> int:
    value = numbers(content, key, 1, path)[0] if content.get(key) is not None else _one(content, key, path)
    if value != int(value):
        raise DataError(f"{path}: {key} is {value:g}, must be a whole number")
    return int(value)
