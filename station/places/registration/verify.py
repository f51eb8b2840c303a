"""Checks that see what an inlier ratio cannot: yaw, scale and symmetry. docs/registration.md: measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, inverse_sim3, scale_of, transform
from station.places.registration.cloud import PreparedCloud
from station.places.registration.free_space import Rays, Watched, watched_points
from station.places.registration.freed_scale import free_the_scale, noise_of_scale
from station.places.registration.parts import PartsApart
from station.places.registration.refine import Refined
from station.places.registration.result import Gravity, Scale
from station.places.registration.score import Contrast, Score

# Logistic regression on 258 training pairs of benchmarks/bench_registration.py, of all its sets (docs/registration.md
# says which): `python -m benchmarks.fit_registration_verdict` prints these numbers.
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
# What no training pair could show, as these were checked first.
MIN_OVERLAP = 0.2
MAX_RUNNER_UP = 0.85
# Alignments that the clouds can slide from: the best other one within some decimetres, as a share of this one's
# inliers, and how far apart two sides of the shared space would lie, in units of parts.py. Each alone is no sign: a
# rival means nothing where both sides agree, and sides disagree without a rival where furniture was moved in between
# or a map bends. Real maps that lay right had sides of 0.9 to 1.2, and rivals of 0.84 at most.
SLIDES = ((0.95, 0.4), (0.9, 0.8))  # beside, sides
# Scales of two parts, where it is free. 65 right training pairs: at most 0.8 %; one that was 1.7 % off: 1.7 %.
MAX_SCALES = 0.015
MAX_TILT_RAD = np.radians(6.0)
MIN_EIGENVALUE = 0.01
MAX_VIOLATION = 0.5
MIN_WATCHED = 30  # points in watched space; a share of fewer says nothing
# How far a known scale may move once it is left free, unless the caller knows it less well. Training pairs, seeds 520
# to 579: 31 right ones at most 0.31 %, 40 with little overlap 0.68 %; accepted ones with a source 2 % too large or
# small at least 1.41 % (46; of 26 with little overlap two less than 1 %), 5 % too large or small 1.84 % (20). In clouds
# of 300 to 1000 points (seeds 600 to 647) 36 right ones move by up to 1.41 %, none of them by more than 1 % and three
# standard deviations.
KNOWN_TO = 0.01
FREED_SIGMAS = 3.0
FREED_SUBSET = 6000


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """All that the verdict is based on."""

    target: PreparedCloud
    source: PreparedCloud
    refined: Refined
    score: Score
    contrast: Contrast
    runner_up: Contrast | None  # of the best alignment that is a different answer
    beside: Score | None  # of the best other alignment within some decimetres
    parts: PartsApart  # how far parts of the landmarks, each by itself, disagree
    tolerance: float
    voxel: float
    scale: Scale
    scale_range: tuple[float, float]
    known_to: float  # how far a known scale may be off, relative
    gravity: Gravity
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
    """Accepted or not, why, and how certain."""

    accepted: bool
    confidence: float  # probability 0..1 that the alignment is right, before the checks that can only refuse
    reasons: tuple[str, ...]
    covariance: FloatArray | None
    eigenvalues: FloatArray | None
    checked: dict[str, float]  # what the checks measured beside the features, as far as they were made:
    # "free-space violation": share of the watched points that would hang where the other drive saw through;
    # "watched points": how many those are;
    # "freed scale": what a known scale becomes where it is left free, relative to what it was;
    # "freed scale's noise": one standard deviation of that, measured only where it moved far.


def judge(e: Evidence, rng: np.random.Generator) -> Verdict:
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
    if e.gravity == "known":
        tilt = float(np.arccos(np.clip(T[2, 2] / np.linalg.norm(T[:3, 2]), -1, 1)))
        if tilt > MAX_TILT_RAD:
            against.append(f"the result tilts the source by {np.degrees(tilt):.1f} degrees, though z is up in both")
    if e.scale == "free":
        scale = scale_of(T)
        low, high = e.scale_range
        if not low * 0.97 < scale < high * 1.03:
            against.append(f"scale {scale:.3f} is outside the allowed {low:.2f} to {high:.2f}")
    covariance, eigenvalues = _uncertainty(e)
    if eigenvalues is not None and eigenvalues[0] < MIN_EIGENVALUE:
        against.append(f"one direction is hardly determined (eigenvalue {eigenvalues[0]:.4f} per point)")
    checked: dict[str, float] = {}
    watched = _watched(e, rng)
    if watched.points:
        checked |= {"free-space violation": watched.share, "watched points": watched.points}
    if watched.points >= MIN_WATCHED and watched.share > MAX_VIOLATION:
        against.append(f"{watched.share:.0%} of the points would hang where the other drive saw through empty space")
    if e.scale == "known" and not against:  # the rest refuses most others without this cost
        freed = _freed_scale(e, rng)
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


def _uncertainty(e: Evidence) -> tuple[FloatArray | None, FloatArray | None]:
    """Covariance; and eigenvalues of the normal equations per unit of information, lengths in cloud radii."""
    H = e.refined.hessian
    free = np.arange(7) if e.scale == "free" else np.arange(6)
    trace = float(np.trace(H[3:6, 3:6]))
    if trace <= 0:
        return None, None
    unit = np.array([1 / e.target.radius] * 3 + [1.0] * 3 + [1 / e.target.radius])
    scaled = (H * np.outer(unit, unit))[np.ix_(free, free)] * (3.0 / trace)
    values = np.asarray(np.linalg.eigvalsh(scaled), dtype=np.float64)
    covariance = np.zeros((7, 7))
    # Neighbouring residuals share the error of their plane: NEIGHBOURS of them are worth one.
    covariance[np.ix_(free, free)] = 12.0 * np.linalg.pinv(H[np.ix_(free, free)], hermitian=True)
    return covariance, values


def _watched(e: Evidence, rng: np.random.Generator) -> Watched:
    """What free space says: of both directions that with enough points and the larger share; no points without rays."""
    T = e.refined.T_target_source
    found = [Watched(0, 0)]
    if e.target_rays is not None:
        moved = transform(T, e.source.points)
        found.append(watched_points(e.target_given, e.target_rays, moved, e.voxel, rng))
    if e.source_rays is not None:
        moved = transform(inverse_sim3(T), e.target.points)
        found.append(watched_points(e.source_given, e.source_rays, moved, e.voxel / scale_of(T), rng))
    return max(found, key=lambda w: (w.points >= MIN_WATCHED, w.share if w.points else -1.0))


def _freed_scale(e: Evidence, rng: np.random.Generator) -> dict[str, float]:
    """What the known scale becomes where it is free; nothing where too few points meet."""
    T, upright = e.refined.T_target_source, e.gravity == "known"
    count = len(e.source.points)
    subset = np.sort(rng.choice(count, size=min(FREED_SUBSET, count), replace=False))
    freed = free_the_scale(e.target, e.source, T, subset=subset, voxel=e.voxel, upright=upright)
    if freed is None:
        return {}
    out = {"freed scale": scale_of(freed) / scale_of(T)}
    if abs(np.log(out["freed scale"])) > e.known_to:
        noise = noise_of_scale(e.target, e.source, freed, subset=subset, voxel=e.voxel, upright=upright, rng=rng)
        if noise is not None:  # else too few points meet to say that it is wrong
            out["freed scale's noise"] = noise
    return out
