"""Registration of two clouds: global start, refinement with scale, GICP, and checks that may say no.

The main path is `register_clouds`; docs/registration.md explains each step and where its thresholds come from.
"""

from __future__ import annotations

import numpy as np

from shared.errors import DataError, DegenerateGeometry, EstimationError
from shared.geometry import FloatArray, IntArray, scale_of
from station.places.registration.axes import upright_rotations
from station.places.registration.beside import alignments_beside
from station.places.registration.cloud import PreparedCloud, clean_points, prepare_cloud, thin
from station.places.registration.free_space import Rays
from station.places.registration.gicp import align_gicp, require_backend
from station.places.registration.kiss import kiss_is_available, match_features
from station.places.registration.nudge import nudge
from station.places.registration.parts import parts_apart
from station.places.registration.refine import Refined, measure_residuals, refine
from station.places.registration.result import Alternative, Backend, Gravity, Registration, Scale, refused
from station.places.registration.score import Contrast, Score, contrast_of, landed_apart, score_alignment
from station.places.registration.verify import KNOWN_TO, Evidence, judge
from station.places.registration.yaw_search import Candidate, SearchConfig, search_yaw

FREE_SCALE_RANGE = (0.78, 1.28)  # clouds in one unit: the scale drift of visual SLAM, and a margin
ARBITRARY_SCALE_RANGE = (0.55, 1.8)  # about the ratio of the sizes, when a gauge is arbitrary
MAX_SIZE_RATIO = 4.0  # parts of one flat in one unit differ less in size
UNIT_RATIO = 30.0  # from here on sizes in one unit are not even searched; an inch is a 39th of a metre
ODD_RATIO = 2.0  # from here on a refusal mentions the sizes: a foot is a third of a metre
SCALE_STEP = 1.07  # the refinement's basin in scale is about +-4 %
MANY_CELLS = 36  # of the search where scales or axes multiply it: half the time, one rank worse at most
NUM_CANDIDATES = 8  # refined; the right one was among the first two in 40 of 40 training pairs
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
        ranges = _scale_range(p_target, p_source, scale, scale_range, search=search)
    except DegenerateGeometry as exc:
        return refused(str(exc), backend)
    odd_sizes = _odd_sizes(p_target, p_source, scale, ranges)
    rng = np.random.default_rng(seed)
    A, B = prepare_cloud(p_target, rng), prepare_cloud(p_source, rng)
    voxel = float(np.max(np.ptp(np.percentile(A.points, [1, 99], axis=0), axis=0)[:2])) / SearchConfig().cells
    candidates = _global_start(A, B, ranges, gravity, voxel, rng) if search else []
    candidates += [Candidate(T, 0.0) for T in start]
    ranked = _refine_and_rank(A, B, candidates, gravity, scale, voxel, rng)
    if not ranked:
        return refused("; ".join(("no alignment has enough points in common", *odd_sizes)), backend)
    tolerance = _tolerance(A, B)
    subsets = _subsets(A, B, rng, SCORE_SUBSET)
    judged = _contrasts(A, B, ranked, voxel, tolerance, rng)
    best = _finish(A, B, judged[0][0].T_target_source, gravity, scale, voxel, backend, rng)
    score = score_alignment(A, B, best.T_target_source, *subsets, tolerance)
    beside: Score | None = None
    if search:  # what found the guesses otherwise vouches for them
        best, score, beside = _look_beside(A, B, best, score, subsets, gravity, scale, voxel, backend, rng)
    contrast = contrast_of(A, B, best.T_target_source, score.inlier_share, *subsets, tolerance)
    parts = parts_apart(
        A,
        B,
        best.T_target_source,
        R_up=_upright(A, B, gravity),
        subset=_subsets(A, B, rng, FINE_SUBSET)[1],
        reach=FINE_REACHES[-1] * voxel,
        unit=max(tolerance, PARTS_VOXELS * voxel),
        upright=gravity == "known",
        free_scale=scale == "free",
        rng=rng,
    )
    others = [
        (r, c) for r, c in judged if landed_apart(r.T_target_source, best.T_target_source, B) > OTHER_VOXELS * voxel
    ]
    evidence = Evidence(
        target=A,
        source=B,
        refined=best,
        score=score,
        contrast=contrast,
        runner_up=others[0][1] if others else None,
        beside=beside,
        parts=parts,
        tolerance=tolerance,
        voxel=voxel,
        scale=scale,
        scale_range=ranges,
        known_to=known_to,
        gravity=gravity,
        target_rays=target_rays,
        source_rays=source_rays,
        target_given=np.asarray(target, dtype=np.float64),
        source_given=np.asarray(source, dtype=np.float64),
    )
    verdict = judge(evidence, rng)
    return Registration(
        accepted=verdict.accepted,
        reasons=verdict.reasons if verdict.accepted else (*verdict.reasons, *odd_sizes),
        T_target_source=best.T_target_source,
        scale=scale_of(best.T_target_source),
        rmse=score.rmse,
        inlier_ratio=score.inlier_ratio,
        confidence=verdict.confidence,
        evidence=evidence.features() | verdict.checked,
        overlap=score.overlap,
        covariance=verdict.covariance,
        eigenvalues=verdict.eigenvalues,
        backend=backend,
        score=contrast.mean,
        alternatives=tuple(Alternative(r.T_target_source, c.mean) for r, c in others[:4]),
    )


def _scale_range(
    target: FloatArray, source: FloatArray, scale: Scale, given: tuple[float, float] | None, *, search: bool
) -> tuple[float, float]:
    """Smallest and largest scale to consider. Raises DegenerateGeometry when known scales cannot be right.

    Without a search something else vouches for them: a room may be a small part of a large map.
    """
    ratio = _size(target) / _size(source)
    odd = not 1 / MAX_SIZE_RATIO < ratio < MAX_SIZE_RATIO
    if scale == "known":
        if search and not 1 / UNIT_RATIO < ratio < UNIT_RATIO:
            raise DegenerateGeometry(
                f"{_larger(ratio)}: the clouds seem to be in different units; convert one, or use scale free"
            )
        return (1.0, 1.0)
    if given is not None:
        if not 0 < given[0] <= given[1]:
            raise DataError(f"scale_range {given} must be two positive numbers, smaller first")
        return given
    low, high = ARBITRARY_SCALE_RANGE if odd else FREE_SCALE_RANGE
    return (ratio * low, ratio * high) if odd else (low, high)


def _larger(ratio: float) -> str:
    """Which cloud is how much larger; `ratio` is the target's size by the source's."""
    if ratio >= 1:
        return f"the target is {ratio:.3g} times the source's size"
    return f"the source is {1 / ratio:.3g} times the target's size"


def _odd_sizes(target: FloatArray, source: FloatArray, scale: Scale, scales: tuple[float, float]) -> tuple[str, ...]:
    """What else a refusal may come from: a unit, where sizes differ by more than the scales that were tried."""
    ratio = _size(target) / _size(source)
    if 1 / ODD_RATIO < ratio < ODD_RATIO or scales[0] <= ratio <= scales[1]:
        return ()
    remedy = f", as scales of {scales[0]:.3g} to {scales[1]:.3g} were tried"
    if scale == "known":
        low, high = _scale_range(target, source, "free", None, search=True)
        remedy = ", or use scale free" if low <= ratio <= high else ""
    return (f"{_larger(ratio)}: if they are in different units, convert one{remedy}",)


def _size(points: FloatArray) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _global_start(
    A: PreparedCloud,
    B: PreparedCloud,
    scales: tuple[float, float],
    gravity: Gravity,
    voxel: float,
    rng: np.random.Generator,
) -> list[Candidate]:
    """Coarse alignments by our own search, and KISS-Matcher's one where it is installed and the scale is known."""
    steps = max(1, int(np.ceil(np.log(scales[1] / scales[0]) / np.log(SCALE_STEP))) + 1) if scales[1] > scales[0] else 1
    grid = np.exp(np.linspace(np.log(scales[0]), np.log(scales[1]), steps)) if steps > 1 else np.array([scales[0]])
    target = A.points if len(A.points) <= 8000 else thin(A.points, 8000, rng)
    source = B.points if len(B.points) <= 8000 else thin(B.points, 8000, rng)
    found: list[Candidate] = []
    config = SearchConfig() if steps == 1 and gravity == "known" else SearchConfig(cells=MANY_CELLS)
    if gravity == "known":
        found = search_yaw(target, source, scales=grid, keep=NUM_CANDIDATES, config=config)
    else:
        R_up, options = upright_rotations(A, B)
        for R_option in options:  # each puts one of the source's axes upright; the yaw is searched
            for c in search_yaw(
                target @ R_up.T, source @ R_option.T, scales=grid, keep=NUM_CANDIDATES // 2, config=config
            ):
                T = c.T_target_source.copy()
                T[:3, 3] = R_up.T @ T[:3, 3]
                T[:3, :3] = R_up.T @ T[:3, :3] @ R_option
                found.append(Candidate(T, c.score))
        found = sorted(found, key=lambda c: -c.score)[: 2 * NUM_CANDIDATES]
    if scales[0] == scales[1] == 1.0 and gravity == "unknown" and kiss_is_available():
        T_kiss = match_features(target, source, upright=False, voxel=voxel)
        if T_kiss is not None:
            found.append(Candidate(T_kiss, 0.0))
    return found


def _refine_and_rank(
    A: PreparedCloud,
    B: PreparedCloud,
    candidates: list[Candidate],
    gravity: Gravity,
    scale: Scale,
    voxel: float,
    rng: np.random.Generator,
) -> list[tuple[Refined, Score]]:
    """Refine every candidate coarsely and sort by the share of points it explains, best first."""
    subset_A, subset_B = _subsets(A, B, rng, REFINE_SUBSET)
    reaches = tuple(r * voxel for r in COARSE_REACHES)
    tolerance = _tolerance(A, B)
    R_up = _upright(A, B, gravity)
    few = subset_B[:: max(1, len(subset_B) // NUDGE_SUBSET)]
    ranked = []
    for candidate in candidates:
        refined = refine(
            A,
            B,
            nudge(A, B, candidate.T_target_source, R_up, few, voxel),
            subset=subset_B,
            reaches=reaches,
            upright=gravity == "known",
            free_scale=scale == "free",
            tolerance=1e-3 * voxel,
        )
        if np.isfinite(refined.rms):
            ranked.append((refined, score_alignment(A, B, refined.T_target_source, subset_A, subset_B, tolerance)))
    return sorted(ranked, key=lambda pair: -pair[1].inlier_share)


def _finish(
    A: PreparedCloud,
    B: PreparedCloud,
    T: FloatArray,
    gravity: Gravity,
    scale: Scale,
    voxel: float,
    backend: Backend,
    rng: np.random.Generator,
) -> Refined:
    """GICP on the points that have a counterpart, then the joint refinement with scale and gravity."""
    reach = FINE_REACHES[-1] * voxel
    _, subset = _subsets(A, B, rng, FINE_SUBSET)

    def polish(T: FloatArray, reaches: tuple[float, ...]) -> Refined:
        return refine(
            A,
            B,
            T,
            subset=subset,
            reaches=reaches,
            upright=gravity == "known",
            free_scale=scale == "free",
            tolerance=1e-4 * voxel,
        )

    T = polish(T, tuple(r * voxel for r in FINE_REACHES)).T_target_source
    residuals = measure_residuals(A, B.points[subset], B.normals[subset], T, reach)
    paired = np.abs(residuals.along_normal) < reach / 2
    if np.count_nonzero(paired) >= 50:
        try:
            T_gicp = align_gicp(A.points, B.points[subset][paired], T, reach=reach, backend=backend)
        except EstimationError:
            T_gicp = T  # the polished start stands; the checks judge it like any other
        if landed_apart(T_gicp, T, B) < 2 * voxel:
            T = T_gicp
    return polish(T, (reach * 0.8, reach * 0.8, reach * 0.8))


def _look_beside(
    A: PreparedCloud,
    B: PreparedCloud,
    best: Refined,
    score: Score,
    subsets: tuple[IntArray, IntArray],
    gravity: Gravity,
    scale: Scale,
    voxel: float,
    backend: Backend,
    rng: np.random.Generator,
) -> tuple[Refined, Score, Score | None]:
    """The best alignment around `best` (which has `score`), its score, and that of the best one beside it, if any."""
    tolerance = _tolerance(A, B)
    R_up = _upright(A, B, gravity)
    subset_B = subsets[1]
    for moves_left in range(MAX_MOVES, -1, -1):
        found = alignments_beside(
            A,
            B,
            best.T_target_source,
            R_up=R_up,
            subset=subset_B,
            few=subset_B[:: max(1, len(subset_B) // NUDGE_SUBSET)],
            voxel=voxel,
            upright=gravity == "known",
            free_scale=scale == "free",
        )
        scored = [(r, score_alignment(A, B, r.T_target_source, *subsets, tolerance)) for r in found]
        scored = [
            (r, other)
            for r, other in scored
            if landed_apart(r.T_target_source, best.T_target_source, B) > BESIDE_VOXELS * voxel
        ]
        if not scored:
            return best, score, None
        rival, rival_score = max(scored, key=lambda pair: pair[1].inlier_share)
        if not moves_left or rival_score.inlier_share <= PROMISING * score.inlier_share:
            break
        moved = _finish(A, B, rival.T_target_source, gravity, scale, voxel, backend, rng)
        moved_score = score_alignment(A, B, moved.T_target_source, *subsets, tolerance)
        if moved_score.inlier_share <= score.inlier_share:
            break
        best, score = moved, moved_score
    return best, score, rival_score


def _contrasts(
    A: PreparedCloud,
    B: PreparedCloud,
    ranked: list[tuple[Refined, Score]],
    voxel: float,
    tolerance: float,
    rng: np.random.Generator,
) -> list[tuple[Refined, Contrast]]:
    """Contrast of the first few different alignments, best first; several of one basin count once."""
    subsets = _subsets(A, B, rng, REFINE_SUBSET)
    out: list[tuple[Refined, Contrast]] = []
    for refined, _ in ranked:
        T = refined.T_target_source
        if any(landed_apart(T, other.T_target_source, B) < OTHER_VOXELS * voxel for other, _ in out):
            continue
        share = score_alignment(A, B, T, *subsets, tolerance).inlier_share
        out.append((refined, contrast_of(A, B, T, share, *subsets, tolerance)))
        if len(out) == NUM_JUDGED:
            break
    return sorted(out, key=lambda pair: -pair[1].mean)


def _upright(A: PreparedCloud, B: PreparedCloud, gravity: Gravity) -> FloatArray:
    """The rotation (3, 3) that puts the target's vertical along z."""
    return np.eye(3) if gravity == "known" else upright_rotations(A, B)[0]


def _tolerance(A: PreparedCloud, B: PreparedCloud) -> float:
    """How far from a surface its own landmarks lie: three times the noise seen in the clouds."""
    return 3.0 * max(A.noise, min(B.noise, 2 * A.noise), 0.05 * A.spacing)


def _subsets(A: PreparedCloud, B: PreparedCloud, rng: np.random.Generator, count: int) -> tuple[IntArray, IntArray]:
    return tuple(  # type: ignore[return-value]
        np.sort(rng.choice(len(cloud.points), size=min(count, len(cloud.points)), replace=False)) for cloud in (A, B)
    )
