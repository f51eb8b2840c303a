"""Least squares whose unknowns are a chain of knots, each linked with a few neighbours, and a border linked with all.

The knots' normal equations are banded, so they are eliminated in time linear in their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray
from station.calibration.camera_imu.rows import KNOT, Rows
from station.calibration.camera_imu.spline import ORDER

WIDTH = KNOT * ORDER  # unknowns that one row knows of


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """H dx = -g with H = [[band, cross], [cross^T, border]]."""

    band: FloatArray  # (WIDTH, n) lower diagonals, as scipy.linalg.cholesky_banded has them
    cross: FloatArray  # (n, b)
    border: FloatArray  # (b, b)
    g_knots: FloatArray  # (n,)
    g_border: FloatArray  # (b,)

    def add(self, columns: IntArray, residual: FloatArray, J: FloatArray) -> None:
        """What is known of the border beforehand: whitened residual (m,) and its derivative (m, c) by c columns."""
        self.border[np.ix_(columns, columns)] += J.T @ J
        self.g_border[columns] += J.T @ residual


def normal_equations(blocks: Sequence[Rows], num_segments: int, border_size: int) -> NormalEquations:
    n = KNOT * (num_segments + ORDER - 1)
    own = np.zeros((num_segments, WIDTH, WIDTH))
    cross = np.zeros((n, border_size))
    border = np.zeros((border_size, border_size))
    g_knots, g_border = np.zeros(n), np.zeros(border_size)
    for block in blocks:
        order = np.argsort(block.segment, kind="stable")
        bounds = np.searchsorted(block.segment[order], np.arange(num_segments + 1))
        m, c = block.residual.shape[1], block.by_border.shape[2]
        by_knots = block.by_knots[order].reshape(-1, WIDTH)
        by_border = block.by_border[order].reshape(-1, c)
        residual = block.residual[order].ravel()
        for segment in np.flatnonzero(np.diff(bounds)):
            rows = slice(m * bounds[segment], m * bounds[segment + 1])
            at = slice(KNOT * segment, KNOT * segment + WIDTH)
            J = by_knots[rows]
            own[segment] += J.T @ J
            cross[at, block.columns] += J.T @ by_border[rows]
            g_knots[at] += J.T @ residual[rows]
        border[np.ix_(block.columns, block.columns)] += by_border.T @ by_border
        g_border[block.columns] += by_border.T @ residual
    band = np.zeros((WIDTH, n))
    reach = KNOT * num_segments
    for i in range(WIDTH):
        for j in range(i + 1):
            band[i - j, j : j + reach : KNOT] += own[:, i, j]
    return NormalEquations(band, cross, border, g_knots, g_border)


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """The knots solved for the border: what is left are equations of the free part of the border."""

    knots_by_border: FloatArray  # (n, f): the knots' step is knots_alone - knots_by_border @ border's step
    knots_alone: FloatArray  # (n,)
    information: FloatArray  # (f, f)
    g: FloatArray  # (f,)
    free: IntArray  # (f,) columns of the border

    def step(self, border_size: int) -> tuple[FloatArray, FloatArray]:
        """Steps of the knots (n / KNOT, KNOT) and of the whole border (border_size,)."""
        try:
            free_step = -cho_solve(cho_factor(self.information), self.g)
        except np.linalg.LinAlgError as exc:
            raise DegenerateGeometry("what the recording shows leaves the calibration open") from exc
        border = np.zeros(border_size)
        border[self.free] = free_step
        return (self.knots_alone - self.knots_by_border @ free_step).reshape(-1, KNOT), border


def eliminate_knots(equations: NormalEquations, free: IntArray, damping: float) -> Elimination:
    """Raises DegenerateGeometry where the measurements leave the motion open."""
    band = equations.band.copy()
    band[0] *= 1.0 + damping
    border = equations.border[np.ix_(free, free)].copy()
    border[np.diag_indices_from(border)] *= 1.0 + damping
    cross = equations.cross[:, free]
    try:
        factor = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    except np.linalg.LinAlgError as exc:
        raise DegenerateGeometry("what the recording shows leaves the motion open") from exc
    solved = cho_solve_banded((factor, True), np.column_stack([cross, equations.g_knots]), check_finite=False)
    by_border, alone = solved[:, :-1], -solved[:, -1]
    return Elimination(by_border, alone, border - cross.T @ by_border, equations.g_border[free] + cross.T @ alone, free)


def cluster_scores(blocks: Sequence[Rows], left: Elimination, segments: int, border_size: int) -> FloatArray:
    """(clusters, f): gradients of the cost by the free border, knots eliminated, summed over so many segments each."""
    f = len(left.free)
    num_segments = len(left.knots_by_border) // KNOT - ORDER + 1
    place = np.full(border_size, -1)
    place[left.free] = np.arange(f)
    scores = np.zeros((num_segments, f))
    own = np.zeros((num_segments, WIDTH))
    for block in blocks:
        free = place[block.columns]
        direct = np.zeros((len(block.segment), f))
        direct[:, free[free >= 0]] = np.einsum("nm,nmc->nc", block.residual, block.by_border[..., free >= 0])
        np.add.at(scores, block.segment, direct)
        np.add.at(own, block.segment, np.einsum("nm,nmw->nw", block.residual, block.by_knots))
    reach = np.lib.stride_tricks.sliding_window_view(left.knots_by_border, WIDTH, axis=0)[
        ::KNOT
    ]  # (segments, f, WIDTH)
    scores -= np.einsum("sfw,sw->sf", reach, own)
    return np.asarray(np.add.reduceat(scores, np.arange(0, num_segments, segments), axis=0))
