"""Registration of two clouds: global start, refinement with scale, GICP, and checks that may say no.

The main path is `register_clouds`; docs/registration.md explains each step and where its thresholds come from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.errors import DegenerateGeometry, EstimationError
from shared.geometry import FloatArray, IntArray, scale_of
from station.places.registration.axes import upright_rotations
from station.places.registration.beside import alignments_beside, nudge
from station.places.registration.cloud import clean_points, thin
from station.places.registration.free_space import Rays
from station.places.registration.gicp import align_gicp, require_backend
from station.places.registration.kiss import kiss_is_available, match_features
from station.places.registration.problem import RegistrationProblem, make_problem
from station.places.registration.refine import Refined, eigenvalues_of, measure_residuals, refine
from station.places.registration.result import Alternative, Backend, Gravity, Registration, Scale, refused
from station.places.registration.score import Score, score_alignment
from station.places.registration.sizes import odd_sizes, scale_range_of
from station.places.registration.verify import KNOWN_TO, OTHER_VOXELS, Findings, Rival, judge
from station.places.registration.yaw_search import Candidate, SearchConfig, search_yaw

SCALE_STEP = 1.07  # the refinement's basin in scale is about +-4 %
MANY_TURNS = SearchConfig(cells=36, coarse_cells=20)  # where scales or axes multiply them; the rank suffers little
NUM_CANDIDATES = 12  # refined; the right one is mostly among the first two
NUM_BASINS = 6  # of different alignments: refined finely, and rivals of the best one
BESIDE_VOXELS = 0.75  # farther apart, two alignments are different answers, and not the same optimum
MAX_MOVES = 2  # to a better alignment around the best one
NUDGE_SUBSET = 250
REFINE_SUBSET = 1000
SCORE_SUBSET = 1500
FINE_SUBSET = 6000
# Search radii in voxels: the global search's error is about one.
COARSE_REACHES = (2.5, 2.5, 2.0, 2.0, 1.5, 1.5, 1.0, 1.0, 1.0, 0.75, 0.75, 0.75)
FINE_REACHES = (0.75,) * 8


@dataclass(frozen=True, slots=True, eq=False)
class _Scored:
    """An alignment at a local optimum and its score by the common subsets."""

    refined: Refined
    score: Score

    @property
    def T(self) -> FloatArray:
        return self.refined.T_target_source


def register_clouds(
    target: FloatArray,
    source: FloatArray,
    *,
    scale: Scale = "known",
    gravity: Gravity = "known",
    backend: Backend = "small_gicp",
    seed: int = 0,
    target_rays: Rays | None = None,
    source_rays: Rays | None = None,
    scale_range: tuple[float, float] | None = None,
    known_to: float = KNOWN_TO,
    start: tuple[FloatArray, ...] = (),
    search: bool = True,
) -> Registration:
    """Find how the source cloud lies in the target's frame, without a guess, or say why not.

    Args:
        target: (N, 3) at least 50 points.
        source: (M, 3).
        scale: "known": both in one unit. "free": the source's scale is estimated, too.
        gravity: "known": z is up in both clouds (small tilts are corrected).
        backend: library of the GICP step.
        seed: of the random subsets; same input and seed, same answer.
        target_rays, source_rays: who saw which point, for the free-space check.
        scale_range: allowed scale when free; by default 0.78..1.28, or about the ratio of the clouds' sizes when that
            shows different units.
        known_to: how far a known scale may be off, relative: refused where the clouds, left free, say more.
        start: guesses (4, 4) to refine beside those of the global search.
        search: False refines the guesses only: something else than geometry has found them.
    Returns:
        Registration; `accepted` False with reasons when it found nothing it can stand for.
    Raises:
        DataError: an array is not (N, 3).
        ConfigError: the backend is unknown or not installed.
    """
    require_backend(backend)
    try:
        p_target, p_source = clean_points(target, "target"), clean_points(source, "source")
        scales = scale_range_of(p_target, p_source, scale, scale_range, search=search)
    except DegenerateGeometry as exc:
        return refused(str(exc), backend)
    odd = odd_sizes(p_target, p_source, scale, scales)
    problem = make_problem(
        p_target, p_source, upright=gravity == "known", free_scale=scale == "free", rng=np.random.default_rng(seed)
    )
    candidates, searches = _global_start(problem, scales) if search else ([], 1)
    candidates += [Candidate(T, 0.0) for T in start]
    subsets = problem.draw_subsets(SCORE_SUBSET)
    basins = _basins(problem, candidates, subsets)
    if not basins:
        return refused("; ".join(("no alignment has enough points in common", *odd)), backend)
    best = _finish(problem, basins[0].T, subsets, backend)
    if search:  # what found the guesses otherwise vouches for them
        best, beside = _look_beside(problem, best, basins[1:], subsets, backend)
        basins = [*basins, *beside]
    T = best.T
    rivals = sorted(
        (
            Rival(b.T, b.score, away)
            for b in basins
            if (away := problem.landed_apart(b.T, T)) > BESIDE_VOXELS * problem.voxel
        ),
        key=lambda rival: -rival.score.total,
    )
    findings = Findings(
        problem=problem,
        refined=best.refined,
        score=best.score,
        subsets=subsets,
        rivals=rivals,
        searches=searches,
        scale_range=scales,
        known_to=known_to,
        target_rays=target_rays,
        source_rays=source_rays,
        target_given=np.asarray(target, dtype=np.float64),
        source_given=np.asarray(source, dtype=np.float64),
    )
    verdict = judge(findings)
    alternatives = [
        Alternative(rival.T_target_source, float(share))
        for rival, share in zip(rivals, verdict.rivals.shares, strict=True)
        if rival.away > OTHER_VOXELS * problem.voxel
    ]
    return Registration(
        accepted=verdict.accepted,
        reasons=verdict.reasons if verdict.accepted else (*verdict.reasons, *odd),
        T_target_source=T,
        scale=scale_of(T),
        rmse=best.score.rmse,
        inlier_ratio=best.score.inlier_ratio,
        confidence=1.0 - verdict.rivals.mass,
        measured=verdict.measured,
        overlap=best.score.overlap,
        covariance=verdict.covariance,
        eigenvalues=eigenvalues_of(problem, best.refined),
        backend=backend,
        score=best.score.total,
        alternatives=tuple(alternatives[:4]),
    )


def _scales_to_try(scales: tuple[float, float]) -> FloatArray:
    """(S,) from the smallest to the largest one in steps that the refinement bridges."""
    low, high = np.log(scales)
    steps = int(np.ceil((high - low) / np.log(SCALE_STEP)))
    return np.exp(np.linspace(low, high, steps + 1))


def _global_start(problem: RegistrationProblem, scales: tuple[float, float]) -> tuple[list[Candidate], int]:
    """Coarse alignments by our own search, and KISS-Matcher's one where it is installed and the scale is known.

    And how many searches these are the best ones of.
    """
    A, B, rng = problem.target, problem.source, problem.rng
    grid = _scales_to_try(scales)
    target = A.points if len(A.points) <= 8000 else thin(A.points, 8000, rng)
    source = B.points if len(B.points) <= 8000 else thin(B.points, 8000, rng)
    config = SearchConfig() if len(grid) == 1 and problem.upright else MANY_TURNS
    if problem.upright:
        return search_yaw(target, source, scales=grid, keep=NUM_CANDIDATES, config=config), len(grid)
    found: list[Candidate] = []
    R_up, options = upright_rotations(A, B)
    for R_option in options:  # each puts one of the source's axes upright; the yaw is searched
        for c in search_yaw(target @ R_up.T, source @ R_option.T, scales=grid, keep=NUM_CANDIDATES // 2, config=config):
            T = c.T_target_source.copy()
            T[:3, 3] = R_up.T @ T[:3, 3]
            T[:3, :3] = R_up.T @ T[:3, :3] @ R_option
            found.append(Candidate(T, c.score))
    found = sorted(found, key=lambda c: -c.score)[: 2 * NUM_CANDIDATES]
    if scales[0] == scales[1] == 1.0 and kiss_is_available():
        T_kiss = match_features(target, source, upright=False, voxel=problem.voxel)
        if T_kiss is not None:
            found.append(Candidate(T_kiss, 0.0))
    return found, len(grid) * len(options)


def _basins(
    problem: RegistrationProblem, candidates: list[Candidate], subsets: tuple[IntArray, IntArray]
) -> list[_Scored]:
    """The best different alignments that the candidates lead to, best first."""
    subset = problem.draw_subsets(REFINE_SUBSET)[1]
    reaches = tuple(r * problem.voxel for r in COARSE_REACHES)
    coarse = []
    for candidate in candidates:
        nudged = nudge(problem, candidate.T_target_source, _few(subset))
        refined = refine(problem, nudged, subset=subset, reaches=reaches, tolerance=1e-3 * problem.voxel)
        if np.isfinite(refined.rms):
            coarse.append(_Scored(refined, score_alignment(problem, refined.T_target_source, subsets)))
    fine = [_polish(problem, found.T, subsets) for found in _different(problem, coarse)[:NUM_BASINS]]
    return _different(problem, fine)


def _different(problem: RegistrationProblem, found: list[_Scored]) -> list[_Scored]:
    """Best first, and of those that are one optimum the best only."""
    kept: list[_Scored] = []
    for one in sorted(found, key=lambda s: -s.score.total):
        if all(problem.landed_apart(one.T, other.T) > BESIDE_VOXELS * problem.voxel for other in kept):
            kept.append(one)
    return kept


def _polish(problem: RegistrationProblem, T: FloatArray, subsets: tuple[IntArray, IntArray]) -> _Scored:
    reaches = tuple(r * problem.voxel for r in FINE_REACHES)
    refined = refine(problem, T, subset=subsets[1], reaches=reaches, tolerance=1e-4 * problem.voxel)
    return _Scored(refined, score_alignment(problem, refined.T_target_source, subsets))


def _finish(
    problem: RegistrationProblem, T: FloatArray, subsets: tuple[IntArray, IntArray], backend: Backend
) -> _Scored:
    """GICP on the points that have a counterpart, then the joint refinement with scale and gravity."""
    A, B, voxel = problem.target, problem.source, problem.voxel
    reach = FINE_REACHES[-1] * voxel
    _, subset = problem.draw_subsets(FINE_SUBSET)

    def by_more(T: FloatArray, reaches: tuple[float, ...]) -> Refined:
        return refine(problem, T, subset=subset, reaches=reaches, tolerance=1e-4 * voxel)

    T = by_more(T, tuple(r * voxel for r in FINE_REACHES)).T_target_source
    residuals = measure_residuals(A, B.points[subset], B.normals[subset], T, reach)
    paired = np.abs(residuals.along_normal) < reach / 2
    if np.count_nonzero(paired) >= 50:
        try:
            T_gicp = align_gicp(A.points, B.points[subset][paired], T, reach=reach, backend=backend)
        except EstimationError:
            T_gicp = T  # the polished start stands; the checks judge it like any other
        if problem.landed_apart(T_gicp, T) < 2 * voxel:
            T = T_gicp
    refined = by_more(T, (reach * 0.8, reach * 0.8, reach * 0.8))
    return _Scored(refined, score_alignment(problem, refined.T_target_source, subsets))


def _look_beside(
    problem: RegistrationProblem,
    best: _Scored,
    basins: list[_Scored],
    subsets: tuple[IntArray, IntArray],
    backend: Backend,
) -> tuple[_Scored, list[_Scored]]:
    """The best alignment around `best` or of the other basins, and what else lies around it."""
    for moves_left in range(MAX_MOVES, -1, -1):
        found = alignments_beside(problem, best.T, subset=subsets[1], few=_few(subsets[1]))
        beside = [_polish(problem, refined.T_target_source, subsets) for refined in found]
        rival = max([*beside, *basins], key=lambda s: s.score.total, default=best)
        if not moves_left or rival.score.total <= best.score.total:
            break
        moved = _finish(problem, rival.T, subsets, backend)
        if moved.score.total <= best.score.total:
            break
        best = moved
    return best, beside


def _few(subset: IntArray) -> IntArray:
    """About NUDGE_SUBSET of the source's points (m,)."""
    return subset[:: max(1, len(subset) // NUDGE_SUBSET)]
