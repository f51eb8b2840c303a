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
from station.calibration.camera_imu.priors import Prior
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

    def add(self, other: NormalEquations) -> None:
        """Of other measurements of the same unknowns."""
        for mine, theirs in (
            (self.band, other.band),
            (self.cross, other.cross),
            (self.border, other.border),
            (self.g_knots, other.g_knots),
            (self.g_border, other.g_border),
        ):
            mine += theirs

    def add_prior(self, prior: Prior) -> None:
        self.border[np.ix_(prior.columns, prior.columns)] += prior.J.T @ prior.J
        self.g_border[prior.columns] += prior.J.T @ prior.residual


def normal_equations(blocks: Sequence[Rows], num_segments: int, border_size: int) -> NormalEquations:
    n = KNOT * (num_segments + ORDER - 1)
    own = np.zeros((num_segments, WIDTH, WIDTH))
    cross = np.zeros((n, border_size))
    border = np.zeros((border_size, border_size))
    g_knots, g_border = np.zeros(n), np.zeros(border_size)
    for block in blocks:
        order = np.argsort(block.segment, kind="stable")
        bounds = np.searchsorted(block.segment[order], np.arange(num_segments + 1))
        m = block.residual.shape[1]
        A = np.concatenate([block.by_knots, block.by_border, block.residual[..., None]], axis=2)[order]
        A = A.reshape(-1, A.shape[2])
        for segment in np.flatnonzero(np.diff(bounds)):
            rows = A[m * bounds[segment] : m * bounds[segment + 1]]
            at = slice(KNOT * segment, KNOT * segment + WIDTH)
            product = rows[:, :WIDTH].T @ rows
            own[segment] += product[:, :WIDTH]
            cross[at, block.columns] += product[:, WIDTH:-1]
            g_knots[at] += product[:, -1]
        product = A[:, WIDTH:-1].T @ A[:, WIDTH:]
        border[np.ix_(block.columns, block.columns)] += product[:, :-1]
        g_border[block.columns] += product[:, -1]
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


def scores(block: Rows, left: Elimination, border_size: int) -> FloatArray:
    """(N, f): gradient of each measurement's cost by the free border, with the knots following."""
    f = len(left.free)
    place = np.full(border_size, -1)
    place[left.free] = np.arange(f)
    place = place[block.columns]
    out = np.zeros((len(block.segment), f))
    out[:, place[place >= 0]] = np.einsum("nm,nmc->nc", block.residual, block.by_border[..., place >= 0])
    by_knots = np.einsum("nm,nmw->nw", block.residual, block.by_knots)
    order = np.argsort(block.segment, kind="stable")
    segments, begin = np.unique(block.segment[order], return_index=True)
    for segment, rows in zip(segments, np.split(order, begin[1:]), strict=True):
        out[rows] -= by_knots[rows] @ left.knots_by_border[KNOT * segment : KNOT * segment + WIDTH]
    return out
