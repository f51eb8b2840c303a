"""Global start without a guess: every yaw (and scale), and by FFT every translation, of voxel occupancies.

For gravity-aligned clouds the unknowns are yaw, translation and possibly scale. Yaw and scale are stepped so that the
next step moves a point at the cloud's radius by about one voxel; for each, the correlation of the two occupancy grids
gives the score of all translations at once. All yaws and scales are tried in large voxels, and only the promising ones
again in small ones: the work grows with the fourth power of the cells. Wrong answers of this step cost little:
candidates are refined and judged afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy import fft as scipy_fft
from scipy.ndimage import gaussian_filter

from shared.geometry import FloatArray, IntArray, rotation_angle, rotation_of, scale_of, se3, transform, yaw_rotation

Float32Array = npt.NDArray[np.float32]
T = TypeVar("T")

MAX_ROOM = 3.0  # target's extents in a grid: for a source far larger than the target the voxels grow, not the grid
ROOTS = np.sqrt(np.arange(7, dtype=np.float32))  # of a voxel's points; more than six count as six


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A coarse alignment and its rank among its kind."""

    T_target_source: FloatArray  # (4, 4) with scale
    score: float


@dataclass(frozen=True, slots=True)
class SearchConfig:
    cells: int = 68  # voxels along the target's largest extent: 13 cm in a flat of 9 m
    coarse_cells: int = 30  # of the first look
    promising: float = 1 / 6  # share of the first look that is looked at again: the right one is far in front
    least_promising: int = 12  # where that share is few
    peaks_per_grid: int = 3
    workers: int = 2


@dataclass(frozen=True, slots=True)
class _Turn:
    """One yaw and scale of the source to try."""

    yaw: float
    scale: float
    step: float  # to the next yaw


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    origin: FloatArray  # (3,) x, y, z: corner of the first voxel, target frame
    voxel: float
    shape: tuple[int, int, int]  # z, y, x: the transform halves the last axis, which should not be the short one
    filled: tuple[int, int, int]  # z, y, x: voxels from the corner that the target reaches into

    def signed(self, index: tuple[int, int, int]) -> tuple[int, int, int]:
        """The translation (z, y, x) that a place in the circular correlation stands for.

        The source slides as far over the lower edges as over the upper ones: the latter half of the empty voxels is
        reached by sliding backwards.
        """
        k, j, i = (
            n - size if n > (filled + size) // 2 else n
            for n, filled, size in zip(index, self.filled, self.shape, strict=True)
        )
        return k, j, i


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Both clouds at one voxel size and one scale."""

    grid: _Grid
    spectrum: npt.NDArray[np.complex64]  # of the target's field
    centre: FloatArray  # (3,) of the source
    scale: float
    step: float  # of the yaw: moves a point at the source's radius by one voxel
    xy_voxels: Float32Array  # (2, M) scaled source about its centre
    z_flat: IntArray  # (M,) where their z leads to in the flat grid
    wrap_y: IntArray  # where a y and x lead to, from -`wrap` voxels on; negatives wrap
    wrap_x: IntArray
    wrap: int

    def turns(self) -> list[_Turn]:
        yaws = np.linspace(-np.pi, np.pi, int(np.ceil(2 * np.pi / self.step)), endpoint=False)
        return [_Turn(float(yaw), self.scale, self.step) for yaw in yaws]


def search_yaw(
    target: FloatArray,
    source: FloatArray,
    *,
    scales: FloatArray,
    keep: int,
    config: SearchConfig | None = None,
) -> list[Candidate]:
    """The best coarse alignments over all yaws, the given scales and all translations, best first.

    Args:
        target: (N, 3) z up.
        source: (M, 3) z up.
        scales: (S,) to try.
        keep: how many candidates, of different yaw, scale or translation.
    """
    config = config or SearchConfig()
    coarse = make_searches(target, source, scales, config.coarse_cells)
    fine = make_searches(target, source, scales, config.cells)
    with ThreadPoolExecutor(config.workers) as pool:
        turns = [turn for search in coarse.values() for turn in search.turns()]
        best = _in_slices(pool, config.workers, lambda turn: _best_score(coarse[turn.scale], turn), turns)
        count = max(config.least_promising, round(config.promising * len(turns)))
        promising = [turns[k] for k in np.argsort(best)[::-1][:count]]
        again = [turn for search in fine.values() for turn in _beside(search.turns(), promising)]
        batches = _in_slices(
            pool, config.workers, lambda turn: _peaks(fine[turn.scale], turn, config.peaks_per_grid), again
        )
    found = [candidate for batch in batches for candidate in batch]
    largest = fine[float(scales.max())]
    return _distinct(found, keep, largest.centre, 2.5 * largest.step, 2 * largest.grid.voxel)


def _in_slices(pool: ThreadPoolExecutor, workers: int, work: Callable[[_Turn], T], turns: list[_Turn]) -> list[T]:
    """work(turn) of every turn, in order; one task a thread, as a task costs a tenth of a turn."""
    slices = list(pool.map(lambda first: [work(turn) for turn in turns[first::workers]], range(workers)))
    return [slices[k % workers][k // workers] for k in range(len(turns))]


def make_searches(target: FloatArray, source: FloatArray, scales: FloatArray, cells: int) -> dict[float, _Search]:
    """A search for every scale: a smaller source needs less room to slide, and fewer turns."""
    low, high = np.percentile(target, [1, 99], axis=0)
    centre = np.median(source, axis=0)
    centred = source - centre
    reach = np.percentile(np.linalg.norm(centred[:, :2], axis=1), 98)
    tallness = np.percentile(np.abs(centred[:, 2]), 99)
    extent = float(np.max(high - low))  # the vertical one, too: whatever is unknown of the axes, the voxels stay
    voxel = max(extent, (extent + max(reach, tallness) * float(scales.max())) / MAX_ROOM) / cells
    radius = float(np.sqrt(np.mean(centred[:, :2] ** 2) * 2))

    def grid_at(scale: float) -> _Grid:
        # The source slides until half of it hangs over the target's edge: circular wrap-around then costs nothing.
        margin = np.array([reach, reach, tallness]) * scale
        filled = np.ceil((high - low) / voxel) + 4
        nx, ny, nz = (int(scipy_fft.next_fast_len(int(n), real=True)) for n in filled + np.ceil(margin / voxel))
        fx, fy, fz = (int(n) for n in filled)
        return _Grid(low - 2 * voxel, voxel, (nz, ny, nx), (fz, fy, fx))

    field = _target_field(target, grid_at(float(scales.max())))
    out = {}
    for scale in map(float, scales):
        grid = grid_at(scale)
        nz, ny, nx = grid.shape
        spectrum = scipy_fft.rfftn(field[:nz, :ny, :nx])
        in_voxels = centred * (scale / voxel)
        # A point farther out than the grid is wide could only land by wrapping around.
        wrap = max(nx, ny) + 1
        inside = (np.linalg.norm(in_voxels[:, :2], axis=1) < wrap - 1) & (np.abs(in_voxels[:, 2]) < nz)
        in_voxels = in_voxels[inside]
        around = np.arange(-wrap, wrap + 1)
        out[scale] = _Search(
            grid=grid,
            spectrum=spectrum,
            centre=centre,
            scale=scale,
            step=voxel / max(radius * scale, voxel),
            xy_voxels=np.ascontiguousarray(in_voxels[:, :2].T, dtype=np.float32),
            z_flat=np.floor(in_voxels[:, 2]).astype(np.int64) % nz * (ny * nx),
            wrap_y=around % ny * nx,
            wrap_x=around % nx,
            wrap=wrap,
        )
    return out


def _beside(turns: list[_Turn], promising: list[_Turn]) -> list[_Turn]:
    """The fine turns of one scale that fall to promising coarse ones: half a step of each."""
    others = [other for other in promising if turns and other.scale == turns[0].scale]
    if not others:
        return []
    yaws, other_yaws = np.array([turn.yaw for turn in turns]), np.array([other.yaw for other in others])
    apart = np.abs((yaws[:, None] - other_yaws + np.pi) % (2 * np.pi) - np.pi)
    near = (apart <= (turns[0].step + others[0].step) / 2).any(axis=1)
    return [turns[k] for k in np.flatnonzero(near)]


def _target_field(points: FloatArray, grid: _Grid) -> Float32Array:
    """Smoothed occupancy, less its wide average: large blobs must not attract everything."""
    index = np.floor((points - grid.origin) / grid.voxel).astype(np.int64)[:, ::-1] % np.array(grid.shape)
    occupancy = _occupancy(np.ravel_multi_index((index[:, 0], index[:, 1], index[:, 2]), grid.shape), grid.shape)
    sharp = gaussian_filter(occupancy, 0.7, mode="constant")
    wide = gaussian_filter(occupancy, 2.5, mode="constant")
    return (sharp - wide).astype(np.float32)


def _occupancy(flat: IntArray, shape: tuple[int, int, int]) -> Float32Array:
    """Points per voxel, compressed: a poster with a hundred landmarks must not outweigh a wall with ten."""
    out = np.zeros(shape[0] * shape[1] * shape[2], dtype=np.float32)
    count = np.bincount(flat, minlength=len(out))[flat]
    out[flat] = ROOTS[np.minimum(count, len(ROOTS) - 1)]
    return out.reshape(shape)


def _correlate(search: _Search, turn: _Turn) -> tuple[Float32Array, float]:
    """The score of every translation of the source turned so (z, y, x), times the norm, which is returned, too."""
    cosine, sine = np.float32(np.cos(turn.yaw)), np.float32(np.sin(turn.yaw))
    x, y = search.xy_voxels
    # Drawn around the grid's corner, so that shift (k, j, i) puts its centre there. All are positive: this floors.
    index_x = (cosine * x - sine * y + np.float32(search.wrap)).astype(np.int64)
    index_y = (sine * x + cosine * y + np.float32(search.wrap)).astype(np.int64)
    occupancy = _occupancy(search.z_flat + search.wrap_y[index_y] + search.wrap_x[index_x], search.grid.shape)
    norm = float(np.linalg.norm(occupancy))
    product = scipy_fft.rfftn(occupancy, overwrite_x=True)
    np.conj(product, out=product)
    product *= search.spectrum
    return scipy_fft.irfftn(product, s=search.grid.shape, overwrite_x=True), norm


def _best_score(search: _Search, turn: _Turn) -> float:
    score, norm = _correlate(search, turn)
    return float(score.max()) / norm


def _peaks(search: _Search, turn: _Turn, count: int) -> list[Candidate]:
    """The best translations of the source turned so, best first."""
    grid = search.grid
    R = turn.scale * yaw_rotation(turn.yaw)
    score, norm = _correlate(search, turn)
    out = []
    for _ in range(count):
        best = int(np.argmax(score))
        k, j, i = (int(n) for n in np.unravel_index(best, grid.shape))
        value = float(score[k, j, i])
        up, back, right = grid.signed((k, j, i))
        offset = np.array([right, back, up]) * grid.voxel + grid.origin  # where the source's centre lands
        out.append(Candidate(se3(R, offset - R @ search.centre), value / norm))
        score[max(0, k - 2) : k + 3, max(0, j - 2) : j + 3, max(0, i - 2) : i + 3] = -np.inf
    return out


def _distinct(found: list[Candidate], keep: int, centre: FloatArray, yaw_gap: float, gap: float) -> list[Candidate]:
    """The best candidates, none within one step of a better one."""
    found = sorted(found, key=lambda c: -c.score)
    kept: list[Candidate] = []
    for candidate in found:
        if all(_differ(candidate, other, centre, yaw_gap, gap) for other in kept):
            kept.append(candidate)
            if len(kept) == keep:
                break
    return kept


def _differ(a: Candidate, b: Candidate, centre: FloatArray, yaw_gap: float, gap: float) -> bool:
    A, B = a.T_target_source, b.T_target_source
    angle = rotation_angle(rotation_of(A).T @ rotation_of(B))
    if angle > yaw_gap or abs(np.log(scale_of(A) / scale_of(B))) > 0.05:
        return True
    return bool(np.linalg.norm(transform(A - B, centre)) > gap)
