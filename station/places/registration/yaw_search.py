"""Global start without a guess: every yaw (and scale), and by FFT every translation, of voxel occupancies.

For gravity-aligned clouds the unknowns are yaw, translation and possibly scale. Yaw and scale are stepped so that the
next step moves a point at the cloud's radius by about one voxel; for each, the correlation of the two occupancy grids
gives the score of all translations at once. All yaws and scales are tried in large voxels, and only the promising ones
again in small ones: the work grows with the fourth power of the cells. Wrong answers of this step cost little:
candidates are refined and judged afterwards.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft as scipy_fft
from scipy.ndimage import gaussian_filter

from shared.geometry import FloatArray, se3, yaw_rotation

Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A coarse alignment and its rank among its kind."""

    T_target_source: FloatArray  # (4, 4) with scale
    score: float


@dataclass(frozen=True, slots=True)
class SearchConfig:
    """How finely to look."""

    cells: int = 44  # voxels along the target's larger horizontal extent: 20 cm in a flat of 9 m
    coarse_cells: int = 20  # of the first look
    promising: float = 1 / 6  # share of the first look that is looked at again; the right one was in the first 1/29
    least_promising: int = 12  # in 20 of 20 training pairs, and among the first three where the scale is known
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
    origin: FloatArray  # (3,) corner of the first voxel, target frame
    voxel: float
    shape: tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Both clouds at one voxel size."""

    grid: _Grid
    spectrum: npt.NDArray[np.complex64]  # of the target's field
    centred: FloatArray  # (M, 3) source about its centre
    centre: FloatArray  # (3,)
    step: float  # of the yaw: moves a point at the source's radius by one voxel

    def turns(self, scales: FloatArray) -> list[_Turn]:
        """Every yaw and scale, evenly."""
        yaws = np.linspace(-np.pi, np.pi, int(np.ceil(2 * np.pi / self.step)), endpoint=False)
        return [_Turn(float(yaw), float(scale), self.step) for scale in scales for yaw in yaws]


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
    coarse = _make_search(target, source, float(scales.max()), config.coarse_cells)
    fine = _make_search(target, source, float(scales.max()), config.cells)
    with ThreadPoolExecutor(config.workers) as pool:
        turns = coarse.turns(scales)
        best = [found[0].score for found in pool.map(lambda turn: _correlate(coarse, turn, 1), turns, chunksize=8)]
        count = max(config.least_promising, round(config.promising * len(turns)))
        promising = [turns[k] for k in np.argsort(best)[::-1][:count]]
        again = [turn for turn in fine.turns(scales) if any(_beside(turn, other) for other in promising)]
        batches = pool.map(lambda turn: _correlate(fine, turn, config.peaks_per_grid), again, chunksize=8)
        found = [candidate for batch in batches for candidate in batch]
    return _distinct(found, keep, fine.centre, 2.5 * fine.step, 2 * fine.grid.voxel)


def _make_search(target: FloatArray, source: FloatArray, largest: float, cells: int) -> _Search:
    low, high = np.percentile(target, 1, axis=0), np.percentile(target, 99, axis=0)
    voxel = float(np.max((high - low)[:2])) / cells
    centre = np.median(source, axis=0)
    centred = source - centre
    reach = np.percentile(np.linalg.norm(centred[:, :2], axis=1), 98)
    tallness = np.percentile(np.abs(centred[:, 2]), 99)
    # The source slides until half of it hangs over the target's edge: circular wrap-around then costs nothing.
    margin = np.array([reach, reach, tallness]) * largest
    shape = tuple(int(scipy_fft.next_fast_len(int(n), real=True)) for n in np.ceil((high - low + margin) / voxel) + 4)
    grid = _Grid(low - 2 * voxel, voxel, (shape[0], shape[1], shape[2]))
    step = voxel / max(float(np.sqrt(np.mean(centred[:, :2] ** 2) * 2)) * largest, voxel)
    return _Search(grid, scipy_fft.rfftn(_target_field(target, grid)), centred, centre, step)


def _beside(turn: _Turn, other: _Turn) -> bool:
    """Whether a fine turn falls to this coarse one: half a step of each."""
    apart = abs((turn.yaw - other.yaw + np.pi) % (2 * np.pi) - np.pi)
    return turn.scale == other.scale and apart <= (turn.step + other.step) / 2


def _target_field(points: FloatArray, grid: _Grid) -> Float32Array:
    """Smoothed occupancy, less its wide average: large blobs must not attract everything."""
    occupancy = _rasterise(points, grid)
    sharp = gaussian_filter(occupancy, 0.7, mode="constant")
    wide = gaussian_filter(occupancy, 2.5, mode="constant")
    return (sharp - wide).astype(np.float32)


def _rasterise(points: FloatArray, grid: _Grid) -> Float32Array:
    """Occupancy, compressed: a poster with a hundred landmarks must not outweigh a wall with ten."""
    index = np.floor((points - grid.origin) / grid.voxel).astype(np.int64)
    index %= np.array(grid.shape)
    flat = np.ravel_multi_index((index[:, 0], index[:, 1], index[:, 2]), grid.shape)
    count = np.bincount(flat, minlength=int(np.prod(grid.shape))).astype(np.float32)
    return np.sqrt(np.minimum(count, 6.0)).reshape(grid.shape)


def _correlate(search: _Search, turn: _Turn, peaks: int) -> list[Candidate]:
    """The best translations of the source turned so, best first."""
    grid = search.grid
    R = turn.scale * yaw_rotation(turn.yaw)
    # The source is drawn around the grid's corner, so that shift (i, j, k) puts its centre there; negatives wrap.
    occupancy = _rasterise(search.centred @ R.T + grid.origin, grid)
    norm = float(np.linalg.norm(occupancy))
    score = scipy_fft.irfftn(search.spectrum * np.conj(scipy_fft.rfftn(occupancy)), s=grid.shape)
    out = []
    for _ in range(peaks):
        best = int(np.argmax(score))
        i, j, k = (int(n) for n in np.unravel_index(best, grid.shape))
        value = float(score[i, j, k])
        offset = np.array([i, j, k]) * grid.voxel + grid.origin  # where the source's centre lands
        out.append(Candidate(se3(R, offset - R @ search.centre), value / norm))
        score[max(0, i - 2) : i + 3, max(0, j - 2) : j + 3, max(0, k - 2) : k + 3] = -np.inf
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
    scale_a, scale_b = np.cbrt(np.linalg.det(A[:3, :3])), np.cbrt(np.linalg.det(B[:3, :3]))
    cosine = (np.trace(A[:3, :3].T @ B[:3, :3]) / (scale_a * scale_b) - 1) / 2
    if np.arccos(np.clip(cosine, -1, 1)) > yaw_gap or abs(np.log(scale_a / scale_b)) > 0.05:
        return True
    landed = (A[:3, :3] - B[:3, :3]) @ centre + A[:3, 3] - B[:3, 3]
    return bool(np.linalg.norm(landed) > gap)
