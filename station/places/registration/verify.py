"""The verdict: does the answer stay when the data are resampled, do the clouds share enough, is the space free?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse_sim3, scale_of, transform
from station.places.registration.bootstrap import DRAWS, Rivalry, compare, spread_of
from station.places.registration.free_space import Rays, Watched, watched_points
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import Refined, refine
from station.places.registration.score import Score

MAX_RIVAL_MASS = 0.02  # for one scale and one vertical; more are more chances to find something by accident
OTHER_VOXELS = 4.0  # nearer than this, two alignments are one answer, refined more or less well
MIN_OVERLAP = 0.2
MAX_SCALE_SIGMA = 0.015  # of a free scale, and of a known one that moves when it is left free
MAX_TILT_RAD = np.radians(6.0)  # of two clouds that have z up
MAX_VIOLATION = 0.5
MIN_WATCHED = 30  # points in watched space; a share of fewer says nothing
# How far a known scale may move once it is left free, unless the caller knows it less well. Right scales of clouds of
# thousands of points move by less; those of some hundred may move farther, but not by three standard deviations.
KNOWN_TO = 0.01
FREED_SIGMAS = 3.0
# Search radii in voxels of that. Wide at first, as at 5 % the far ends of a flat lie two voxels off; still wider ones
# may lead right answers with little overlap astray.
FREED_REACHES = (1.5, 1.5, 1.0, 1.0, *(0.75,) * 6, *(0.6,) * 3)
FREED_SUBSET = 6000


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another alignment, and how it explains the clouds."""

    T_target_source: FloatArray  # (4, 4) with scale
    score: Score
    away: float  # median distance between where it and the answer put the source's points, target units


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """All that the verdict is based on."""

    problem: RegistrationProblem
    refined: Refined
    score: Score
    subsets: tuple[IntArray, IntArray]  # of target and source: the points that all scores are of
    rivals: list[Rival]
    searches: int  # scales and verticals tried: each is another chance to find something by accident
    scale_range: tuple[float, float]
    known_to: float  # how far a known scale may be off, relative
    target_rays: Rays | None
    source_rays: Rays | None
    target_given: FloatArray  # the clouds as the rays index them
    source_given: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    accepted: bool
    reasons: tuple[str, ...]
    rivals: Rivalry
    covariance: FloatArray | None  # (7, 7), see Registration
    # What was measured, as far as it was:
    # "rival mass": Rivalry.mass;
    # "scale spread": one standard deviation of a free scale, relative;
    # "free-space violation": share of the watched points that would hang where the other navigation saw through;
    # "watched points": how many those are;
    # "freed scale": what a known scale becomes where it is left free, relative to what it was;
    # "freed scale's noise": one standard deviation of that, measured only where it moved far.
    measured: dict[str, float]


def judge(e: Findings) -> Verdict:
    """Every check that fails adds a reason; none failed means accepted."""
    T = e.refined.T_target_source
    rivals = compare(e.problem, T, e.score, [rival.score for rival in e.rivals], e.subsets)
    covariance = spread_of(e.problem, T)
    watched = _watched(e)
    measured = {"rival mass": rivals.mass}
    if e.problem.free_scale and covariance is not None:
        measured["scale spread"] = float(np.sqrt(covariance[6, 6]))
    if watched.points:
        measured |= {"free-space violation": watched.share, "watched points": watched.points}
    against = [
        *_rivals_against(e, rivals),
        *_overlap_against(e.score),
        *_scale_against(e, covariance),
        *_tilt_against(e),
        *_free_space_against(watched),
    ]
    if not e.problem.free_scale and not against:  # the rest refuses most others without this cost
        freed = _freed_scale(e)
        measured |= freed
        against += _unit_against(e, freed)
    reasons = tuple(against) or (
        f"another alignment explains the clouds better in {rivals.mass:.1%} of {DRAWS} draws of their parts; "
        f"{e.score.inlier_ratio:.0%} of the points near the other cloud lie on its surfaces",
    )
    return Verdict(not against, reasons, rivals, covariance, measured)


def _rivals_against(e: Findings, rivals: Rivalry) -> list[str]:
    allowed = MAX_RIVAL_MASS / e.searches  # Bonferroni's correction
    if rivals.mass <= allowed:
        return []
    away = e.rivals[int(np.argmax(rivals.shares))].away
    meaning = (
        f"the clouds can slide, by {away:.2g}"
        if away < OTHER_VOXELS * e.problem.voxel
        else "the room looks alike from there, or these are different rooms"
    )
    return [
        f"another alignment explains the clouds better in {rivals.mass:.1%} of the draws of their parts, and "
        f"{allowed:.2%} are allowed: {meaning}"
    ]


def _overlap_against(score: Score) -> list[str]:
    if score.overlap >= MIN_OVERLAP:
        return []
    return [f"the clouds share {score.overlap:.0%} of their space, needs {MIN_OVERLAP:.0%}"]


def _scale_against(e: Findings, covariance: FloatArray | None) -> list[str]:
    """A free scale that left its range, or that is not known."""
    if not e.problem.free_scale:
        return []
    against = []
    scale, (low, high) = scale_of(e.refined.T_target_source), e.scale_range
    if not low * 0.97 < scale < high * 1.03:
        against.append(f"scale {scale:.3f} is outside the allowed {low:.2f} to {high:.2f}")
    sigma = float(np.sqrt(covariance[6, 6])) if covariance is not None else np.inf
    if sigma > MAX_SCALE_SIGMA:
        against.append(
            f"the scale is known to {sigma:.1%} (one standard deviation) only, and {MAX_SCALE_SIGMA:.1%} is asked"
        )
    return against


def _tilt_against(e: Findings) -> list[str]:
    up = e.refined.T_target_source[:3, 2]
    tilt = float(np.arccos(np.clip(up[2] / np.linalg.norm(up), -1, 1)))
    if not e.problem.upright or tilt <= MAX_TILT_RAD:
        return []
    return [f"the result tilts the source by {np.degrees(tilt):.1f} degrees, though z is up in both"]


def _free_space_against(watched: Watched) -> list[str]:
    if watched.points < MIN_WATCHED or watched.share <= MAX_VIOLATION:
        return []
    return [f"{watched.share:.0%} of the points would hang where the other navigation saw through empty space"]


def _watched(e: Findings) -> Watched:
    """What free space says: of both directions that with enough points and the larger share; no points without rays."""
    T, problem = e.refined.T_target_source, e.problem
    found = [Watched(0, 0)]
    if e.target_rays is not None:
        moved = transform(T, problem.source.points)
        found.append(watched_points(e.target_given, e.target_rays, moved, problem.voxel, problem.rng))
    if e.source_rays is not None:
        moved = transform(inverse_sim3(T), problem.target.points)
        found.append(watched_points(e.source_given, e.source_rays, moved, problem.voxel / scale_of(T), problem.rng))
    return max(found, key=lambda w: (w.points >= MIN_WATCHED, w.share if w.points else -1.0))


def _freed_scale(e: Findings) -> dict[str, float]:
    """What the known scale becomes where it is free; nothing where too few points meet."""
    T, voxel = e.refined.T_target_source, e.problem.voxel
    problem = replace(e.problem, free_scale=True)
    reaches = tuple(r * voxel for r in FREED_REACHES)
    subset = problem.draw_subsets(FREED_SUBSET)[1]
    freed = refine(problem, T, subset=subset, reaches=reaches, tolerance=1e-4 * voxel)
    if not np.isfinite(freed.rms):
        return {}
    out = {"freed scale": scale_of(freed.T_target_source) / scale_of(T)}
    if abs(np.log(out["freed scale"])) > e.known_to:
        covariance = spread_of(problem, freed.T_target_source)
        if covariance is not None:  # else too few points meet to say that it is wrong
            out["freed scale's noise"] = float(np.sqrt(covariance[6, 6]))
    return out


def _unit_against(e: Findings, freed: dict[str, float]) -> list[str]:
    moved, scale = freed.get("freed scale", 1.0), scale_of(e.refined.T_target_source)
    off = abs(float(np.log(moved)))
    noise = freed.get("freed scale's noise", 0.0)
    if off <= e.known_to or not noise or off <= FREED_SIGMAS * noise <= FREED_SIGMAS * MAX_SCALE_SIGMA:
        return []
    return [
        f"the scale is given as {scale:.4g}, but left free the clouds fit best at {moved * scale:.4f}, "
        f"{off:.1%} off where {e.known_to:.1%} is allowed: one unit is wrong, or a map is bent; "
        "convert it, or use scale free (--scale free)"
    ]
