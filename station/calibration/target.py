"""The printed board that a camera is calibrated with, and what a camera saw of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from shared.errors import ConfigError
from shared.geometry import FloatArray, IntArray

TargetKind = Literal["aprilgrid", "charuco", "chessboard"]
TARGET_KINDS: tuple[str, ...] = get_args(TargetKind)


@dataclass(frozen=True, slots=True)
class Target:
    """A flat board of corners in a grid. Its frame: origin at the first corner, x along a row, y along a column.

    An AprilGrid has `columns` x `rows` tags of side `square_m`, apart by `gap_m`; each has four corners. A chessboard
    and a ChArUco board have `columns` x `rows` inner corners, `square_m` apart; `marker_m` is a ChArUco marker's side.
    """

    kind: TargetKind
    columns: int
    rows: int
    square_m: float
    gap_m: float = 0.0
    marker_m: float = 0.0
    dictionary: str = ""  # of a ChArUco's markers, as OpenCV names it; empty: what `station calibrate target` prints

    def __post_init__(self) -> None:
        if not (2 <= self.columns <= 50 and 2 <= self.rows <= 50):
            raise ConfigError(f"a target of {self.columns} x {self.rows} is outside 2..50 in each direction")
        if not 1e-3 <= self.square_m <= 2.0:
            raise ConfigError(f"a target's square of {self.square_m:g} m is outside 0.001 to 2 m")
        if self.kind == "charuco" and not 0.0 < self.marker_m < self.square_m:
            raise ConfigError(f"a marker of {self.marker_m:g} m is not smaller than its square of {self.square_m:g} m")

    @property
    def corners(self) -> FloatArray:
        """Every corner (n, 3) m in the target's frame, z = 0. A corner's row in it is its id.

        A tag's four corners follow each other: as kalibr has them, from the lower left one anticlockwise, tags by rows.
        """
        if self.kind != "aprilgrid":
            y, x = np.mgrid[: self.rows, : self.columns] * self.square_m
            return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        pitch = self.square_m + self.gap_m
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        tags = np.stack([column, row, np.zeros_like(row)], axis=1) * pitch
        square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * self.square_m
        return np.asarray((tags[:, None] + square).reshape(-1, 3), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """What one image shows of a target."""

    name: str  # of the image, as its user knows it
    t_robot_ns: int
    ids: IntArray  # (m,) rows of Target.corners
    corners_px: FloatArray  # (m, 2), the centre of the first pixel is (0, 0)
    blur_px: float = 0.0  # sigma of the blur over its edges; 0 where not measured
    ids_are_sure: bool = True  # False: a part of a plain chessboard, which may lie elsewhere on it
