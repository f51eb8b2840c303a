"""Free space as basins of its clearance: wide parts that meet in narrow ones.

Every free cell has a clearance, its distance to what is not free. Lowered step by step, a water line lets each wide
part rise as a basin of its own; where two of them meet, a passage as wide as twice the clearance leads from one to the
other. This is the watershed of the distance transform (Vincent and Soille, 1991), and with its order of meetings the
persistence of rooms under dilation (Hughes et al., Hydra, 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from station.places.space.space import Cells

Labels = npt.NDArray[np.int32]  # (X, Y) 0: not free
EIGHT = np.ones((3, 3))
STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # to half of the neighbours: pairs are met once


@dataclass(frozen=True, slots=True)
class Passage:
    """Where two basins meet."""

    a: int
    b: int
    at: tuple[int, int]  # the cell of the saddle: the middle of the passage
    clearance: float  # there, in cells


@dataclass(frozen=True, slots=True, eq=False)
class Basins:
    clearance: npt.NDArray[np.float64]  # (X, Y) cells
    labels: Labels  # from 1 on
    passages: tuple[Passage, ...]  # widest first


def find_basins(free: Cells, narrowest: float) -> Basins:
    """Basins that are at least twice `narrowest` (cells) wide somewhere, and how they meet."""
    clearance = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    labels = np.zeros(free.shape, dtype=np.int32)
    for level in np.arange(np.ceil(clearance.max(initial=0.0)) - 0.5, 0.0, -1.0):
        above, count = ndimage.label(clearance > level, EIGHT)
        if level >= narrowest:
            _add_basins(labels, above, count)
        _flood(labels, above > 0)
    return Basins(clearance, labels, _passages(labels, clearance))


def _add_basins(labels: Labels, above: Labels, count: int) -> None:
    has_basin = np.zeros(count + 1, dtype=np.bool_)
    has_basin[np.unique(above[labels > 0])] = True
    has_basin[0] = True
    new = np.flatnonzero(~has_basin)
    number = np.zeros(count + 1, dtype=np.int32)
    number[new] = labels.max(initial=0) + 1 + np.arange(len(new))
    is_new = ~has_basin[above]
    labels[is_new] = number[above[is_new]]


def _flood(labels: Labels, below: Cells) -> None:
    """Each cell of `below` that the water reached joins the basin it touches."""
    while True:
        dry = below & (labels == 0)
        if not dry.any():
            return
        spread = ndimage.maximum_filter(labels, 3)
        wet = dry & (spread > 0)
        if not wet.any():
            return
        labels[wet] = spread[wet]


def _passages(labels: Labels, clearance: npt.NDArray[np.float64]) -> tuple[Passage, ...]:
    """One for each stretch of border that two basins have."""
    first, second, height = [], [], []
    cells = np.arange(labels.size).reshape(labels.shape)
    for di, dj in STEPS:
        here = (slice(0, labels.shape[0] - di), slice(max(0, -dj), labels.shape[1] - max(0, dj)))
        there = (slice(di, None), slice(max(0, dj), labels.shape[1] + min(0, dj)))
        met = (labels[here] != labels[there]) & (labels[here] > 0) & (labels[there] > 0)
        first.append(cells[here][met])
        second.append(cells[there][met])
        height.append(np.minimum(clearance[here][met], clearance[there][met]))
    one, other, level = np.concatenate(first), np.concatenate(second), np.concatenate(height)
    flat = labels.ravel()
    pair = np.sort(np.column_stack([flat[one], flat[other]]), axis=1)
    passages = []
    for a, b in np.unique(pair, axis=0):
        mine = np.flatnonzero((pair[:, 0] == a) & (pair[:, 1] == b))
        border = np.zeros(labels.shape, dtype=np.bool_)
        border.ravel()[np.concatenate([one[mine], other[mine]])] = True
        stretches, count = ndimage.label(border, EIGHT)
        of = stretches.ravel()[one[mine]]
        for k in range(1, count + 1):
            its = mine[of == k]
            if len(its):
                best = its[int(np.argmax(level[its]))]
                i, j = np.unravel_index(one[best], labels.shape)
                passages.append(Passage(int(a), int(b), (int(i), int(j)), float(level[best])))
    return tuple(sorted(passages, key=lambda p: (-p.clearance, p.a, p.b, p.at)))
