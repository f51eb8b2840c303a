"""Registration of two clouds: global start, refinement with scale, GICP, and checks that may say no.

The main path is `register_clouds`; docs/registration.md explains each step and where its thresholds come from.
"""

from __future__ import annotations

import numpy as np

from shared.errors import DegenerateGeometry, EstimationError
from shared.geometry import FloatArray, IntArray, scale_of
from station.places.registration.axes import upright_rotations
from station.places.registration.beside import alignments_beside, nudge
from station.places.registration.cloud import clean_points, thin
from station.places.registration.free_space import Rays
from station.places.registration.gicp import align_gicp, require_backend
from station.places.registration.kiss import kiss_is_available, match_features
from station.places.registration.parts import parts_apart
from station.places.registration.problem import RegistrationProblem, make_problem
from station.places.registration.refine import Refined, measure_residuals, refine
from station.places.registration.result import Alternative, Backend, Gravity, Registration, Scale, refused
from station.places.registration.score import Contrast, Score, contrast_of, score_alignment
from station.places.registration.sizes import odd_sizes, scale_range_of
from station.places.registration.verify import KNOWN_TO, Findings, judge
from station.places.registration.yaw_search import Candidate, SearchConfig, search_yaw

SCALE_STEP = 1.07  # the refinement's basin in scale is about +-4 %
MANY_CELLS = 36  # of the search where scales or axes multiply it: half the time, one rank worse at most
NUM_CANDIDATES = 8  # refined; the right one is mostly among the first two
NUM_JUDGED = 3  # different alignments whose contrast is measured
BESIDE_VOXELS = 0.75  # farther than this, an alignment around the best one is another answer, and not the same optimum
MAX_MOVES = 2  # to a better alignment around the best one
PARTS_VOXELS = 0.2  # a lidar's planes are smoother than its poses are good: the unit is no smaller than this
PROMISING = 0.97  # of the best one's inlier share, before an alignment around it is finished, too
OTHER_VOXELS = 4.0  # nearer than this, two alignments are one answer, refined more or less well
NUDGE_SUBSET = 250
REFINE_SUBSET = 1000
SCORE_SUBSET = 1500
FINE_SUBSET = 6000
# Search radii in voxels of the finer global search: its error is about one voxel.
COARSE_REACHES = (2.5, 2.5, 2.0, 2.0, 1.5, 1.5, 1.0, 1.0, 1.0, 0.75, 0.75, 0.75)
FINE_REACHES = (0.75,) * 8


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
    candidates = _global_start(problem, scales) if search else []
    candidates += [Candidate(T, 0.0) for T in start]
    ranked = _refine_and_rank(problem, candidates)
    if not ranked:
        return refused("; ".join(("no alignment has enough points in common", *odd)), backend)
    subsets = problem.draw_subsets(SCORE_SUBSET)
    judged = _contrasts(problem, ranked)
    best = _finish(problem, judged[0][0].T_target_source, backend)
    score = score_alignment(problem, best.T_target_source, subsets)
    beside: Score | None = None
    if search:  # what found the guesses otherwise vouches for them
        best, score, beside = _look_beside(problem, best, score, subsets, backend)
    T = best.T_target_source
    contrast = contrast_of(problem, T, score.inlier_share, subsets)
    parts = parts_apart(
        problem,
        T,
        subset=problem.draw_subsets(FINE_SUBSET)[1],
        reach=FINE_REACHES[-1] * problem.voxel,
        unit=max(problem.tolerance, PARTS_VOXELS * problem.voxel),
    )
    others = [(r, c) for r, c in judged if problem.landed_apart(r.T_target_source, T) > OTHER_VOXELS * problem.voxel]
    findings = Findings(
        problem=problem,
        refined=best,
        score=score,
        contrast=contrast,
        runner_up=others[0][1] if others else None,
        beside=beside,
        parts=parts,
        scale_range=scales,
        known_to=known_to,
        target_rays=target_rays,
        source_rays=source_rays,
        target_given=np.asarray(target, dtype=np.float64),
        source_given=np.asarray(source, dtype=np.float64),
    )
    verdict = judge(findings)
    return Registration(
        accepted=verdict.accepted,
        reasons=verdict.reasons if verdict.accepted else (*verdict.reasons, *odd),
        T_target_source=T,
        scale=scale_of(T),
        rmse=score.rmse,
        inlier_ratio=score.inlier_ratio,
        confidence=verdict.confidence,
        measured=findings.features() | verdict.checked,
        overlap=score.overlap,
        covariance=verdict.covariance,
        eigenvalues=verdict.eigenvalues,
        backend=backend,
        score=contrast.mean,
        alternatives=tuple(Alternative(r.T_target_source, c.mean) for r, c in others[:4]),
    )


def _global_start(problem: RegistrationProblem, scales: tuple[float, float]) -> list[Candidate]:
    """Coarse alignments by our own search, and KISS-Matcher's one where it is installed and the scale is known."""
    A, B, rng = problem.target, problem.source, problem.rng
    steps = max(1, int(np.ceil(np.log(scales[1] / scales[0]) / np.log(SCALE_STEP))) + 1) if scales[1] > scales[0] else 1
    grid = np.exp(np.linspace(np.log(scales[0]), np.log(scales[1]), steps)) if steps > 1 else np.array([scales[0]])
    target = A.points if len(A.points) <= 8000 else thin(A.points, 8000, rng)
    source = B.points if len(B.points) <= 8000 else thin(B.points, 8000, rng)
    config = SearchConfig() if steps == 1 and problem.upright else SearchConfig(cells=MANY_CELLS)
    if problem.upright:
        return search_yaw(target, source, scales=grid, keep=NUM_CANDIDATES, config=config)
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
    return found


def _refine_and_rank(problem: RegistrationProblem, candidates: list[Candidate]) -> list[tuple[Refined, Score]]:
    """Refine every candidate coarsely and sort by the share of points it explains, best first."""
    subsets = problem.draw_subsets(REFINE_SUBSET)
    subset, few = subsets[1], _few(subsets[1])
    reaches = tuple(r * problem.voxel for r in COARSE_REACHES)
    ranked = []
    for candidate in candidates:
        nudged = nudge(problem, candidate.T_target_source, few)
        refined = refine(problem, nudged, subset=subset, reaches=reaches, tolerance=1e-3 * problem.voxel)
        if np.isfinite(refined.rms):
            ranked.append((refined, score_alignment(problem, refined.T_target_source, subsets)))
    return sorted(ranked, key=lambda pair: -pair[1].inlier_share)


def _finish(problem: RegistrationProblem, T: FloatArray, backend: Backend) -> Refined:
    """GICP on the points that have a counterpart, then the joint refinement with scale and gravity."""
    A, B, voxel = problem.target, problem.source, problem.voxel
    reach = FINE_REACHES[-1] * voxel
    _, subset = problem.draw_subsets(FINE_SUBSET)

    def polish(T: FloatArray, reaches: tuple[float, ...]) -> Refined:
        return refine(problem, T, subset=subset, reaches=reaches, tolerance=1e-4 * voxel)

    T = polish(T, tuple(r * voxel for r in FINE_REACHES)).T_target_source
    residuals = measure_residuals(A, B.points[subset], B.normals[subset], T, reach)
    paired = np.abs(residuals.along_normal) < reach / 2
    if np.count_nonzero(paired) >= 50:
        try:
            T_gicp = align_gicp(A.points, B.points[subset][paired], T, reach=reach, backend=backend)
        except EstimationError:
            T_gicp = T  # the polished start stands; the checks judge it like any other
        if problem.landed_apart(T_gicp, T) < 2 * voxel:
            T = T_gicp
    return polish(T, (reach * 0.8, reach * 0.8, reach * 0.8))


def _look_beside(
    problem: RegistrationProblem, best: Refined, score: Score, subsets: tuple[IntArray, IntArray], backend: Backend
) -> tuple[Refined, Score, Score | None]:
    """The best alignment around `best` (which has `score`), its score, and that of the best one beside it, if any."""
    subset = subsets[1]
    for moves_left in range(MAX_MOVES, -1, -1):
        found = alignments_beside(problem, best.T_target_source, subset=subset, few=_few(subset))
        scored = [(r, score_alignment(problem, r.T_target_source, subsets)) for r in found]
        scored = [
            (r, other)
            for r, other in scored
            if problem.landed_apart(r.T_target_source, best.T_target_source) > BESIDE_VOXELS * problem.voxel
        ]
        if not scored:
            return best, score, None
        rival, rival_score = max(scored, key=lambda pair: pair[1].inlier_share)
        if not moves_left or rival_score.inlier_share <= PROMISING * score.inlier_share:
            break
        moved = _finish(problem, rival.T_target_source, backend)
        moved_score = score_alignment(problem, moved.T_target_source, subsets)
        if moved_score.inlier_share <= score.inlier_share:
            break
        best, score = moved, moved_score
    return best, score, rival_score


def _contrasts(problem: RegistrationProblem, ranked: list[tuple[Refined, Score]]) -> list[tuple[Refined, Contrast]]:
    """Contrast of the first few different alignments, best first; several of one basin count once."""
    subsets = problem.draw_subsets(REFINE_SUBSET)
    out: list[tuple[Refined, Contrast]] = []
    for refined, _ in ranked:
        T = refined.T_target_source
        if any(problem.landed_apart(T, other.T_target_source) < OTHER_VOXELS * problem.voxel for other, _ in out):
            continue
        share = score_alignment(problem, T, subsets).inlier_share
        out.append((refined, contrast_of(problem, T, share, subsets)))
        if len(out) == NUM_JUDGED:
            break
    return sorted(out, key=lambda pair: -pair[1].mean)


def _few(subset: IntArray) -> IntArray:
    """About NUDGE_SUBSET of the source's points (m,)."""
    return subset[:: max(1, len(subset) // NUDGE_SUBSET)]
