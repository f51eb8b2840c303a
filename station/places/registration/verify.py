"""Checks that see what an inlier ratio cannot: wrong yaw, wrong scale, symmetry. docs/registration.md explains them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, inverse_sim3, scale_of, transform
from station.places.registration.free_space import Rays, Watched, watched_points
from station.places.registration.freed_scale import free_the_scale, noise_of_scale
from station.places.registration.parts import PartsApart
from station.places.registration.problem import RegistrationProblem
from station.places.registration.refine import Refined
from station.places.registration.score import Contrast, Score

# Logistic regression: `python -m benchmarks.fit_registration_verdict` prints these numbers (docs/registration.md).
WEIGHTS = {
    "inlier ratio": 12.5,
    "coinciding landmarks": 6.5,
    "least contrast": 12.6,
    "runner-up's contrast": -17.1,
    "beside": -1.9,
    "log of halves apart": -1.5,
    "log of sides apart": -2.6,
}
OFFSET = -8.66
MIN_CONFIDENCE = 0.85
PARTS_RANGE = (0.03, 3.0)  # units; nearer or farther apart says no more
# The next two are no result of training: pairs beyond them were refused before.
MIN_OVERLAP = 0.2
MAX_RUNNER_UP = 0.85
# Alignments that the clouds can slide from: the best other one within some decimetres, as a share of this one's
# inliers, and how far apart two sides of the shared space would lie, in units of parts.py. Each alone is no sign: a
# rival means nothing where both sides agree, and sides disagree without a rival where furniture was moved in between
# or a map bends.
SLIDES = ((0.95, 0.4), (0.9, 0.8))  # beside, sides
MAX_SCALES = 0.015  # between two parts, where the scale is free: about twice what right alignments have
MAX_TILT_RAD = np.radians(6.0)
MIN_EIGENVALUE = 0.01
MAX_VIOLATION = 0.5
MIN_WATCHED = 30  # points in watched space; a share of fewer says nothing
# How far a known scale may move once it is left free, unless the caller knows it less well. Right scales of clouds of
# thousands of points move by less; those of some hundred may move farther, but not by three standard deviations.
KNOWN_TO = 0.01
FREED_SIGMAS = 3.0
FREED_SUBSET = 6000


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """All that the verdict is based on."""

    problem: RegistrationProblem
    refined: Refined
    score: Score
    contrast: Contrast
    runner_up: Contrast | None  # of the best alignment that is a different answer
    beside: Score | None  # of the best other alignment within some decimetres
    parts: PartsApart  # how far parts of the landmarks, each by itself, disagree
    scale_range: tuple[float, float]
    known_to: float  # how far a known scale may be off, relative
    target_rays: Rays | None
    source_rays: Rays | None
    target_given: FloatArray  # the clouds as the rays index them
    source_given: FloatArray

    def features(self) -> dict[str, float]:
        """What the confidence is made from, by the names in WEIGHTS, and what else may be learned from."""
        return {
            "inlier share": self.score.inlier_share,
            "inlier ratio": self.score.inlier_ratio,
            "coinciding landmarks": self.score.point_share,
            "contrast": self.contrast.mean,
            "least contrast": self.contrast.least,
            "runner-up's contrast": max(self.runner_up.mean, 0.0) if self.runner_up is not None else 0.0,
            "beside": min(self.beside_ratio(), 1.2),
            "halves apart": self.parts.halves,
            "log of halves apart": float(np.log(np.clip(self.parts.halves, *PARTS_RANGE))),
            "sides apart": self.parts.sides,
            "log of sides apart": float(np.log(np.clip(self.parts.sides, *PARTS_RANGE))),
            "scales apart": self.parts.scales,
        }

    def beside_ratio(self) -> float:
        """Inliers of the best other alignment within some decimetres, as a share of this one's; 0 without any."""
        return self.beside.inlier_share / max(self.score.inlier_share, 1e-9) if self.beside is not None else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    accepted: bool
    confidence: float  # probability 0..1 that the alignment is right, before the checks that can only refuse
    reasons: tuple[str, ...]
    covariance: FloatArray | None
    eigenvalues: FloatArray | None
    checked: dict[str, float]  # what the checks measured beside the features, as far as they were made:
    # "free-space violation": share of the watched points that would hang where the other navigation saw through;
    # "watched points": how many those are;
    # "freed scale": what a known scale becomes where it is left free, relative to what it was;
    # "freed scale's noise": one standard deviation of that, measured only where it moved far.


def judge(e: Findings) -> Verdict:
    """Every check that fails adds a reason; none failed means accepted."""
    T = e.refined.T_target_source
    against: list[str] = []
    features = e.features()
    logit = OFFSET + sum(weight * features[name] for name, weight in WEIGHTS.items())
    confidence = float(1.0 / (1.0 + np.exp(-np.clip(logit, -50, 50))))
    if confidence < MIN_CONFIDENCE:
        against.append(
            f"right with {confidence:.0%}, needs {MIN_CONFIDENCE:.0%}: {e.score.inlier_share:.0%} of the points lie on "
            f"the other cloud's surfaces, and {max(e.contrast.least, 0):.0%} fit here and not beside it; "
            "too little in common, or different rooms"
        )
    if e.score.overlap < MIN_OVERLAP:
        against.append(f"the clouds share {e.score.overlap:.0%} of their space, needs {MIN_OVERLAP:.0%}")
    ratio = features["runner-up's contrast"] / max(e.contrast.mean, 1e-9)
    if ratio > MAX_RUNNER_UP:
        against.append(f"another alignment fits {ratio:.0%} as well: the room looks alike from there")
    if any(features["beside"] > beside and e.parts.sides > sides for beside, sides in SLIDES):
        against.append(
            f"an alignment a little beside this one fits {features['beside']:.0%} as well, and two sides of what the "
            f"clouds share, each alone, would lie {e.parts.sides * e.parts.unit:.2g} apart: the clouds can slide"
        )
    if e.parts.scales > MAX_SCALES:
        against.append(
            f"parts of the clouds, each alone, differ by {e.parts.scales:.1%} in scale, "
            f"and at most {MAX_SCALES:.1%} is asked: the scale is not known"
        )
    if e.problem.upright:
        tilt = float(np.arccos(np.clip(T[2, 2] / np.linalg.norm(T[:3, 2]), -1, 1)))
        if tilt > MAX_TILT_RAD:
            against.append(f"the result tilts the source by {np.degrees(tilt):.1f} degrees, though z is up in both")
    if e.problem.free_scale:
        scale = scale_of(T)
        low, high = e.scale_range
        if not low * 0.97 < scale < high * 1.03:
            against.append(f"scale {scale:.3f} is outside the allowed {low:.2f} to {high:.2f}")
    covariance, eigenvalues = _uncertainty(e)
    if eigenvalues is not None and eigenvalues[0] < MIN_EIGENVALUE:
        against.append(f"one direction is hardly determined (eigenvalue {eigenvalues[0]:.4f} per point)")
    checked: dict[str, float] = {}
    watched = _watched(e)
    if watched.points:
        checked |= {"free-space violation": watched.share, "watched points": watched.points}
    if watched.points >= MIN_WATCHED and watched.share > MAX_VIOLATION:
        against.append(
            f"{watched.share:.0%} of the points would hang where the other navigation saw through empty space"
        )
    if not e.problem.free_scale and not against:  # the rest refuses most others without this cost
        freed = _freed_scale(e)
        checked |= freed
        moved = freed.get("freed scale", 1.0)
        off = abs(float(np.log(moved)))
        if off > e.known_to and off > FREED_SIGMAS * freed.get("freed scale's noise", np.inf):
            against.append(
                f"the scale is given as {scale_of(T):.4g}, but left free the clouds fit best at "
                f"{moved * scale_of(T):.4f}, {off:.1%} off where {e.known_to:.1%} is allowed: one unit is wrong, "
                "or a map is bent; convert it, or use scale free (--scale free)"
            )
    if against:
        return Verdict(False, confidence, tuple(against), covariance, eigenvalues, checked)
    pro = [f"{e.score.inlier_share:.0%} of the points lie on the other cloud's surfaces"]
    pro.append(f"right with {confidence:.1%}; the next best alignment fits {ratio:.0%} as well")
    return Verdict(True, confidence, tuple(pro), covariance, eigenvalues, checked)


def _uncertainty(e: Findings) -> tuple[FloatArray | None, FloatArray | None]:
    """Covariance; and eigenvalues of the normal equations per unit of information, lengths in cloud radii."""
    H = e.refined.hessian
    free = np.arange(7) if e.problem.free_scale else np.arange(6)
    trace = float(np.trace(H[3:6, 3:6]))
    if trace <= 0:
        return None, None
    unit = np.array([1 / e.problem.target.radius] * 3 + [1.0] * 3 + [1 / e.problem.target.radius])
    scaled = (H * np.outer(unit, unit))[np.ix_(free, free)] * (3.0 / trace)
    values = np.asarray(np.linalg.eigvalsh(scaled), dtype=np.float64)
    covariance = np.zeros((7, 7))
    # Neighbouring residuals share the error of their plane: NEIGHBOURS of them are worth one.
    covariance[np.ix_(free, free)] = 12.0 * np.linalg.pinv(H[np.ix_(free, free)], hermitian=True)
    return covariance, values


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
    T, problem = e.refined.T_target_source, e.problem
    count = len(problem.source.points)
    subset = np.sort(problem.rng.choice(count, size=min(FREED_SUBSET, count), replace=False))
    freed = free_the_scale(problem, T, subset=subset)
    if freed is None:
        return {}
    out = {"freed scale": scale_of(freed) / scale_of(T)}
    if abs(np.log(out["freed scale"])) > e.known_to:
        noise = noise_of_scale(problem, freed, subset=subset)
        if noise is not None:  # else too few points meet to say that it is wrong
            out["freed scale's noise"] = noise
    return out
